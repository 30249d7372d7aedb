"""The table of triangles that kernels read."""

from typing import NamedTuple

import numpy as np

from .jit import f32, i32, table
from .scene import Scene


@table
class Geometry(NamedTuple):
    """All triangles and what their corners carry; rows as in `scene.Scene`.

    visible: (T,) bits of the rays that meet a triangle, (0,) where all meet all. diameter: of all
    of them together, m.
    """

    vertices: f32[:, ::1]
    triangles: i32[:, ::1]
    corner_normals: f32[:, :, ::1]
    uvs: f32[:, :, :, ::1]
    colors: f32[:, :, :, ::1]
    material: i32[::1]
    visible: i32[::1]
    diameter: f32


def build_geometry(scene: Scene) -> Geometry:
    """The triangles of a scene."""
    extent = np.ptp(scene.vertices, axis=0) if len(scene.vertices) else np.zeros(3)
    return Geometry(
        vertices=scene.vertices,
        triangles=scene.triangles,
        corner_normals=scene.corner_normals,
        uvs=scene.uvs,
        colors=scene.colors,
        material=scene.triangle_material,
        visible=scene.triangle_visible(),
        diameter=2 * np.linalg.norm(extent) + 1e-20,
    )
