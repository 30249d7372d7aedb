"""Building a light tree: top down, binned, by the surface-area-orientation heuristic.

Conty Estevez and Kulla 2018, section 4, with one departure: the cone of a candidate set is
estimated from the mean of its axes, which adds up over bins, instead of merged light by light.
Distant lights (sun, background) form a subtree of their own beside that of all other lights.
"""

import math

import numpy as np

from ..jit import allocating_kernel
from ..lights import LightBounds
from .nodes import (
    APEX_SHIFT,
    AXIS,
    AXIS_LENGTH,
    COS_CONE,
    COSINE_SHARE,
    ENERGY,
    HALF_EXTENT,
    MEAN,
    NUM_TRAIL_BITS,
    VARIANCE,
    LightTree,
    allocate_tree,
)

NUM_BINS = 12
# Below this depth sets are halved by count, so no trail outgrows its bits.
MAX_SPLIT_DEPTH = NUM_TRAIL_BITS - 32
# Columns of the sums over a bin.
SUM_ENERGY, COUNT, SUM_AXIS, THETA_E, BOX_MIN, BOX_MAX = 0, 1, 2, 5, 6, 9
NUM_COLUMNS = 12
# A cone narrower than this, in radians, is bounded by one of this angle.
MIN_CONE_ANGLE = 1e-3
# One wider than this is taken as the whole sphere.
MAX_CONE_ANGLE = math.pi - 1e-3


def build_tree(bounds: LightBounds) -> LightTree:
    """The light tree over all lights whose energy is not zero."""
    is_lit = bounds.energy > 0
    local = np.flatnonzero(is_lit & ~bounds.is_distant).astype(np.int32)
    distant = np.flatnonzero(is_lit & bounds.is_distant).astype(np.int32)
    num_nodes = max(0, 2 * len(local) - 1) + max(0, 2 * len(distant) - 1)
    has_both = len(local) > 0 and len(distant) > 0
    tree = allocate_tree(num_nodes + has_both, len(bounds.energy))
    if has_both:
        tree.first_child[0] = 1
        # The root over both is never weighed against another node.
        tree.rows[0, ENERGY], tree.rows[0, VARIANCE], tree.rows[0, HALF_EXTENT] = 1, np.inf, 1
        _build_subtree(tree, bounds, local, 1, 3, 1, np.uint64(0))
        _build_subtree(tree, bounds, distant, 2, 1 + 2 * len(local), 1, np.uint64(1))
    elif num_nodes:
        _build_subtree(tree, bounds, local if len(local) else distant, 0, 1, 0, np.uint64(0))
    return tree


@allocating_kernel
def _build_subtree(tree, bounds, order, root, next_free, root_depth, root_trail):
    """Fill the nodes over the lights in `order`, which is rearranged; children from next_free."""
    num_stacked = 1
    stack = np.zeros((2 * NUM_TRAIL_BITS, 4), np.int64)
    trails = np.zeros(2 * NUM_TRAIL_BITS, np.uint64)
    stack[0] = (root, 0, len(order), root_depth)
    trails[0] = root_trail
    bins = np.zeros((3, NUM_BINS, NUM_COLUMNS))
    while num_stacked > 0:
        num_stacked -= 1
        node, first, last, depth = stack[num_stacked]
        trail = trails[num_stacked]
        if bounds.is_distant[order[first]]:
            _summarize_distant(tree.rows[node], bounds, order[first:last])
        else:
            _summarize_local(tree.rows[node], bounds, order[first:last])
        if last - first == 1:
            light = order[first]
            tree.first_child[node] = ~light
            tree.leaf[light] = node
            tree.trail[light] = trail
            continue
        middle = (first + last) // 2
        if last - first > 2 and depth < MAX_SPLIT_DEPTH:
            middle = first + _split(bounds, order[first:last], bins)
        tree.first_child[node] = next_free
        stack[num_stacked] = (next_free, first, middle, depth + 1)
        trails[num_stacked] = trail
        stack[num_stacked + 1] = (next_free + 1, middle, last, depth + 1)
        trails[num_stacked + 1] = trail | np.uint64(1) << np.uint64(depth)
        num_stacked += 2
        next_free += 2


