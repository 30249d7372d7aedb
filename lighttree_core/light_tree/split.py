"""Cutting a set of lights in two, by any of the strategies of `options.TreeOptions`.

The lights of a set are consecutive rows of a table, which a cut rearranges. Candidate cuts are the
bounds of buckets along each side of the box of the lights' centres; two centres at one place are
never told apart. Conty Estevez and Kulla 2018, section 4, with one departure: with "mean" axes the
cone of a candidate set is estimated from the mean of its axes, which adds up over buckets.
"""

import math
from typing import NamedTuple

import numpy as np

from ..jit import allocating_kernel, flag, i64, table
from .options import CONE_UNION, EQUAL, EQUAL_COUNT, MIDDLE, SAH, TreeOptions

# Columns of the table of lights: what building needs, in the order in which it is read.
ROW_MEAN, ROW_MIN, ROW_MAX, ROW_AXIS, ROW_FLUX = 0, 3, 6, 9, 12
ROW_PEAK, ROW_MEAN_COS, ROW_THETA_E, ROW_VARIANCE, ROW_FADE = 13, 14, 15, 16, 17
NUM_ROW_COLUMNS = 18

# Columns of the sums over a bucket.
SUM_FLUX, COUNT, SUM_AXIS, THETA_O, THETA_E, BOX_MIN, BOX_MAX = 0, 1, 2, 5, 6, 7, 10
NUM_SUM_COLUMNS = 13


@table
class Split(NamedTuple):
    """`options.TreeOptions` for kernels."""

    by_count: flag
    by_middle: flag
    by_orientation: flag
    thin_box: flag
    num_buckets: i64
    equal_count: flag
    union: flag


def split_options(options: TreeOptions) -> Split:
    """The part of the options that decides over cuts."""
    return Split(
        by_count=options.split == EQUAL,
        by_middle=options.split == MIDDLE,
        by_orientation=options.split != SAH,
        thin_box=options.thin_box and options.split != SAH,
        num_buckets=options.buckets,
        equal_count=options.bucket_kind == EQUAL_COUNT or options.buckets == 0,
        union=options.cone_axis == CONE_UNION,
    )


