"""The eight scenes of the evaluation in Beini Ma's thesis, "Importance Sampling in Many Lights
Trees" (Karlsruhe, 2018): a closed room with boxes, and each time other lights.

The kinds of light, their numbers and their order are the thesis'; the room, the colours and the
powers are ours, and all is diffuse but one ball of glass. Points and spots have no radius. The
power of a scene does not depend on the number of its lights, so neither does its exposure.
"""

from __future__ import annotations

from math import radians

import bpy
import numpy as np

from .shapes import (
    EAST,
    NORTH,
    UP,
    add_camera,
    box_quads,
    looking,
    new_collection,
    new_light,
    new_material,
    new_mesh,
    new_sphere,
    place,
    place_all,
    place_instances,
)

# Metres. Cells of 0.4 m divide the room into 25 x 40 x 12, and its ceiling into 1,000 squares.
ROOM = np.array([(-5, -8, 0), (5, 8, 4.8)])
WALLS = (0.7, 0.7, 0.7)
BOXES = {
    "yellow": ((0.6, 0.6, 0.1), ((-3.55, 3.25, 2.25), (-1.65, 5.05, 4.05))),
    "cyan": ((0.1, 0.6, 0.6), ((1.65, 3.25, 2.25), (3.55, 5.05, 4.05))),
    "grey": ((0.3, 0.3, 0.3), ((-2.35, 1.25, 0), (-1.05, 2.55, 1.3))),
    "copper": ((0.6, 0.35, 0.25), ((0.75, -0.75, 0), (1.95, 0.45, 0.9))),
}
# Where the three spheres hang, and the radiance of each.
SPHERES = {(0.0, 2.2, 3.2): 3.5, (-2.4, -0.8, 2.4): 5.0, (3.0, 1.2, 1.4): 8.0}
SPHERE_RADIUS, GLASS_RADIUS = 0.4, 0.5
GLASS_AT = (-0.3, -1.6, GLASS_RADIUS)

WHITE = (1.0, 1.0, 1.0)
# Watts of all points, of all spots, of the twenty, and W/(m^2 sr) of the ceiling.
POINT_POWER, SPOT_POWER, FEW_SPOTS_POWER, CEILING_RADIANCE = 300, 3000, 6000, 0.5
FEW_SPOTS = {"spot_size": radians(50), "shadow_soft_size": 0}
SPOT_SIZES, NUM_SPOT_SIZES = np.radians([10, 120]), 250
CLEARANCE = 0.05


def build_spots(num_lights: int, rng: np.random.Generator) -> None:
    """Narrow spots in mid-air, in turn at the floor, the wall ahead and the walls at the sides."""
    _add_room()
    spot = new_light("spot", "SPOT", WHITE, FEW_SPOTS_POWER / num_lights, **FEW_SPOTS)
    aims = [looking(direction) for direction in (-UP, NORTH, EAST, -EAST)]
    spots = [(spot, at, aims[i % 4]) for i, at in enumerate(_free_places(num_lights, rng))]
    place_all(new_collection("spots"), "spot", spots)


def build_ceiling_points(num_lights: int, rng: np.random.Generator) -> None:
    """Points in the grid of squares that is next to the number, 5 cm below the ceiling."""
    _add_room()
    squares, _ = _grid(num_lights, dimensions=2)
    _add_points(_at_height(squares, ROOM[1, 2] - 0.05))


def build_raster_points(num_lights: int, rng: np.random.Generator) -> None:
    """Points in the grid of cubes next to the number, those within boxes too."""
    _add_room()
    cubes, _ = _grid(num_lights, dimensions=3)
    _add_points(cubes)


def build_random_points(num_lights: int, rng: np.random.Generator) -> None:
    """Points anywhere in the free air."""
    _add_room()
    _add_points(_free_places(num_lights, rng))


def build_random_spots(num_lights: int, rng: np.random.Generator) -> None:
    """Spots anywhere in the free air, aimed and opened by chance."""
    _add_room()
    _add_random_spots(num_lights, rng)


def build_ceiling_triangles(num_lights: int, rng: np.random.Generator) -> None:
    """Emitting triangles, two a square, in the grid next to the number, that hide the ceiling."""
    _add_room()
    squares, size = _grid(num_lights / 2, dimensions=2)
    corners = size / 2 * [(-1, -1), (-1, 1), (1, 1), (1, -1)]
    quads = _at_height(squares[:, None] + corners, ROOM[1, 2] - 0.01)
    panels = new_mesh("panels", quads, _new_glow("panel", CEILING_RADIANCE))
    place(new_collection("panels"), "panels", panels)


def build_three_spheres(num_lights: int, rng: np.random.Generator) -> None:
    """Three spheres of emitting triangles, and a ball of glass."""
    _add_room()
    _add_spheres(num_lights)
    material = new_material("glass", "ShaderNodeBsdfGlass", Roughness=0.0, IOR=1.5)
    glass = new_sphere("glass", GLASS_RADIUS, 64, 32, material)
    glass.shade_smooth()
    place(new_collection("glass"), "glass", glass, GLASS_AT)


