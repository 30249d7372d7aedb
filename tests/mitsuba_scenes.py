"""Scenes of `lighttree_core` for Mitsuba 3, as far as `test_mitsuba` uses them.

Mitsuba is imported where it renders, in a process of its own: it brings an Embree too.
"""

from pathlib import Path

import numpy as np

from lighttree_core import Scene
from lighttree_core.scene import COLOR, FRONT, GLASS, GLOSSY, IOR, POINT, ROUGHNESS, SUN


def shoot(scene: Scene, max_bounces: int, samples: int, seeds: list[int], folder: Path):
    """(H, W, 3) images, rows as in a Film, one for each seed."""
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    world = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": max_bounces + 2, "rr_depth": 1000},
            "sky": {"type": "constant", "radiance": rgb(scene.background)},
            "sensor": sensor(scene.camera, mitsuba.ScalarTransform4f),
            **lamps(scene.lamps),
            **meshes(scene, folder),
        }
    )
    return [
        np.array(mitsuba.render(world, spp=samples, seed=seed))[::-1].astype(np.float64)
        for seed in seeds
    ]


def rgb(color) -> dict:
    """A colour of linear Rec.709."""
    return {"type": "rgb", "value": np.asarray(color, float).tolist()}


def sensor(camera, transform) -> dict:
    """The camera, with a pixel filter of one pixel."""
    right_up_back, position = camera.world_from_camera[:, :3], camera.world_from_camera[:, 3]
    film = {"type": "hdrfilm", "width": camera.width_px, "height": camera.height_px}
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(camera.half_width))),
        "fov_axis": "x",
        "to_world": transform().look_at(
            origin=position.tolist(),
            target=(position - right_up_back[:, 2]).tolist(),
            up=right_up_back[:, 1].tolist(),
        ),
        "film": {**film, "pixel_format": "rgb", "rfilter": {"type": "box"}},
    }


def lamps(table) -> dict:
    """Points without extent, and suns."""
    found = {}
    for i, kind in enumerate(table.kind):
        assert kind in (POINT, SUN) and table.radius[i] == 0
        light = {"type": "point", "position": table.position[i].tolist()}
        quantity = "intensity"
        if kind == SUN:
            light = {"type": "directional", "direction": table.axis_w[i].tolist()}
            quantity = "irradiance"
        found[f"lamp{i}"] = {**light, quantity: rgb(table.radiance[i])}
    return found


def meshes(scene: Scene, folder: Path) -> dict:
    """One mesh for each material; what emits does so at the front alone."""
    found = {}
    for material in np.unique(scene.triangle_material):
        corners = scene.vertices[scene.triangles[scene.triangle_material == material]]
        path = folder / f"{material}.ply"
        write_ply(path, corners)
        mesh = {"type": "ply", "filename": str(path), "face_normals": True}
        mesh["bsdf"] = surface(scene, material)
        emission = scene.materials.emission[material]
        if emission.any():
            assert not emission[1].any()
            mesh["emitter"] = {"type": "area", "radiance": rgb(emission[FRONT])}
        found[f"mesh{material}"] = mesh
    return found


def surface(scene: Scene, material: int) -> dict:
    """Lambert, or a single glossy or glass closure."""
    materials, closures = scene.materials, scene.closures
    if materials.num_closures[material, FRONT] == 0:
        albedo = rgb(materials.albedo[material, FRONT])
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": albedo}}
    row = materials.first_closure[material, FRONT]
    assert not closures.multiscatter[row]
    values = closures.values[row]
    color, alpha = rgb(values[COLOR : COLOR + 3]), float(values[ROUGHNESS]) ** 2
    rough = {"distribution": "ggx", "alpha": alpha}
    if closures.kind[row] == GLOSSY:
        conductor = {"type": "roughconductor", "material": "none", **rough}
        return {"type": "twosided", "bsdf": {**conductor, "specular_reflectance": color}}
    assert closures.kind[row] == GLASS
    indices = {"int_ior": float(values[IOR]), "ext_ior": 1.0}
    if alpha == 0:
        return {"type": "dielectric", **indices}
    return {"type": "roughdielectric", **rough, **indices}


def write_ply(path: Path, corners: np.ndarray) -> None:
    """Triangles, (n, 3, 3), as a binary PLY file."""
    n = len(corners)
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {3 * n}\n{properties}"
        f"element face {n}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(n, [("count", "u1"), ("ids", "<i4", 3)])
    faces["count"], faces["ids"] = 3, np.arange(3 * n).reshape(n, 3)
    path.write_bytes(header.encode() + corners.astype("<f4").tobytes() + faces.tobytes())
