"""The table of a light tree's nodes.

Children of a node are neighbours in the table, the left one at `first_child`. A node keeps moments
of its lights (mean position, variance, mean axis), from which its importance is estimated, and
bounds (box, cone), which only decide where that importance is zero. Both follow from one pass over
the lights, so no bound loosens from child to parent.

Departures from Conty Estevez and Kulla 2018, Importance Sampling of Many Lights with Adaptive Tree
Splitting: they estimate importance from the bounds alone.
"""

from typing import NamedTuple

import numpy as np

NUM_TRAIL_BITS = 64


class LightTree(NamedTuple):
    """n nodes, the root first; 56 bytes each, and 12 for each light.

    mean: (n, 3) energy-weighted mean position; of a distant node the unit direction to its one
    light, or zero. half_extent: (n, 3) of a box around `mean` with all emitters inside; of a
    distant node the sine of its light's angular radius in all three, or 1. variance: mean squared
    distance of light from `mean`, m^2, infinite for a distant node. energy: sum of peak
    intensities, W/sr, distant: of irradiances, W/m^2. axis: (n, 3) energy-weighted mean direction
    of emission. cosine_share: share of the energy whose intensity falls with the cosine from there.
    cos_cone: cosine of the largest angle from `axis` at which any light emits, -1 for everywhere.
    first_child: node id, or for a leaf the one's complement of its light id, which is negative.
    trail: (num_lights,) uint64, bit k tells whether the way from the root to the light turns right
    at depth k. leaf: (num_lights,) int32 node of each light, -1 for one that is never chosen.
    """

    mean: np.ndarray
    half_extent: np.ndarray
    variance: np.ndarray
    energy: np.ndarray
    axis: np.ndarray
    cosine_share: np.ndarray
    cos_cone: np.ndarray
    first_child: np.ndarray
    trail: np.ndarray
    leaf: np.ndarray


def allocate_tree(num_nodes: int, num_lights: int) -> LightTree:
    """A table of zeros with the exact types that the kernels are compiled for."""
    f, f3 = (
        (lambda: np.zeros(num_nodes, np.float32)),
        (lambda: np.zeros((num_nodes, 3), np.float32)),
    )
    return LightTree(
        mean=f3(),
        half_extent=f3(),
        variance=f(),
        energy=f(),
        axis=f3(),
        cosine_share=f(),
        cos_cone=f(),
        first_child=np.zeros(num_nodes, np.int32),
        trail=np.zeros(num_lights, np.uint64),
        leaf=np.full(num_lights, -1, np.int32),
    )
