"""Embree: the closest triangle along a ray, and whether anything lies between two points.

The only file that knows embreex. Rays start where `vec.offset_point` puts them, so no distance is
cut off here. Embree is called without the GIL.
"""

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from .jit import f32, i32, table

# Embree accepts a hit at exactly the ray's end; a light's own surface must not block it.
BEFORE_TARGET = np.float32(1 - 2**-22)


@table
class Hits(NamedTuple):
    """What n rays met: the triangle or -1, barycentric coordinates of its second and third vertex,
    and the distance in units of the ray's direction."""

    triangle: i32[::1]
    u: f32[::1]
    v: f32[::1]
    distance: f32[::1]


class Tracer:
    """Embree's acceleration structure over the triangles of a scene."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        self._scene = EmbreeScene()
        if len(triangles):
            TriangleMesh(self._scene, vertices, triangles)
        # The structure is built at the first ray; threads must not race for it.
        self.closest(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def closest(self, origin, direction, max_distance=None) -> Hits:
        """The first triangle along each ray; (n, 3) float32 arrays, max_distance (n,) or none."""
        found = self._scene.run(origin, direction, max_distance, output=True)
        return Hits(found["primID"], found["u"], found["v"], found["tfar"])

    def closest_before(self, origin, to_target) -> Hits:
        """The first triangle between each origin and origin + to_target, the unit of distance."""
        return self.closest(origin, to_target, np.full(len(origin), BEFORE_TARGET))

    def occluded(self, origin, to_target) -> np.ndarray:
        """(n,) bool, whether a triangle lies between each origin and origin + to_target."""
        return self._scene.run(origin, to_target, BEFORE_TARGET, query="OCCLUDED") >= 0
