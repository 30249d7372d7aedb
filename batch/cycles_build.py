"""The binary tree of `cycles_style.py`: how its lights are cut in two and what it keeps of them.

A set of lights is cut at the cheapest of 12 buckets of equal width along each side of the box of
its lights' centres, shorter sides counting as costlier, unless it has 8 lights at most and no cut
is cheaper than the whole. Distant lights are one leaf, under the root.
"""

import math

import numpy as np

from lighttree_core.jit import allocating_kernel
from lighttree_core.light_tree.split import orientation_measure
from lighttree_core.lights import LightBounds, Lights
from lighttree_core.scene import ELLIPSE, NO_CONE, RECTANGLE, TRIANGLE

from .cycles_style import (
    AXIS,
    CENTER,
    CORNERS,
    COS_E,
    COS_O,
    ENERGY,
    FADE,
    HALF_EXTENT,
    NUM_COLUMNS,
    NUM_CORNERS,
    NUM_LIGHT_COLUMNS,
    RADIUS,
    SIN_O,
    CyclesTree,
)

MOST_LIGHTS = 8  # in a leaf, distant lights apart
NUM_BUCKETS = 12
CONE_SLACK = 5e-4

# Columns while building, of a light as of a set of lights.
BOX_MIN, BOX_MAX, BOX_AXIS, THETA_O, THETA_E, INTENSITY = 0, 3, 6, 9, 10, 11
NUM_ROW_COLUMNS = 12


def build_cycles_tree(lights: Lights, bounds: LightBounds) -> CyclesTree:
    """The tree over all lights whose flux is not zero, one at least."""
    is_lit = bounds.flux > 0
    local = np.flatnonzero(is_lit & ~bounds.is_distant)
    order = np.concatenate([local, np.flatnonzero(is_lit & bounds.is_distant)]).astype(np.int32)
    rows = np.empty((len(order), NUM_ROW_COLUMNS))
    rows[:, BOX_MIN:BOX_MAX] = bounds.box_min[order]
    rows[:, BOX_MAX:BOX_AXIS] = bounds.box_max[order]
    rows[:, BOX_AXIS:THETA_O] = axis = bounds.axis[order]
    rows[:, THETA_O] = np.where(axis.any(axis=1), 0, np.pi)
    rows[:, THETA_E] = np.minimum(bounds.theta_e[order], np.pi / 2)
    rows[:, INTENSITY] = np.where(bounds.is_distant, bounds.flux, bounds.peak)[order]
    nodes, right, first, last, parent = build_nodes(rows, order, len(local))
    place, leaf = np.full((2, len(bounds.flux)), -1, np.int32)
    place[order] = np.arange(len(order))
    for node in np.flatnonzero(right == 0):
        leaf[order[first[node] : last[node]]] = node
    return CyclesTree(
        np.ascontiguousarray(_node_columns(nodes, first >= len(local)), np.float32),
        *(np.ascontiguousarray(column, np.int32) for column in (right, first, last, parent)),
        np.ascontiguousarray(_light_columns(lights, bounds, rows, order), np.float32),
        order,
        place,
        leaf,
    )


def _node_columns(rows: np.ndarray, is_distant: np.ndarray) -> np.ndarray:
    """What a descent reads of sets of lights."""
    columns = np.zeros((len(rows), NUM_COLUMNS))
    half_extent = (rows[:, BOX_MAX:BOX_AXIS] - rows[:, BOX_MIN:BOX_MAX]) / 2
    columns[:, CENTER:HALF_EXTENT] = rows[:, BOX_MIN:BOX_MAX] + half_extent
    columns[:, HALF_EXTENT:AXIS] = half_extent * (1 + 2.0**-20)
    columns[:, AXIS:COS_O] = rows[:, BOX_AXIS:THETA_O]
    # Distant lights are all around the axis as far as any of them reaches.
    theta_o = np.where(is_distant, rows[:, THETA_O] + rows[:, THETA_E], rows[:, THETA_O])
    theta_o = np.minimum(theta_o, np.pi)
    columns[:, COS_O], columns[:, SIN_O] = np.cos(theta_o), np.sin(theta_o)
    columns[:, COS_E] = np.maximum(0, np.cos(rows[:, THETA_E]))
    columns[:, ENERGY] = rows[:, INTENSITY]
    radius = np.linalg.norm(columns[:, HALF_EXTENT:AXIS], axis=1)
    columns[:, RADIUS] = np.where(is_distant, -1, radius)
    return columns


