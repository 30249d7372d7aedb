"""The table of a light tree's nodes.

A node has up to NUM_LANES lanes; a lane is either one light or a set of lights with a node of its
own. Every column of a node holds the lanes side by side, so that the importances of all of them
come out of a few vector instructions: a node of 16 is weighed in the time of two scalar ones. A
lane keeps moments of its lights (mean position, variance, mean axis), from which its importance is
estimated, and bounds (box, cone), which only decide where that importance is zero. Both follow
from one pass over the lights, so no bound loosens from child to parent.

An emissive mesh enters as its triangles in the world, instances too: one flat tree. A subtree for
each mesh would save memory where a mesh is instanced often, but its bounds, moved to the world,
are looser, every descent changes space, and a lane's moments are then not those of its lights.
"""

from typing import NamedTuple

import numpy as np

from ..jit import allocating_kernel, f32, i32, i64, kernel, table

NUM_LANES = 16
NO_LANE = -1

# Columns of a node.
MEAN, HALF_EXTENT, VARIANCE, FLUX, FLOOR, AXIS = 0, 3, 6, 7, 8, 9
MEAN_COS, COS_CONE, APEX_SHIFT = 12, 13, 14
NUM_COLUMNS = 15


class Lane(NamedTuple):
    """One lane of a node.

    mean: vec3, flux-weighted mean position; of a distant light the unit direction to it, of a set
    of them zero. half_extent: vec3 of a box around `mean` with all emitters inside; of a distant
    light (its x) the sine of its angular radius, of a set 1. variance: mean squared distance of
    light from `mean`, m^2, infinite for distant lights. flux: sum of the lights' powers, W, times
    the lobe's 3 / (4 pi); distant: of irradiances, W/m^2. floor: the least intensity, W/sr, the
    set is thought to send anywhere it can. axis: unit vec3, mean direction of emission, by flux.
    mean_cos: length of that mean, the mean cosine of emission from `axis`. cos_cone: cosine of the
    largest angle from `axis` at which any light emits, -1 for everywhere. apex_shift: how far
    behind `mean` a cone of that angle starts that holds the cones of lights anywhere in the box, m.

    A single beam has its peak intensity, W/sr, in place of the flux, and in place of mean_cos -1
    over the part of 1 - cos in which it fades.
    """

    mean: tuple
    half_extent: tuple
    variance: np.float32
    flux: np.float32
    floor: np.float32
    axis: tuple
    mean_cos: np.float32
    cos_cone: np.float32
    apex_shift: np.float32


@table
class LightTree(NamedTuple):
    """n nodes, the root first; 64 bytes a lane, and 4 for each light.

    columns: (n, NUM_COLUMNS * NUM_LANES) float32, the lanes of one column after those of the other,
    so that kernels know at which offset each starts; a lane without lights has flux and floor 0.
    child: (n, NUM_LANES) int32 node id, or for a single light the one's complement of its id, which
    is negative. parent: (n,) int32 lane (node id * NUM_LANES + lane) under which a node hangs, of
    the root NO_LANE. light_lane: (num_lights,) int32 lane of each light, NO_LANE for one that is
    never chosen. depth: nodes on the longest way down. importance: index into IMPORTANCES of
    options.py.
    """

    columns: f32[:, ::1]
    child: i32[:, ::1]
    parent: i32[::1]
    light_lane: i32[::1]
    depth: i64
    importance: i64


def allocate_tree(num_nodes: int, num_lights: int) -> LightTree:
    """A table of zeros with the exact types that the kernels are compiled for."""
    return LightTree(
        columns=np.zeros((num_nodes, NUM_COLUMNS * NUM_LANES), np.float32),
        child=np.zeros((num_nodes, NUM_LANES), np.int32),
        parent=np.full(num_nodes, NO_LANE, np.int32),
        light_lane=np.full(num_lights, NO_LANE, np.int32),
        depth=0,
        importance=0,
    )


@allocating_kernel
def store_box(column, box_min, box_max):
    """Write the half extents of a box around a lane's mean; their squared length.

    column: (NUM_COLUMNS,) of one lane. Around the mean as rounded, and rounded up.
    """
    radius_sq = 0.0
    for k in range(3):
        mean = column[MEAN + k]
        half = max(box_max[k] - mean, mean - box_min[k]) * (1 + 2.0**-20)
        column[HALF_EXTENT + k] = half
        radius_sq += half * half
    return radius_sq


@kernel
def load_column(columns, node, column, k):
    """What lane k of a node has in one column."""
    return columns[node, column * NUM_LANES + k]


@kernel
def load_vector(columns, node, column, k):
    """What it has in three columns in a row."""
    return (
        load_column(columns, node, column, k),
        load_column(columns, node, column + 1, k),
        load_column(columns, node, column + 2, k),
    )


@kernel
def load_lane(columns, node, k):
    """Lane k of a node."""
    return Lane(
        load_vector(columns, node, MEAN, k),
        load_vector(columns, node, HALF_EXTENT, k),
        load_column(columns, node, VARIANCE, k),
        load_column(columns, node, FLUX, k),
        load_column(columns, node, FLOOR, k),
        load_vector(columns, node, AXIS, k),
        load_column(columns, node, MEAN_COS, k),
        load_column(columns, node, COS_CONE, k),
        load_column(columns, node, APEX_SHIFT, k),
    )


@kernel
def sum_of_four(values, k):
    """Sum of the values of lanes k to k + 3, float64."""
    first = np.float64(values[k]) + np.float64(values[k + 1])
    return first + (np.float64(values[k + 2]) + np.float64(values[k + 3]))


@kernel
def sum_lanes(values):
    """Sum of the values of all lanes, float64; sixteen additions in a row would wait longer."""
    total = 0.0
    for k in range(0, NUM_LANES, 4):
        total += sum_of_four(values, k)
    return total