def build_mixed(num_lights: int, rng: np.random.Generator) -> None:
    """Of each seven lights three triangles, on the three spheres, two spots and two points."""
    num_spots = num_points = num_lights * 2 // 7
    _add_room()
    _add_spheres(num_lights - num_spots - num_points)
    _add_random_spots(num_spots, rng, SPOT_POWER / 3)
    _add_points(_free_places(num_points, rng), POINT_POWER / 3)


def _add_room() -> None:
    """The room seen from inside, its boxes, and the camera at its southern wall."""
    room = new_collection("room")
    walls = box_quads([ROOM])[:, ::-1]
    surfaces = {"walls": (WALLS, walls)} | {
        name: (color, box_quads([box])) for name, (color, box) in BOXES.items()
    }
    for name, (color, quads) in surfaces.items():
        material = new_material(name, "ShaderNodeBsdfDiffuse", Color=(*color, 1))
        place(room, name, new_mesh(name, quads, material))
    bpy.context.scene.camera = add_camera("camera", (0, -7.5, 1.9), (0, 1, 0.02), 26)


def _grid(num: float, dimensions: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, d) and size (d,) of about `num` equal cells of the room, or of its floor.

    As close to cubes, or squares, as whole numbers of them along each side can be.
    """
    low, high = ROOM[:, :dimensions]
    side = (np.prod(high - low) / num) ** (1 / dimensions)
    counts = np.maximum(np.round((high - low) / side), 1)
    size = (high - low) / counts
    cells = np.indices(counts.astype(int)).reshape(dimensions, -1).T
    return low + (cells + 0.5) * size, size


def _at_height(floor_points: np.ndarray, height: float) -> np.ndarray:
    """Points (..., 2) of the floor, lifted: (..., 3)."""
    return np.insert(floor_points, 2, height, axis=-1)


def _free_places(num: int, rng: np.random.Generator) -> np.ndarray:
    """Random points (num, 3) of the room, 5 cm or more from its walls, the boxes and the spheres.

    Nearer to a surface, a point light shines on it without bound.
    """
    spheres = [(np.array(at) - SPHERE_RADIUS, np.array(at) + SPHERE_RADIUS) for at in SPHERES]
    taken = np.array([*(box for _, box in BOXES.values()), *spheres])
    low, high = taken[:, :1] - CLEARANCE, taken[:, 1:] + CLEARANCE
    # They fill less than a twentieth of the room: twice as many and some more always do.
    places = rng.uniform(ROOM[0] + CLEARANCE, ROOM[1] - CLEARANCE, (2 * num + 100, 3))
    is_taken = ((low < places) & (places < high)).all(axis=2).any(axis=0)
    return places[~is_taken][:num]


def _add_points(locations: np.ndarray, power: float = POINT_POWER) -> None:
    """Point lights, instances of one."""
    bulb = new_light("point", "POINT", WHITE, power / len(locations), shadow_soft_size=0)
    place_instances(new_collection("points"), "point", bulb, locations)


def _add_random_spots(num: int, rng: np.random.Generator, power: float = SPOT_POWER) -> None:
    """Spots of random place, axis and aperture, in datablocks of at most 250 apertures."""
    sizes = rng.uniform(*SPOT_SIZES, min(num, NUM_SPOT_SIZES))
    lights = [
        new_light(f"spot-{i:03}", "SPOT", WHITE, power / num, spot_size=size, shadow_soft_size=0)
        for i, size in enumerate(sizes)
    ]
    places, aims = _free_places(num, rng), rng.normal(size=(num, 3))
    spots = [(lights[i % len(lights)], places[i], looking(aims[i])) for i in range(num)]
    place_all(new_collection("spots"), "spot", spots)


def _add_spheres(num_triangles: int) -> None:
    """The three spheres, of about so many triangles together."""
    num_cells = max(num_triangles / 6, 6)
    columns = round(np.sqrt(1.6 * num_cells))
    rows = round(num_cells / columns) + 1
    spheres = new_collection("spheres")
    for i, (location, radiance) in enumerate(SPHERES.items()):
        glow = _new_glow(f"glow-{i}", radiance)
        mesh = new_sphere(f"sphere-{i}", SPHERE_RADIUS, columns, rows, glow)
        place(spheres, mesh.name, mesh, location)


def _new_glow(name: str, radiance: float) -> bpy.types.Material:
    """A white emitter of W/(m^2 sr), whose back is nothing to aim at, for nobody can see it."""
    glow = new_material(name, "ShaderNodeEmission", Color=(*WHITE, 1), Strength=radiance)
    glow.cycles.emission_sampling = "FRONT"
    return glow
