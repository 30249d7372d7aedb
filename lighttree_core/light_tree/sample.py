"""Choosing lights for a shading point, and the probability with which each is chosen.

All samplers are reached through `sample_lights` and its twin `expected_picks`. By the tree, a
budget of picks is dealt out from the root: each lane gets the share that its importance says, but a
single light at most one pick, and so does a set that `split_threshold` calls certain; what they
cannot use goes to the other lanes. A set with a budget of one or less gets its pick or not by
chance. This is adaptive tree splitting (Conty Estevez and Kulla 2018) with a test that looks at
nodes and the point alone, so the probability of a light hit by a scattered ray is a walk down to
it. One random number serves all picks of a point: they lie at the places u, u + 1, u + 2 ... of the
budget (systematic sampling), so they are stratified in the order of the tree.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..jit import ONE, ZERO, f32, f64, i32, kernel, table
from ..lights import LightBounds, Lights
from ..vec import dot, sub
from .bounds import bounds_importances
from .build import build_tree
from .importance import lane_importances
from .nodes import (
    NO_LANE,
    NUM_LANES,
    LightTree,
    allocate_tree,
    load_lane,
    sum_lanes,
    sum_of_four,
)
from .options import CUT_OFF_ID, MOMENTS_ID, TreeOptions

TREE, POWER, UNIFORM = "tree", "power", "uniform"
SAMPLERS = (TREE, POWER, UNIFORM)
BELOW_ONE = 1.0 - 2.0**-53


@table
class LightSampler(NamedTuple):
    """A light tree, or if `cdf` is not empty a fixed distribution over all lights.

    cdf: (num_lights + 1,) float64, from 0 to 1.
    """

    lights: Lights
    tree: LightTree
    split_threshold: f32
    cdf: f64[::1]


@table
class Picks(NamedTuple):
    """Room for the picks of one point, and for the descent to them; one for each thread.

    light, expected: (n,) the lights picked, and how often each was to be expected among the picks.
    node, budget, place: (m,) sets that are searched, in turn, their shares of the budget, and where
    in it the first pick lies. weights: (m, NUM_LANES) the importances of their lanes; total: (m,)
    the sums of these. shares: (NUM_LANES,) of one node. path: lanes down to a light.
    """

    light: i32[::1]
    expected: f64[::1]
    node: i32[::1]
    budget: f64[::1]
    place: f64[::1]
    weights: f32[:, ::1]
    total: f64[::1]
    shares: f64[::1]
    path: i32[::1]


def allocate_picks(sampler: LightSampler, num: int) -> Picks:
    """Room for up to `num` picks."""
    num += NUM_LANES  # rounding may see a pick on the bound of two lanes in both
    num_sets = num * (sampler.tree.depth + 1)
    return Picks(
        light=np.zeros(num, np.int32),
        expected=np.zeros(num),
        node=np.zeros(num_sets, np.int32),
        budget=np.zeros(num_sets),
        place=np.zeros(num_sets),
        weights=np.zeros((num_sets, NUM_LANES), np.float32),
        total=np.zeros(num_sets),
        shares=np.zeros(NUM_LANES),
        path=np.zeros(sampler.tree.depth + 1, np.int32),
    )


def build_sampler(
    lights: Lights,
    bounds: LightBounds,
    strategy: str = TREE,
    options: TreeOptions | None = None,
    threads: int = 1,
) -> LightSampler:
    """The sampler of the given strategy, one of SAMPLERS."""
    options = options or TreeOptions()
    threshold = np.float32(options.split_threshold)
    if strategy == TREE or not np.any(bounds.flux > 0):
        return LightSampler(lights, build_tree(bounds, options, threads), threshold, np.zeros(0))
    weights = _power(bounds) if strategy == POWER else (bounds.flux > 0).astype(np.float64)
    cdf = np.concatenate([[0.0], np.cumsum(weights)])
    return LightSampler(lights, allocate_tree(0, 0), threshold, cdf / cdf[-1])


def _power(bounds: LightBounds) -> np.ndarray:
    """Emitted power of each light, W; of a distant one what falls on a disk around all others."""
    local = ~bounds.is_distant & (bounds.flux > 0)
    radius_sq = 1.0
    if local.any():
        low, high = bounds.box_min[local].min(0), bounds.box_max[local].max(0)
        radius_sq = ((high - low) ** 2).sum() / 4 or 1.0
    return bounds.flux * np.where(bounds.is_distant, np.pi * radius_sq, 1)


@kernel
def importances(tree, node, receiver, weights):
    """Fill weights with the importances of a node's lanes; their sum, float64."""
    if tree.importance == MOMENTS_ID:
        return lane_importances(tree, node, receiver, weights)
    is_cut_off = tree.importance == CUT_OFF_ID
    return bounds_importances(tree, node, receiver, is_cut_off, weights)