@allocating_kernel
def _summarize_distant(row, bounds, lights):
    """Moments and bounds of sun and background: one light exactly, several without a direction."""
    row[VARIANCE] = np.inf
    row[HALF_EXTENT] = 1.0
    for light in lights:
        row[ENERGY] += bounds.energy[light]
    if len(lights) == 1:
        row[MEAN : MEAN + 3] = -bounds.axis[lights[0]]
        if bounds.theta_e[lights[0]] < math.pi / 2:
            row[HALF_EXTENT] = math.sin(bounds.theta_e[lights[0]])


@allocating_kernel
def _summarize_local(row, bounds, lights):
    """Moments and bounds of a set of lights, over all of them."""
    energy, axis_energy, cosine_energy = 0.0, 0.0, 0.0
    mean, axis = np.zeros(3), np.zeros(3)
    box_min, box_max = np.full(3, np.inf), np.full(3, -np.inf)
    for light in lights:
        e = bounds.energy[light]
        energy += e
        cosine_energy += e * bounds.is_cosine[light]
        axis_energy += e * (bounds.theta_e[light] < math.pi)
        for k in range(3):
            mean[k] += e * bounds.mean[light, k]
            axis[k] += e * bounds.axis[light, k]
            box_min[k] = min(box_min[k], bounds.box_min[light, k])
            box_max[k] = max(box_max[k], bounds.box_max[light, k])
    mean /= energy
    axis /= max(axis_energy, 1e-300)
    axis_length = math.sqrt((axis**2).sum())
    if axis_length > 0:
        axis /= axis_length
    row[ENERGY] = energy
    row[COSINE_SHARE] = cosine_energy / energy
    row[AXIS : AXIS + 3] = axis
    row[AXIS_LENGTH] = axis_length
    row[MEAN : MEAN + 3] = mean
    radius_sq = 0.0
    for k in range(3):
        # Around the rounded mean, and rounded up.
        reach = max(box_max[k] - row[MEAN + k], row[MEAN + k] - box_min[k]) * (1 + 2.0**-20)
        row[HALF_EXTENT + k] = reach
        radius_sq += reach * reach
    row[VARIANCE] = _variance(bounds, lights, mean) / energy
    cone = max(MIN_CONE_ANGLE, _cone_angle(bounds, lights, axis))
    row[COS_CONE] = math.cos(cone)
    if cone < math.pi:
        row[APEX_SHIFT] = math.sqrt(radius_sq) / math.sin(cone)


@allocating_kernel
def _variance(bounds, lights, mean):
    """Sum of energy times squared distance from the mean position."""
    total = 0.0
    for light in lights:
        dist_sq = bounds.variance[light]
        for k in range(3):
            dist_sq += (bounds.mean[light, k] - mean[k]) ** 2
        total += bounds.energy[light] * dist_sq
    return total


@allocating_kernel
def _cone_angle(bounds, lights, axis):
    """Largest angle from a unit axis, or from none, at which any light emits; pi at most."""
    angle = 0.0
    for light in lights:
        cos_axis = 0.0
        for k in range(3):
            cos_axis += bounds.axis[light, k] * axis[k]
        between = math.acos(min(1.0, max(-1.0, cos_axis)))
        angle = max(angle, between + bounds.theta_e[light])
        if angle > MAX_CONE_ANGLE:
            return math.pi
    return angle


