"""Objects that rays of some kinds do not meet: Blender's Ray Visibility.

A ray goes on behind what is hidden from it as if nothing were there; no bounce, no pass.
"""

import numpy as np

from .jit import kernel
from .rays import Hits
from .surface import load_surface
from .vec import dot, load3, store3, sub
from .waves import RAY_KIND


@kernel
def meets(geometry, triangle, rays):
    """Whether rays of a kind meet a triangle."""
    return len(geometry.visible) == 0 or geometry.visible[triangle] & rays != 0


def closest_seen(tracer, geometry, wave, num_paths, max_distance=None) -> Hits:
    """What `Tracer.closest` tells of the paths of a wave, without what is hidden from them."""
    origin, direction = wave.origin[:num_paths], wave.direction[:num_paths]
    if len(geometry.visible) == 0:
        return tracer.closest(origin, direction, max_distance)
    end = None if max_distance is None else max_distance.copy()  # Embree writes over it
    hits, rows = tracer.closest(origin, direction, max_distance), np.arange(num_paths)
    while True:
        triangle, kinds = hits.triangle[rows], wave.flags[rows] & RAY_KIND
        rows = rows[(triangle >= 0) & (geometry.visible[triangle] & kinds == 0)]
        if len(rows) == 0:
            return hits
        behind = np.empty((len(rows), 3), np.float32)
        go_behind(geometry, wave, hits, rows, behind)
        reach = None if end is None else end[rows] - hits.distance[rows]
        found = tracer.closest(behind, direction[rows], reach)
        hits.triangle[rows], hits.u[rows], hits.v[rows] = found.triangle, found.u, found.v
        hits.distance[rows] += found.distance


@kernel
def go_behind(geometry, wave, hits, rows, behind):
    """Write where the paths of some rows go on behind what they met, and in `hits` how far that is.

    behind: (len(rows), 3).
    """
    for k in range(len(rows)):
        i = rows[k]
        triangle, direction = hits.triangle[i], load3(wave.direction, i)
        _, p_behind, _, _, _ = load_surface(geometry, triangle, hits.u[i], hits.v[i], direction)
        store3(behind, k, p_behind)
        hits.distance[i] = dot(sub(p_behind, load3(wave.origin, i)), direction)