@kernel
def uncertainty(lane, p):
    """How much the distances from p to the lights of a set may differ, from 0 to 1, if anywhere.

    Conty and Kulla's measure from the relative variance of 1/d^2 between a and b, (b - a)^2 / 3ab,
    for a ball of the radius of gyration.
    """
    to_mean = sub(lane.mean, p)
    dist_sq = dot(to_mean, to_mean)
    if not lane.variance < dist_sq:
        return ONE
    variance = np.float32(4 / 3) * lane.variance / (dist_sq - lane.variance)
    return ONE - math.sqrt(math.sqrt(ONE / (ONE + math.sqrt(variance))))


@kernel
def takes_one(sampler, node, k, p):
    """Whether one pick is all that a lane may get: a light, or a set that is certain enough."""
    if sampler.tree.child[node, k] < 0:
        return True
    if sampler.split_threshold <= ZERO:
        return False
    return uncertainty(load_lane(sampler.tree.columns, node, k), p) < sampler.split_threshold


@kernel
def root_budget(sampler, num):
    """Picks to be dealt out for one point; one where every set is called certain."""
    return np.float64(num if sampler.split_threshold < ONE else 1)


@kernel
def deal(sampler, node, p, budget, total, weights, shares):
    """Fill `shares` with what each lane of a node gets of a budget above one.

    weights: importances of the lanes, which are used up; total: their sum.
    """
    num_ones = 1
    for k in range(NUM_LANES):
        shares[k] = 0.0
    while num_ones > 0 and total > 0.0:
        scale, num_above, num_ones = max(0.0, budget) / total, 0, 0
        for k in range(NUM_LANES):
            # Shares only grow; a lane that takes one has no weight left.
            shares[k] = max(shares[k], weights[k] * scale)
            num_above += shares[k] > 1.0
        if num_above > 0:
            for k in range(NUM_LANES):
                if shares[k] > 1.0 and takes_one(sampler, node, k, p):
                    shares[k], weights[k] = 1.0, ZERO
                    num_ones += 1
            # Summed anew: a difference would lose the faintest lights.
            budget, total = budget - num_ones, sum_lanes(weights)


@kernel
def sample_lights(sampler, receiver, num, u, picks):
    """Pick lights for a Receiver into `picks`; how many, `num` at most.

    u: uniform in [0, 1), float64. The sum of contribution over `picks.expected` estimates that of
    all lights. `expected_picks` returns the same numbers.
    """
    if len(sampler.cdf) > 0:
        return pick_from_cdf(sampler.cdf, num, u, picks)
    num_picked, first, num_sets = 0, 0, 0
    if len(sampler.tree.child) > 0:
        picks.node[0], picks.budget[0], picks.place[0] = 0, root_budget(sampler, num), u
        num_sets = 1
    while first < num_sets:
        # All sets of one depth are weighed before any is gone down, so that the processor can begin
        # with one while it waits for another.
        last = num_sets
        for i in range(first, last):
            picks.total[i] = importances(sampler.tree, picks.node[i], receiver, picks.weights[i])
        for i in range(first, last):
            if not picks.total[i] > 0.0:
                continue
            if picks.budget[i] <= 1.0:
                num_picked, num_sets = follow(sampler.tree, picks, i, num_picked, num_sets)
            else:
                num_picked, num_sets = branch(sampler, receiver.p, picks, i, num_picked, num_sets)
        first = last
    return min(num_picked, num)