@allocating_kernel
def _split(bounds, lights, bins):
    """Rearrange lights into two sets of least cost; the size of the first."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for light in lights:
        for k in range(3):
            low[k] = min(low[k], bounds.mean[light, k])
            high[k] = max(high[k], bounds.mean[light, k])
    extent = high - low
    if not extent.max() > 0:
        return len(lights) // 2
    _fill_bins(bounds, lights, low, extent, bins)
    best_cost, best_axis, best_bin = np.inf, -1, 0
    for k in range(3):
        if extent[k] > 0:
            cost, split_bin = _cheapest_split(bins[k])
            # Conty and Kulla's factor against thin boxes.
            cost *= extent.max() / extent[k]
            if cost < best_cost:
                best_cost, best_axis, best_bin = cost, k, split_bin
    if best_axis < 0:
        return len(lights) // 2
    first, last = 0, len(lights)
    while first < last:
        if _bin_of(bounds.mean[lights[first], best_axis], low, extent, best_axis) <= best_bin:
            first += 1
        else:
            last -= 1
            lights[first], lights[last] = lights[last], lights[first]
    return first


@allocating_kernel
def _bin_of(x, low, extent, axis):
    return min(NUM_BINS - 1, int(NUM_BINS * ((x - low[axis]) / extent[axis])))


@allocating_kernel
def _fill_bins(bounds, lights, low, extent, bins):
    """Sort lights into bins by their centres, along every axis that has an extent."""
    bins[:] = 0.0
    bins[:, :, BOX_MIN:BOX_MAX] = np.inf
    bins[:, :, BOX_MAX:] = -np.inf
    for light in lights:
        e = bounds.energy[light]
        for axis in range(3):
            if extent[axis] > 0:
                row = bins[axis, _bin_of(bounds.mean[light, axis], low, extent, axis)]
                row[SUM_ENERGY] += e
                row[COUNT] += 1
                row[THETA_E] = max(row[THETA_E], min(bounds.theta_e[light], math.pi / 2))
                for k in range(3):
                    row[SUM_AXIS + k] += e * bounds.axis[light, k]
                    row[BOX_MIN + k] = min(row[BOX_MIN + k], bounds.box_min[light, k])
                    row[BOX_MAX + k] = max(row[BOX_MAX + k], bounds.box_max[light, k])


@allocating_kernel
def _merge(total, row):
    """Add one summary to another."""
    for k in range(THETA_E):
        total[k] += row[k]
    total[THETA_E] = max(total[THETA_E], row[THETA_E])
    for k in range(3):
        total[BOX_MIN + k] = min(total[BOX_MIN + k], row[BOX_MIN + k])
        total[BOX_MAX + k] = max(total[BOX_MAX + k], row[BOX_MAX + k])


@allocating_kernel
def _cheapest_split(bins):
    """(cost, last bin of the first set); infinite if all lights are in one bin."""
    empty = np.zeros(NUM_COLUMNS)
    empty[BOX_MIN:BOX_MAX] = np.inf
    empty[BOX_MAX:] = -np.inf
    right_cost = np.zeros(NUM_BINS)
    total = empty.copy()
    for i in range(NUM_BINS - 1, 0, -1):
        _merge(total, bins[i])
        right_cost[i - 1] = _cost(total) if total[COUNT] > 0 else np.inf
    total = empty.copy()
    best_cost, best = np.inf, 0
    for i in range(NUM_BINS - 1):
        _merge(total, bins[i])
        if total[COUNT] > 0:
            cost = _cost(total) + right_cost[i]
            if cost < best_cost:
                best_cost, best = cost, i
    return best_cost, best


@allocating_kernel
def _cost(summary):
    """Energy x surface area x orientation measure of a set of lights."""
    x = summary[BOX_MAX] - summary[BOX_MIN]
    y = summary[BOX_MAX + 1] - summary[BOX_MIN + 1]
    z = summary[BOX_MAX + 2] - summary[BOX_MIN + 2]
    # A share of the squared diagonal keeps sets on a line apart, whose boxes have no area.
    area = x * y + y * z + z * x + 1e-3 * (x * x + y * y + z * z)
    axis = summary[SUM_AXIS : SUM_AXIS + 3]
    len_axis = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    # Axes spread evenly over a cap of angle theta_o have a mean of length (1 + cos theta_o) / 2.
    cos_o = min(1.0, max(-1.0, 2.0 * len_axis / summary[SUM_ENERGY] - 1.0))
    return summary[SUM_ENERGY] * area * orientation_measure(math.acos(cos_o), summary[THETA_E])


@allocating_kernel
def orientation_measure(theta_o, theta_e):
    """Conty and Kulla's M_Omega: the solid angle of emission, weighted by the cosine."""
    theta_w = min(theta_o + theta_e, math.pi)
    sin_o, cos_o = math.sin(theta_o), math.cos(theta_o)
    return 2 * math.pi * (1 - cos_o) + math.pi / 2 * (
        2 * theta_w * sin_o - math.cos(theta_o - 2 * theta_w) - 2 * theta_o * sin_o + cos_o
    )
