"""Building a light tree: cut all lights in two and again, then gather the cuts into wide nodes.

First a binary hierarchy of sets, top down (`split.py`), until a set fits into one node. Then, from
the root, a node takes the two parts of its set and opens whichever is largest, by power x spread,
until its lanes are full; sets that fit into a node come last, and where all their lights fit too.
Each lane is summarized from its lights, not from other lanes. Distant lights (sun, background)
hang at the root.

Sets are numbered in preorder, so where a set lies in the tables does not depend on which thread cut
it or when: any number of threads builds the same tree.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..jit import allocating_kernel, f64, i32, table
from ..lights import LightBounds
from .bounds import summarize_bounds
from .importance import BEAM_FLOOR_SHARE, FLOOR_SHARE, LOBE_SCALE, MAX_MEAN_COS
from .nodes import (
    APEX_SHIFT,
    AXIS,
    COS_CONE,
    FLOOR,
    FLUX,
    HALF_EXTENT,
    MEAN,
    MEAN_COS,
    NO_LANE,
    NUM_LANES,
    VARIANCE,
    LightTree,
    allocate_tree,
    store_box,
)
from .options import CONE_UNION, IMPORTANCES, MOMENTS_ID, TreeOptions
from .split import (
    NUM_ROW_COLUMNS,
    ROW_AXIS,
    ROW_FADE,
    ROW_FLUX,
    ROW_MAX,
    ROW_MEAN,
    ROW_MEAN_COS,
    ROW_MIN,
    ROW_PEAK,
    ROW_THETA_E,
    ROW_VARIANCE,
    split_options,
    split_set,
)

# From this depth on sets are halved by count, which 31 more cuts bring to an end.
MAX_SPLIT_DEPTH = 64
# Sets of more lights are cut one by one on all threads; smaller ones to the end on one.
GRAIN = 1 << 14
NUM_PARTS = 16
NO_SET = -1
# A cone narrower than this, in radians, is bounded by one of this angle.
MIN_CONE_ANGLE = 1e-3
# One wider than this is taken as the whole sphere.
MAX_CONE_ANGLE = 3.0


@table
class Sets(NamedTuple):
    """The binary hierarchy; the set s of lights order[first[s]:last[s]] is cut at middle[s].

    Its parts are s + 1 and s + 2 (middle - first). Sets that fit into a node are not cut.
    size: power x spread, by which sets are opened.
    """

    first: i32[::1]
    last: i32[::1]
    middle: i32[::1]
    size: f64[::1]


class LaneSets(NamedTuple):
    """(n, NUM_LANES) int32: the lights of each lane are order[first:last]; node: its node or 0.

    While nodes are gathered: one node's lanes, and in place of the node the set, or NO_SET.
    """

    first: np.ndarray
    last: np.ndarray
    node: np.ndarray


def build_tree(
    bounds: LightBounds, options: TreeOptions | None = None, threads: int = 1
) -> LightTree:
    """The light tree over all lights whose flux is not zero."""
    options = options or TreeOptions()
    is_lit = bounds.flux > 0
    local = np.flatnonzero(is_lit & ~bounds.is_distant)
    distant = np.flatnonzero(is_lit & bounds.is_distant)
    order = np.concatenate([local, distant]).astype(np.int32)
    if len(order) == 0:
        return allocate_tree(0, len(bounds.flux))
    rows = np.empty((len(order), NUM_ROW_COLUMNS), np.float32)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda part: fill_rows(bounds, order[part], rows[part]), _parts(len(order))))
        sets, roots = _cut_all(options, rows, order, len(local), pool)
        lanes, parent = gather_nodes(sets, roots, options.width)
        tree = allocate_tree(len(parent), len(bounds.flux))._replace(
            parent=parent, depth=_depth(parent), importance=IMPORTANCES.index(options.importance)
        )
        by_union = options.cone_axis == CONE_UNION
        list(
            pool.map(
                lambda part: fill_nodes(
                    tree, rows, order, len(local), lanes, by_union, part.start, part.stop
                ),
                _parts(len(parent)),
            )
        )
    return tree


def _parts(num: int) -> list[slice]:
    """A range in parts for the threads to share."""
    size = max(1, num // NUM_PARTS)
    return [slice(first, min(first + size, num)) for first in range(0, num, size)]


@allocating_kernel
def fill_rows(bounds, order, rows):
    """Write the table of lights that cuts and summaries read; boxes are rounded outwards."""
    for i, light in enumerate(order):
        row = rows[i]
        for k in range(3):
            row[ROW_MEAN + k] = bounds.mean[light, k]
            row[ROW_AXIS + k] = bounds.axis[light, k]
            low, high = bounds.box_min[light, k], bounds.box_max[light, k]
            row[ROW_MIN + k], row[ROW_MAX + k] = low, high
            if row[ROW_MIN + k] > low:
                row[ROW_MIN + k] = np.nextafter(row[ROW_MIN + k], np.float32(-np.inf))
            if row[ROW_MAX + k] < high:
                row[ROW_MAX + k] = np.nextafter(row[ROW_MAX + k], np.float32(np.inf))
        row[ROW_FLUX], row[ROW_PEAK] = bounds.flux[light], bounds.peak[light]
        row[ROW_MEAN_COS], row[ROW_THETA_E] = bounds.mean_cos[light], bounds.theta_e[light]
        row[ROW_VARIANCE], row[ROW_FADE] = bounds.variance[light], bounds.fade[light]


def _cut_all(options, rows, order, num_local, pool) -> tuple[Sets, np.ndarray]:
    """All sets, and the one or two they start from; rearranges rows and order."""
    num = len(order)
    sets = Sets(*(np.zeros(2 * num, np.int32) for _ in range(3)), np.zeros(2 * num))
    split, buckets = split_options(options), np.zeros(num, np.int32)

    def cut(task, is_last):
        return cut_sets(split, options.width, sets, rows, order, buckets, *task, is_last)

    todo, small, roots = [], [], []
    # The depth of distant lights keeps them from being cut by place.
    for first, last, depth in ((0, num_local, 0), (num_local, num, MAX_SPLIT_DEPTH)):
        if last > first:
            roots.append(2 * first)
            todo.append((2 * first, first, last, depth))
    while todo:
        small += [task for task in todo if task[2] - task[1] <= GRAIN]
        large = [task for task in todo if task[2] - task[1] > GRAIN]
        list(pool.map(lambda task: cut(task, False), large))
        todo = []
        for s, first, last, depth in large:
            middle = int(sets.middle[s])
            todo.append((s + 1, first, middle, depth + 1))
            todo.append((s + 2 * (middle - first), middle, last, depth + 1))
    small.sort(key=lambda task: task[1] - task[2])
    list(pool.map(lambda task: cut(task, True), small))
    return sets, np.array(roots, np.int32)


@allocating_kernel
def cut_sets(split, width, sets, rows, order, buckets, root, first, last, depth, to_the_end):
    """Cut one set in two, or it and its parts until they fit into nodes of `width` lanes."""
    stack = np.zeros((4 * MAX_SPLIT_DEPTH, 4), np.int64)
    stack[0] = (root, first, last, depth)
    num_stacked = 1
    while num_stacked > 0:
        num_stacked -= 1
        s, first, last, depth = stack[num_stacked]
        part, is_halved = rows[first:last], depth >= MAX_SPLIT_DEPTH
        sets.first[s], sets.last[s] = first, last
        sets.size[s] = np.inf if is_halved else _power_spread(part)
        if last - first <= width:
            continue
        middle = (first + last) // 2
        if not is_halved:
            middle = first + split_set(split, part, order[first:last], buckets[first:last])
        sets.middle[s] = middle
        if to_the_end:
            stack[num_stacked] = (s + 1, first, middle, depth + 1)
            stack[num_stacked + 1] = (s + 2 * (middle - first), middle, last, depth + 1)
            num_stacked += 2


@allocating_kernel
def _power_spread(rows):
    """Power of a set of lights, W, times the standard deviation of their places, m."""
    flux, sums, squares = 0.0, np.zeros(3), 0.0
    for row in rows:
        flux += row[ROW_FLUX]
        for k in range(3):
            # About the first light, as squares far from the origin cancel.
            x = np.float64(row[ROW_MEAN + k]) - rows[0, ROW_MEAN + k]
            sums[k] += row[ROW_FLUX] * x
            squares += row[ROW_FLUX] * x * x
    return math.sqrt(max(0.0, flux * squares - (sums**2).sum()))


@allocating_kernel
def gather_nodes(sets, roots, width):
    """(lanes of all nodes, parent lane of each node)."""
    # At most as many nodes as lights, mostly a tenth: memory never written costs nothing.
    num = len(sets.first) // 2
    first, last, lane_set, node = (
        np.empty((num, NUM_LANES), np.int32),
        np.empty((num, NUM_LANES), np.int32),
        np.empty((num, NUM_LANES), np.int32),
        np.empty((num, NUM_LANES), np.int32),
    )
    parent = np.empty(num, np.int32)
    first[0], last[0] = 0, 0
    for k, s in enumerate(roots):
        lane_set[0, k], first[0, k], last[0, k] = s, sets.first[s], sets.last[s]
    parent[0], num_nodes, i = NO_LANE, 1, 0
    while i < num_nodes:
        lanes = LaneSets(first[i], last[i], lane_set[i])
        used = len(roots)
        if i > 0:
            first[i], last[i] = 0, 0
            a, b = parent[i] // NUM_LANES, parent[i] % NUM_LANES
            lanes.first[0], lanes.last[0], lanes.node[0] = first[a, b], last[a, b], lane_set[a, b]
            used = 1
        if used == 1:
            used = _open(sets, width, lanes, 0, 1)
        elif lanes.last[1] - lanes.first[1] <= width // 2:
            used = _open(sets, width, lanes, 1, 2)
        used = _open_all(sets, width, lanes, used)
        node[i] = 0
        for k in range(used):
            if last[i, k] - first[i, k] > 1:
                node[i, k], parent[num_nodes] = num_nodes, i * NUM_LANES + k
                num_nodes += 1
        i += 1
    lanes = LaneSets(first[:num_nodes].copy(), last[:num_nodes].copy(), node[:num_nodes].copy())
    return lanes, parent[:num_nodes].copy()


@allocating_kernel
def _open(sets, width, lanes, k, used):
    """Put the parts of the set in lane k in its place and into unused lanes; lanes in use."""
    s, first, last = lanes.node[k], lanes.first[k], lanes.last[k]
    if last - first <= width:
        for light in range(first, last):
            lane = k if light == first else used + light - first - 1
            lanes.first[lane], lanes.last[lane], lanes.node[lane] = light, light + 1, NO_SET
        return used + last - first - 1
    middle = sets.middle[s]
    lanes.last[k], lanes.node[k] = middle, s + 1
    lanes.first[used], lanes.last[used] = middle, last
    lanes.node[used] = s + 2 * (middle - first)
    return used + 1


@allocating_kernel
def _open_all(sets, width, lanes, used):
    """Open the largest sets until the lanes are full, then small ones that fit; lanes in use."""
    while True:
        best, best_size, best_is_large = -1, -1.0, False
        for k in range(used):
            num_lights = lanes.last[k] - lanes.first[k]
            is_large = num_lights > width
            num_new = 1 if is_large else num_lights - 1
            if num_new == 0 or used + num_new > width or (best_is_large and not is_large):
                continue
            size = sets.size[lanes.node[k]]
            if size > best_size or is_large > best_is_large:
                best, best_size, best_is_large = k, size, is_large
        if best < 0:
            return used
        used = _open(sets, width, lanes, best, used)


@allocating_kernel
def fill_nodes(tree, rows, order, num_local, lanes, by_union, first_node, last_node):
    """Summarize the lanes of some nodes."""
    for node in range(first_node, last_node):
        for k in range(NUM_LANES):
            first, last = lanes.first[node, k], lanes.last[node, k]
            if first == last:
                continue
            column = tree.columns[node, k::NUM_LANES]
            if first >= num_local:
                _summarize_distant(column, rows[first:last])
            elif tree.importance == MOMENTS_ID:
                _summarize_moments(column, rows[first:last])
            else:
                summarize_bounds(column, rows[first:last], by_union)
            tree.child[node, k] = lanes.node[node, k]
            if last - first == 1:
                tree.child[node, k] = ~order[first]
                tree.light_lane[order[first]] = node * NUM_LANES + k


@allocating_kernel
def _summarize_distant(column, rows):
    """Sun and background: one light exactly, several without a direction."""
    column[VARIANCE] = np.inf
    column[HALF_EXTENT] = 1.0
    for row in rows:
        column[FLUX] += row[ROW_FLUX]
    if len(rows) == 1:
        column[MEAN : MEAN + 3] = -rows[0, ROW_AXIS : ROW_AXIS + 3]
        if rows[0, ROW_THETA_E] < math.pi / 2:
            column[HALF_EXTENT] = math.sin(rows[0, ROW_THETA_E])


@allocating_kernel
def _summarize_moments(column, rows):
    """Moments and bounds of a set of lights, over all of them."""
    flux, peak = 0.0, 0.0
    mean, axis = np.zeros(3), np.zeros(3)
    box_min, box_max = np.full(3, np.inf), np.full(3, -np.inf)
    for row in rows:
        flux += row[ROW_FLUX]
        peak += row[ROW_PEAK]
        for k in range(3):
            mean[k] += np.float64(row[ROW_FLUX]) * row[ROW_MEAN + k]
            axis[k] += np.float64(row[ROW_FLUX]) * row[ROW_MEAN_COS] * row[ROW_AXIS + k]
            box_min[k] = min(box_min[k], row[ROW_MIN + k])
            box_max[k] = max(box_max[k], row[ROW_MAX + k])
    mean /= flux
    axis /= flux
    mean_cos = math.sqrt((axis**2).sum())
    axis /= max(mean_cos, 1e-300)
    column[FLUX] = LOBE_SCALE * flux
    column[FLOOR] = FLOOR_SHARE * peak
    column[AXIS : AXIS + 3] = axis
    column[MEAN_COS] = min(mean_cos, MAX_MEAN_COS)
    column[MEAN : MEAN + 3] = mean
    radius_sq = store_box(column, box_min, box_max)
    column[VARIANCE] = _variance(rows, mean) / flux
    is_beam = len(rows) == 1 and rows[0, ROW_FADE] < np.inf
    # The angle between two axes is not exact, and a beam has but one.
    cone = max(MIN_CONE_ANGLE, rows[0, ROW_THETA_E] if is_beam else cone_angle(rows, axis))
    column[COS_CONE] = math.cos(cone)
    if cone < math.pi:
        column[APEX_SHIFT] = math.sqrt(radius_sq) / math.sin(cone)
    if is_beam:
        column[FLUX] = peak
        column[FLOOR] = BEAM_FLOOR_SHARE * peak
        column[MEAN_COS] = -1 / max(rows[0, ROW_FADE], 1 - math.cos(MIN_CONE_ANGLE))


@allocating_kernel
def _variance(rows, mean):
    """Sum of flux times squared distance from the mean position."""
    total = 0.0
    for row in rows:
        dist_sq = np.float64(row[ROW_VARIANCE])
        for k in range(3):
            dist_sq += (row[ROW_MEAN + k] - mean[k]) ** 2
        total += row[ROW_FLUX] * dist_sq
    return total


@allocating_kernel
def cone_angle(rows, axis):
    """Largest angle from a unit axis, or from none, at which any light emits; pi at most."""
    angle = 0.0
    for row in rows:
        cos_axis = 0.0
        for k in range(3):
            cos_axis += row[ROW_AXIS + k] * axis[k]
        between = math.acos(min(1.0, max(-1.0, cos_axis)))
        angle = max(angle, between + row[ROW_THETA_E])
        if angle > MAX_CONE_ANGLE:
            return math.pi
    return angle


def _depth(parent: np.ndarray) -> int:
    """Nodes on the longest way down; in the table, parents come before their children."""
    depth, level_end = 0, 1
    above = parent // NUM_LANES
    while level_end <= len(parent):
        depth += 1
        # Nodes are numbered level by level, so those below come next.
        next_end = int(np.searchsorted(above[1:], level_end)) + 1
        if next_end == level_end:
            break
        level_end = next_end
    return depth