def _light_columns(lights: Lights, bounds: LightBounds, rows, order) -> np.ndarray:
    """The same of single lights, with their outlines and the fading of spots."""
    columns = np.zeros((len(rows), NUM_LIGHT_COLUMNS))
    columns[:, :NUM_COLUMNS] = _node_columns(rows, bounds.is_distant[order])
    kind, is_spot = lights.kind[order], lights.cos_cone[order] != NO_CONE
    columns[:, FADE] = np.where(is_spot, (1 - lights.cos_cone[order]) * lights.blend[order], 0)
    position, u, v = (a[order] for a in (lights.position, lights.axis_u, lights.axis_v))
    is_triangle, is_quad = kind == TRIANGLE, (kind == RECTANGLE) | (kind == ELLIPSE)
    is_round = ~is_triangle & ~is_quad & ~bounds.is_distant[order]
    columns[is_round, RADIUS] = lights.radius[order][is_round]
    columns[:, NUM_CORNERS] = np.select([is_triangle, is_quad], [3, 4], 0)
    corner = np.where(is_triangle[:, None], position, position - (u + v) / 2)
    columns[:, CORNERS:] = np.concatenate([corner, corner + u, corner + v, corner + u + v], axis=1)
    return columns


@allocating_kernel
def build_nodes(rows, order, num_local):
    """(rows of all nodes, right part, first light, last light, parent) in preorder.

    rows: (n, NUM_ROW_COLUMNS) of the lights, the distant ones last; rearranged, as is order.
    """
    num = len(rows)
    nodes = np.zeros((2 * num + 1, NUM_ROW_COLUMNS))
    right, parent = np.zeros(2 * num + 1, np.int64), np.zeros(2 * num + 1, np.int64)
    first, last = np.zeros(2 * num + 1, np.int64), np.zeros(2 * num + 1, np.int64)
    stack = np.zeros((num + 2, 3), np.int64)
    stack[0] = 0, num, 0
    num_nodes, num_waiting = 0, 1
    while num_waiting > 0:
        num_waiting -= 1
        i, num_nodes = num_nodes, num_nodes + 1
        first[i], last[i], parent[i] = stack[num_waiting]
        if parent[i] != i - 1:
            right[parent[i]] = i
        part = rows[first[i] : last[i]]
        clear(nodes[i])
        for row in part:
            merge(nodes[i], row)
        if first[i] < num_local < last[i]:
            middle = num_local
        elif first[i] >= num_local:
            continue
        else:
            middle = first[i] + cut(part, order[first[i] : last[i]], cost(nodes[i]))
        if first[i] < middle < last[i]:
            stack[num_waiting] = middle, last[i], i
            stack[num_waiting + 1] = first[i], middle, i
            num_waiting += 2
    return nodes[:num_nodes], right[:num_nodes], first[:num_nodes], last[:num_nodes], parent


@allocating_kernel
def clear(total):
    """The row of no lights."""
    total[:] = 0.0
    total[BOX_MIN:BOX_MAX] = np.inf
    total[BOX_MAX:BOX_AXIS] = -np.inf
    total[THETA_O] = -1.0