@kernel
def pick_from_cdf(cdf, num, u, picks):
    """Pick `num` lights from a fixed distribution, perhaps one several times; how many."""
    for i in range(num):
        x = min((u + i) / num, BELOW_ONE)
        light = np.searchsorted(cdf, x, side="right") - 1
        picks.light[i], picks.expected[i] = light, num * (cdf[light + 1] - cdf[light])
    return num


@kernel
def go_down(tree, node, k, budget, place, picks, num_picked, num_sets):
    """Pick the light of a lane, or have its set searched: (picks, sets so far)."""
    child = tree.child[node, k]
    if child < 0:
        picks.light[num_picked], picks.expected[num_picked] = ~child, budget
        return num_picked + 1, num_sets
    picks.node[num_sets], picks.budget[num_sets], picks.place[num_sets] = child, budget, place
    return num_picked, num_sets + 1


@kernel
def follow(tree, picks, i, num_picked, num_sets):
    """Follow the one pick of set i into a lane: (picks, sets so far)."""
    node, budget, weights, total = picks.node[i], picks.budget[i], picks.weights[i], picks.total[i]
    target = picks.place[i] / budget * total
    k, below = search(weights, target)
    u = min(BELOW_ONE, (target - below) / np.float64(weights[k]))
    budget *= weights[k] / total
    return go_down(tree, node, k, budget, u * budget, picks, num_picked, num_sets)


@kernel
def branch(sampler, p, picks, i, num_picked, num_sets):
    """Deal the budget of set i out to its lanes: (picks, sets so far)."""
    node, budget, place, shares = picks.node[i], picks.budget[i], picks.place[i], picks.shares
    deal(sampler, node, p, budget, picks.total[i], picks.weights[i], shares)
    last = -1
    while place < budget:
        k, below = search(shares, place)
        if k != last:
            last, inside = k, max(0.0, place - below)
            num_picked, num_sets = go_down(
                sampler.tree, node, k, shares[k], inside, picks, num_picked, num_sets
            )
        place += 1.0
    return num_picked, num_sets


@kernel
def search(values, target):
    """(lane in which a place along the sum of all lanes' values lies, sum of those before it).

    Four lanes at a time, then one at a time: at most six comparisons, none of them foreseeable.
    """
    lane, below, above = 0, 0.0, 0.0
    for k in range(0, NUM_LANES - 4, 4):
        above += sum_of_four(values, k)
        is_before = above <= target
        lane, below = (k + 4, above) if is_before else (lane, below)
    above = below
    first = lane
    for k in range(first, first + 3):
        above += np.float64(values[k])
        is_before = above <= target
        lane, below = (k + 1, above) if is_before else (lane, below)
    if not values[lane] > 0.0:
        lane, below = last_lane(values, lane), target
    return lane, below


@kernel
def last_lane(values, k):
    """The last lane up to k whose value is not 0; k is beyond it only by rounding."""
    while not values[k] > 0.0 and k > 0:
        k -= 1
    return k


@kernel
def expected_picks(sampler, light, receiver, num, picks):
    """How often `sample_lights` is expected to pick this light: a walk down the tree to it."""
    if len(sampler.cdf) > 0:
        return num * (sampler.cdf[light + 1] - sampler.cdf[light])
    tree = sampler.tree
    lane, length = tree.light_lane[light], 0
    while lane != NO_LANE:
        picks.path[length] = lane
        lane = tree.parent[lane // NUM_LANES]
        length += 1
    if length == 0:
        return 0.0
    budget, weights, shares = root_budget(sampler, num), picks.weights[0], picks.shares
    for i in range(length - 1, -1, -1):
        node, k = picks.path[i] // NUM_LANES, picks.path[i] % NUM_LANES
        total = importances(tree, node, receiver, weights)
        if not weights[k] > ZERO:
            return 0.0
        if budget <= 1.0:
            budget *= weights[k] / total
        else:
            deal(sampler, node, receiver.p, budget, total, weights, shares)
            budget = shares[k]
    return budget
