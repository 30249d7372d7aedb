"""Small scenes for tests of the core, without Blender."""

import numba
import numpy as np
import pytest

from lighttree_core.scene import (
    DISK,
    ELLIPSE,
    LAMP_KINDS,
    POINT,
    RECTANGLE,
    SPHERE,
    SUN,
    TRANSPARENT,
    Camera,
    Closures,
    Lamps,
    Materials,
    Scene,
)

JIT_IS_OFF = bool(numba.config.DISABLE_JIT)
needs_float32 = pytest.mark.skipif(
    JIT_IS_OFF and np.lib.NumpyVersion(np.__version__) < "2.0.0",
    reason="a float32 times a number of Python is a float64 to NumPy 1",
)


def fewer(num: int, without_jit: int) -> int:
    """A number of samples, a smaller one where kernels run as plain Python."""
    return without_jit if JIT_IS_OFF else num


def camera(width=16, height=9, position=(0.0, 0.0, 5.0), half_width=1.0, **kwargs) -> Camera:
    """A camera that looks straight down."""
    world_from_camera = np.eye(4)[:3]
    world_from_camera[:, 3] = position
    half_height = half_width * height / width
    return Camera(world_from_camera, half_width, half_height, width, height, **kwargs)


def materials(*albedo_emission) -> Materials:
    """Materials from pairs (albedo, emission), the same on both sides."""
    table = Materials.empty(len(albedo_emission))
    for row, (albedo, emission) in enumerate(albedo_emission):
        table.albedo[row], table.emission[row] = albedo, emission
        table.names[row] = f"material {row}"
    return table


def floor_scene(lamps=None, albedo=0.5, size=20.0, **kwargs) -> Scene:
    """A square floor at z = 0 under a camera, lit by lamps."""
    half = size / 2
    vertices = np.array(
        [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], np.float32
    )
    return Scene(
        camera=kwargs.pop("camera", None) or camera(),
        vertices=vertices,
        triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        triangle_material=np.zeros(2, np.int32),
        materials=materials((albedo, 0.0)),
        lamps=lamps or Lamps.empty(),
        object_names=["Floor"],
        object_first_triangle=np.zeros(1, np.int32),
        **kwargs,
    )


def add_triangles(scene: Scene, corners, material: int, name: str = "Added") -> None:
    """Append triangles, (n, 3, 3) corners, to a scene."""
    corners = np.asarray(corners, np.float32).reshape(-1, 3)
    ids = len(scene.vertices) + np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    scene.object_first_triangle = np.append(
        scene.object_first_triangle, np.int32(len(scene.triangles))
    )
    scene.object_names.append(name)
    scene.vertices = np.concatenate([scene.vertices, corners])
    scene.triangles = np.concatenate([scene.triangles, ids])
    scene.triangle_material = np.append(
        scene.triangle_material, np.full(len(ids), material, np.int32)
    )


def make_clear(scene: Scene, material: int) -> None:
    """Have a material of a scene without closures let all light straight through."""
    scene.closures = Closures.empty(1)
    scene.closures.kind[0], scene.closures.weight[0] = TRANSPARENT, 1
    scene.materials.num_closures[material] = 1


def emitters(*corner_lists, back=0.0, front=1.0):
    """A floor under emitting meshes, each an (n, 3, 3) array of corners."""
    scene = floor_scene()
    scene.materials = materials((0.5, 0.0), (0.0, front))
    scene.materials.emission[1, 1] = back
    for corners in corner_lists:
        add_triangles(scene, corners, 1)
    return scene


def furnace(albedo: float, emission: float) -> Scene:
    """The inside of a cube that shines and reflects alike everywhere, seen from its middle."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Scene(
        camera=camera(8, 8, position=(0.1, -0.2, 0.0)),
        vertices=corners,
        triangles=np.array(triangles, np.int32),
        triangle_material=np.zeros(12, np.int32),
        materials=materials((albedo, emission)),
    )


def point_lamps(positions, intensities=1.0) -> Lamps:
    """Lamps without extent, of some intensities in W/sr."""
    lamps = Lamps.empty(len(positions))
    lamps.position[:] = positions
    lamps.radiance[:] = np.broadcast_to(intensities, len(positions))[:, None]
    lamps.names = [f"Lamp.{i:03d}" for i in range(len(positions))]
    return lamps


def lamps_down(kinds, positions, radiances=1.0) -> Lamps:
    """Lamps of some kinds that shine straight down; area lamps 10 cm wide, suns a point."""
    lamps = point_lamps(positions, radiances)
    lamps.kind[:] = kinds
    lamps.axis_u[:], lamps.axis_v[:], lamps.axis_w[:] = (1, 0, 0), (0, -1, 0), (0, 0, -1)
    is_flat = np.isin(lamps.kind, (RECTANGLE, ELLIPSE))
    lamps.axis_u[is_flat], lamps.axis_v[is_flat] = (0.1, 0, 0), (0, -0.1, 0)
    lamps.radius[np.isin(lamps.kind, (SPHERE, DISK))] = 0.1
    return lamps


def random_lamps(rng, num_lamps, kinds=LAMP_KINDS, extent=10.0) -> Lamps:
    """Lamps of all kinds, half of the round ones spots, above the floor."""
    lamps = Lamps.empty(num_lamps)
    lamps.names = [f"Lamp.{i:03d}" for i in range(num_lamps)]
    lamps.kind[:] = rng.choice(kinds, num_lamps)
    lamps.position[:] = rng.uniform([-extent, -extent, 0.5], [extent, extent, 4.0], (num_lamps, 3))
    lamps.radiance[:] = rng.lognormal(0, 1, (num_lamps, 3))
    for i, kind in enumerate(lamps.kind):
        u, v, w = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        if kind in (RECTANGLE, ELLIPSE):
            lamps.axis_u[i], lamps.axis_v[i] = u * rng.uniform(0.1, 2), v * rng.uniform(0.1, 2)
            lamps.spread[i] = rng.choice([np.pi, rng.uniform(0.3, 3)])
        else:
            lamps.axis_u[i], lamps.axis_v[i] = u, v
        lamps.axis_w[i] = w
        if kind in (SPHERE, DISK):
            lamps.radius[i] = rng.uniform(0.01, 0.4)
        if kind == SUN:
            lamps.axis_w[i, 2] = -abs(w[2])
            lamps.radius[i] = rng.choice([0.0, 0.005, 0.5])
        if kind in (POINT, SPHERE, DISK) and rng.random() < 0.5:
            lamps.cos_cone[i] = np.cos(rng.uniform(0.1, np.pi / 2))
            lamps.blend[i] = rng.uniform(0, 1)
    return lamps


def random_scene(rng, num_lamps=20, num_triangles=10, **kwargs) -> Scene:
    """Lamps of all kinds and emitting triangles over a floor, under a dim sky."""
    scene = floor_scene(random_lamps(rng, num_lamps, **kwargs))
    scene.background = rng.uniform(0, 0.1, 3).astype(np.float32)
    scene.materials = materials((0.5, 0.0), (0.0, 1.0), (0.0, 3.0))
    scene.materials.emission[1, 1] = 0  # from the front alone
    for _ in range(num_triangles):
        center = rng.uniform([-8, -8, 0.5], [8, 8, 4])
        add_triangles(scene, center + rng.normal(size=(3, 3)), int(rng.integers(1, 3)))
    return scene