@allocating_kernel
def merge(total, other):
    """Widen a row until it bounds another one too."""
    for k in range(3):
        total[BOX_MIN + k] = min(total[BOX_MIN + k], other[BOX_MIN + k])
        total[BOX_MAX + k] = max(total[BOX_MAX + k], other[BOX_MAX + k])
    total[THETA_E] = max(total[THETA_E], other[THETA_E])
    total[INTENSITY] += other[INTENSITY]
    if other[THETA_O] > total[THETA_O]:
        wide, narrow = other[BOX_AXIS : THETA_O + 1].copy(), total[BOX_AXIS : THETA_O + 1].copy()
    else:
        wide, narrow = total[BOX_AXIS : THETA_O + 1].copy(), other[BOX_AXIS : THETA_O + 1].copy()
    total[BOX_AXIS : THETA_O + 1] = wide
    cos_between = (wide[:3] * narrow[:3]).sum()
    between = math.acos(min(1.0, max(-1.0, cos_between)))
    if narrow[3] < 0 or min(math.pi, between + narrow[3]) <= wide[3]:
        return
    theta_o = (wide[3] + between + narrow[3]) / 2 + CONE_SLACK
    # Turn the wider cone towards the other one; from an opposite axis there is no way that is best.
    across = narrow[:3] - cos_between * wide[:3]
    length = math.sqrt((across**2).sum())
    if theta_o >= math.pi or length < 1e-6:
        total[THETA_O] = min(math.pi, between + narrow[3] + CONE_SLACK)
        return
    turn = theta_o - wide[3]
    total[BOX_AXIS:THETA_O] = math.cos(turn) * wide[:3] + math.sin(turn) / length * across
    total[THETA_O] = theta_o


@allocating_kernel
def cost(total):
    """Energy x area of the box x Conty and Kulla's measure of orientation."""
    x, y, z = total[BOX_MAX:BOX_AXIS] - total[BOX_MIN:BOX_MAX]
    area = 2 * (x * y + y * z + z * x)
    if area == 0:
        area = math.sqrt(x * x + y * y + z * z)
    return total[INTENSITY] * area * orientation_measure(total[THETA_O], total[THETA_E])


@allocating_kernel
def cut(rows, order, cost_uncut):
    """Rearrange the lights of a set and `order`; the size of the first part, 0 for a leaf."""
    num = len(rows)
    centers = (rows[:, BOX_MIN:BOX_MAX] + rows[:, BOX_MAX:BOX_AXIS]) / 2
    low, extent = np.zeros(3), np.zeros(3)
    for k in range(3):
        low[k] = centers[:, k].min()
        extent[k] = centers[:, k].max() - low[k]
    best_cost, best_side, best_bucket = np.inf, -1, 0
    for k in range(3):
        if num > 1 and extent[k] > 0:
            side_cost, bucket = cheapest_cut(rows, (centers[:, k] - low[k]) / extent[k])
            side_cost *= extent.max() / extent[k]
            if side_cost < best_cost:
                best_cost, best_side, best_bucket = side_cost, k, bucket
    if num <= MOST_LIGHTS and not best_cost < cost_uncut:
        return 0
    if best_side < 0:
        return num // 2
    is_second = (
        bucket_of((centers[:, best_side] - low[best_side]) / extent[best_side]) > best_bucket
    )
    new_order = np.argsort(is_second, kind="mergesort")
    rows[:], order[:] = rows[new_order].copy(), order[new_order].copy()
    return num - is_second.sum()


@allocating_kernel
def bucket_of(x):
    """Buckets of places from 0 to 1."""
    return np.minimum(NUM_BUCKETS - 1, (x * NUM_BUCKETS).astype(np.int64))


@allocating_kernel
def cheapest_cut(rows, x):
    """(cost, last bucket of the first part) of the best cut along one side, at places x."""
    buckets = bucket_of(x)
    sums = np.zeros((NUM_BUCKETS, NUM_ROW_COLUMNS))
    total, costs = np.zeros(NUM_ROW_COLUMNS), np.full(NUM_BUCKETS, np.inf)
    for i in range(NUM_BUCKETS):
        clear(sums[i])
    for i in range(len(rows)):
        merge(sums[buckets[i]], rows[i])
    clear(total)
    for i in range(NUM_BUCKETS - 1):
        merge(total, sums[i])
        costs[i] = cost(total)
    clear(total)
    for i in range(NUM_BUCKETS - 1, 0, -1):
        merge(total, sums[i])
        # The first bucket and the last are never empty.
        costs[i - 1] += cost(total)
    return costs.min(), costs.argmin()
