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

from ..jit import kernel

NUM_TRAIL_BITS = 64
NO_NODE = -1

# Columns of a node's row.
MEAN, HALF_EXTENT, VARIANCE, ENERGY, AXIS = 0, 3, 6, 7, 8
AXIS_LENGTH, COSINE_SHARE, COS_CONE, APEX_SHIFT = 11, 12, 13, 14
NUM_NODE_COLUMNS = 15


class Node(NamedTuple):
    """One row of the table.

    mean: vec3, energy-weighted mean position; of a distant node the unit direction to its one
    light, or zero. half_extent: vec3 of a box around `mean` with all emitters inside; of a distant
    node the sine of its light's angular radius, or 1. variance: mean squared distance of light
    from `mean`, m^2, infinite for a distant node. energy: sum of peak intensities, W/sr; distant:
    of irradiances, W/m^2. axis, axis_length: unit vec3 and length of the energy-weighted mean
    direction of emission. cosine_share: share of the energy whose intensity falls with the cosine
    from there. cos_cone: cosine of the largest angle from `axis` at which any light emits, -1 for
    everywhere. apex_shift: how far behind `mean` a cone of that angle starts that holds the cones
    of lights anywhere in the box, m.
    """

    mean: tuple
    half_extent: tuple
    variance: np.float32
    energy: np.float32
    axis: tuple
    axis_length: np.float32
    cosine_share: np.float32
    cos_cone: np.float32
    apex_shift: np.float32


class LightTree(NamedTuple):
    """n nodes, the root first; 64 bytes each, and 12 for each light.

    rows: (n, NUM_NODE_COLUMNS) float32. first_child: (n,) int32 node id, or for a leaf the one's
    complement of its light id, which is negative. trail: (num_lights,) uint64, bit k tells whether
    the way from the root to the light turns right at depth k. leaf: (num_lights,) int32 node of
    each light, NO_NODE for one that is never chosen.
    """

    rows: np.ndarray
    first_child: np.ndarray
    trail: np.ndarray
    leaf: np.ndarray


def allocate_tree(num_nodes: int, num_lights: int) -> LightTree:
    """A table of zeros with the exact types that the kernels are compiled for."""
    return LightTree(
        rows=np.zeros((num_nodes, NUM_NODE_COLUMNS), np.float32),
        first_child=np.zeros(num_nodes, np.int32),
        trail=np.zeros(num_lights, np.uint64),
        leaf=np.full(num_lights, NO_NODE, np.int32),
    )


@kernel
def load_node(tree, i):
    """Row i as a Node."""
    r = tree.rows
    return Node(
        (r[i, MEAN], r[i, MEAN + 1], r[i, MEAN + 2]),
        (r[i, HALF_EXTENT], r[i, HALF_EXTENT + 1], r[i, HALF_EXTENT + 2]),
        r[i, VARIANCE],
        r[i, ENERGY],
        (r[i, AXIS], r[i, AXIS + 1], r[i, AXIS + 2]),
        r[i, AXIS_LENGTH],
        r[i, COSINE_SHARE],
        r[i, COS_CONE],
        r[i, APEX_SHIFT],
    )