@allocating_kernel
def split_set(split, rows, order, buckets):
    """Rearrange the rows of a set, and `order` with them; the size of the first part.

    rows: (n, NUM_ROW_COLUMNS). order: (n,) their lights. buckets: (n,) int32, overwritten.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for row in rows:
        for k in range(3):
            low[k] = min(low[k], row[ROW_MEAN + k])
            high[k] = max(high[k], row[ROW_MEAN + k])
    extent = high - low
    longest = np.argmax(extent)
    if not extent[longest] > 0:
        return len(rows) // 2
    if split.by_count or split.by_middle:
        fill_buckets(rows, buckets, longest, low, extent, 2, split.by_count)
        return _partition(rows, order, buckets, 0)
    num = len(rows) if split.num_buckets == 0 else min(split.num_buckets, max(4, len(rows)))
    sums = np.zeros((num, NUM_SUM_COLUMNS))
    best_cost, best_side, best_bucket = np.inf, -1, 0
    for side in range(3):
        if extent[side] > 0:
            fill_buckets(rows, buckets, side, low, extent, num, split.equal_count)
            _sum_buckets(split, rows, buckets, sums)
            cost, bucket = _cheapest_cut(split, sums)
            if split.thin_box:
                cost *= extent[longest] / extent[side]
            if cost < best_cost:
                best_cost, best_side, best_bucket = cost, side, bucket
    if best_side < 0:
        return len(rows) // 2
    fill_buckets(rows, buckets, best_side, low, extent, num, split.equal_count)
    return _partition(rows, order, buckets, best_bucket)


@allocating_kernel
def fill_buckets(rows, buckets, side, low, extent, num, equal_count):
    """The bucket of each light along a side: of equal width, or of equal count."""
    if equal_count:
        ranks = np.argsort(rows[:, ROW_MEAN + side], kind="mergesort")
        for rank in range(len(ranks)):
            buckets[ranks[rank]] = rank * num // len(ranks)
    else:
        scale = num / extent[side]
        for i in range(len(rows)):
            buckets[i] = min(num - 1, int((rows[i, ROW_MEAN + side] - low[side]) * scale))


@allocating_kernel
def _partition(rows, order, buckets, last_bucket):
    """Move the lights in buckets up to `last_bucket` to the front; how many they are."""
    first, last = 0, len(rows)
    while first < last:
        if buckets[first] <= last_bucket:
            first += 1
            continue
        last -= 1
        buckets[first], buckets[last] = buckets[last], buckets[first]
        order[first], order[last] = order[last], order[first]
        for k in range(NUM_ROW_COLUMNS):
            rows[first, k], rows[last, k] = rows[last, k], rows[first, k]
    return first


@allocating_kernel
def clear_sum(total):
    """The summary of no lights."""
    total[:] = 0.0
    total[THETA_O] = -1.0
    total[BOX_MIN:BOX_MAX] = np.inf
    total[BOX_MAX:] = -np.inf


@allocating_kernel
def _sum_buckets(split, rows, buckets, sums):
    """What the cost of a set needs to know, for each bucket."""
    for i in range(len(sums)):
        clear_sum(sums[i])
    # Elements, not views of rows, which are counted: 8 ns a light instead of 23.
    for i in range(len(rows)):
        b, flux = buckets[i], np.float64(rows[i, ROW_FLUX])
        sums[b, SUM_FLUX] += flux
        sums[b, COUNT] += 1
        theta_e = min(math.pi / 2, np.float64(rows[i, ROW_THETA_E]))
        if theta_e > sums[b, THETA_E]:
            sums[b, THETA_E] = theta_e
        if split.union:
            merge_cone(sums[b], rows[i, ROW_AXIS : ROW_AXIS + 3], 0.0)
        else:
            for k in range(3):
                sums[b, SUM_AXIS + k] += flux * rows[i, ROW_AXIS + k]
        for k in range(3):
            if rows[i, ROW_MIN + k] < sums[b, BOX_MIN + k]:
                sums[b, BOX_MIN + k] = rows[i, ROW_MIN + k]
            if rows[i, ROW_MAX + k] > sums[b, BOX_MAX + k]:
                sums[b, BOX_MAX + k] = rows[i, ROW_MAX + k]


@allocating_kernel
def _merge(split, total, other):
    """Add one summary to another."""
    if other[COUNT] == 0:
        return
    total[SUM_FLUX] += other[SUM_FLUX]
    total[COUNT] += other[COUNT]
    total[THETA_E] = max(total[THETA_E], other[THETA_E])
    if split.union:
        merge_cone(total, other[SUM_AXIS : SUM_AXIS + 3], other[THETA_O])
    else:
        for k in range(3):
            total[SUM_AXIS + k] += other[SUM_AXIS + k]
    for k in range(3):
        total[BOX_MIN + k] = min(total[BOX_MIN + k], other[BOX_MIN + k])
        total[BOX_MAX + k] = max(total[BOX_MAX + k], other[BOX_MAX + k])


@allocating_kernel
def merge_cone(total, axis, theta):
    """Widen the cone of a summary, (SUM_AXIS, THETA_O), to hold another; axis 0 is the sphere."""
    own, own_theta = total[SUM_AXIS : SUM_AXIS + 3], total[THETA_O]
    if (axis[0] == 0 and axis[1] == 0 and axis[2] == 0) or own_theta == math.pi:
        total[THETA_O] = math.pi
        return
    if own_theta < 0:
        own[0], own[1], own[2] = axis[0], axis[1], axis[2]
        total[THETA_O] = theta
        return
    cos_between = own[0] * axis[0] + own[1] * axis[1] + own[2] * axis[2]
    between = math.acos(min(1.0, max(-1.0, cos_between)))
    if between + theta <= own_theta:
        return
    if between + own_theta <= theta:
        own[0], own[1], own[2] = axis[0], axis[1], axis[2]
        total[THETA_O] = theta
        return
    theta_o = (own_theta + between + theta) / 2
    sin_between = math.sin(between)
    if theta_o >= math.pi or sin_between < 1e-6:
        total[THETA_O] = min(math.pi, theta_o) if cos_between > 0 else math.pi
        return
    turn = theta_o - own_theta
    # The other axis, seen along the own one: where that turns to.
    a, b = math.sin(between - turn) / sin_between, math.sin(turn) / sin_between
    for k in range(3):
        own[k] = a * own[k] + b * axis[k]
    total[THETA_O] = theta_o


@allocating_kernel
def _cheapest_cut(split, sums):
    """(cost, last bucket of the first part); infinite if all lights are in one bucket."""
    num = len(sums)
    right_cost = np.full(num, np.inf)
    total = np.zeros(NUM_SUM_COLUMNS)
    clear_sum(total)
    for i in range(num - 1, 0, -1):
        _merge(split, total, sums[i])
        if total[COUNT] > 0:
            right_cost[i - 1] = _cost(split, total)
    clear_sum(total)
    best_cost, best = np.inf, 0
    for i in range(num - 1):
        _merge(split, total, sums[i])
        if total[COUNT] > 0:
            cost = _cost(split, total) + right_cost[i]
            if cost < best_cost:
                best_cost, best = cost, i
    return best_cost, best


@allocating_kernel
def _cost(split, total):
    """Cost of a set: its box's area x its lights (sah), or x their power x their orientation."""
    x = total[BOX_MAX] - total[BOX_MIN]
    y = total[BOX_MAX + 1] - total[BOX_MIN + 1]
    z = total[BOX_MAX + 2] - total[BOX_MIN + 2]
    # A share of the squared diagonal keeps sets on a line apart, whose boxes have no area.
    area = x * y + y * z + z * x + 1e-3 * (x * x + y * y + z * z)
    if not split.by_orientation:
        return total[COUNT] * area
    theta_o = total[THETA_O]
    if not split.union:
        axis = total[SUM_AXIS : SUM_AXIS + 3]
        length = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
        # Axes spread evenly over a cap of angle theta_o have a mean of (1 + cos theta_o) / 2.
        theta_o = math.acos(min(1.0, max(-1.0, 2.0 * length / total[SUM_FLUX] - 1.0)))
    return total[SUM_FLUX] * area * orientation_measure(theta_o, total[THETA_E])


@allocating_kernel
def orientation_measure(theta_o, theta_e):
    """Conty and Kulla's M_Omega: the solid angle of emission, weighted by the cosine."""
    theta_w = min(theta_o + theta_e, math.pi)
    sin_o, cos_o = math.sin(theta_o), math.cos(theta_o)
    return 2 * math.pi * (1 - cos_o) + math.pi / 2 * (
        2 * theta_w * sin_o - math.cos(theta_o - 2 * theta_w) - 2 * theta_o * sin_o + cos_o
    )
