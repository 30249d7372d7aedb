"""A light tree after the one in Cycles, for `lighttree probe` to compare with; it renders nothing.

Written from a description of that sampler, not from its code. A binary tree by the surface area
orientation heuristic (12 buckets of equal width), leaves of up to 8 lights. A node's importance has
an upper and a lower bound, by the sphere around its box and the cone around its axes; the chance of
a part is the mean of its shares of the two. Lights of a leaf are weighed likewise, by their own
outlines. One random number finds one light; where all upper bounds are zero the choice is lost.

Departures, all in its favour: intensities know the spread of area lights, each side of an emitter
is a light of its own, cosines of sums of angles are computed without trigonometric functions.
"""

import math
from typing import NamedTuple

import numpy as np

from lighttree_core.jit import HALF, ONE, ZERO, kernel
from lighttree_core.lights import NO_LIGHT
from lighttree_core.vec import dot, load3, scale, sub

BELOW_ONE = 1 - 2.0**-53
TINY, HUGE = np.float32(1e-30), np.float32(1e30)

# Columns of nodes and, with the last three, of lights. RADIUS is -1 for distant ones.
CENTER, HALF_EXTENT, AXIS, COS_O, SIN_O, COS_E, ENERGY, RADIUS = 0, 3, 6, 9, 10, 11, 12, 13
FADE, NUM_CORNERS, CORNERS = 14, 15, 16
NUM_COLUMNS, NUM_LIGHT_COLUMNS = 14, 28


class CyclesTree(NamedTuple):
    """m nodes in preorder, so that a left part follows its parent; n lights in leaf order.

    node: (m, NUM_COLUMNS) float32. right: (m,) right part, 0 for a leaf. first, last: (m,) lights.
    parent: (m,). light: (n, NUM_LIGHT_COLUMNS) float32. light_id: (n,). place, leaf: for each light
    of the scene, its row of `light` or -1, and its node.
    """

    node: np.ndarray
    right: np.ndarray
    first: np.ndarray
    last: np.ndarray
    parent: np.ndarray
    light: np.ndarray
    light_id: np.ndarray
    place: np.ndarray
    leaf: np.ndarray


@kernel
def cos_difference(cos_a, sin_a, cos_b, sin_b):
    """Cosine of a - b, of angles up to pi; 1 where b is the larger."""
    return ONE if cos_a >= cos_b else cos_a * cos_b + sin_a * sin_b


@kernel
def cos_sum(cos_a, sin_a, cos_b, sin_b):
    """Cosine of a + b, of angles up to pi; -1 from there on."""
    return -ONE if cos_a <= -cos_b else cos_a * cos_b - sin_a * sin_b


@kernel
def sin_of(cos_a):
    """Sine of an angle up to pi."""
    return math.sqrt(max(ZERO, ONE - cos_a * cos_a))


@kernel
def cosines_received(n, wi, cos_u):
    """(upper, lower) bound of the cosine at the surface, around the direction wi."""
    cos_i, sin_u = dot(n, wi), sin_of(cos_u)
    sin_i = sin_of(cos_i)
    upper = cos_difference(cos_i, sin_i, cos_u, sin_u)
    return max(ZERO, upper), max(ZERO, cos_sum(cos_i, sin_i, cos_u, sin_u))


@kernel
def cosines_emitted(row, wi, cos_u):
    """(upper, lower) bound of the cosine between a light's axis and the way to the point."""
    cos_a, sin_u = -dot((row[AXIS], row[AXIS + 1], row[AXIS + 2]), wi), sin_of(cos_u)
    sin_a = sin_of(cos_a)
    upper = cos_difference(cos_a, sin_a, row[COS_O], row[SIN_O])
    upper = cos_difference(upper, sin_of(upper), cos_u, sin_u)
    lower = cos_sum(cos_a, sin_a, row[COS_O], row[SIN_O])
    lower = cos_sum(lower, sin_of(lower), cos_u, sin_u)
    return upper if upper > row[COS_E] else ZERO, lower if lower > row[COS_E] else ZERO


@kernel
def distant_importance(row, n):
    """(upper, lower) bound of the irradiance from sun or background."""
    axis = row[AXIS], row[AXIS + 1], row[AXIS + 2]
    upper, lower = cosines_received(n, scale(axis, -ONE), row[COS_O])
    return row[ENERGY] * upper, row[ENERGY] * lower


@kernel
def node_importance(row, p, n):
    """(upper, lower) bound of what a set of lights gives a point p with the unit normal n."""
    if row[RADIUS] < ZERO:
        return distant_importance(row, n)
    to_center, radius = sub((row[CENTER], row[CENTER + 1], row[CENTER + 2]), p), row[RADIUS]
    reach = abs(n[0]) * row[HALF_EXTENT] + abs(n[1]) * row[HALF_EXTENT + 1]
    if dot(n, to_center) + reach + abs(n[2]) * row[HALF_EXTENT + 2] <= ZERO:
        return ZERO, ZERO
    dist_sq = dot(to_center, to_center)
    wi = scale(to_center, ONE / math.sqrt(max(TINY, dist_sq)))
    inside = dist_sq <= radius * radius
    cos_u = -ONE if inside else math.sqrt(ONE - radius * radius / dist_sq)
    received, emitted = cosines_received(n, wi, cos_u), cosines_emitted(row, wi, cos_u)
    value = row[ENERGY] / max(TINY, max(dist_sq, HALF * HALF * radius * radius))
    return min(HUGE, value * received[0] * emitted[0]), value * received[1] * emitted[1]


@kernel
def spot_falloff(row, cos_a):
    """Smoothstep over the blended part of a spot's cone; 1 for other lights."""
    t = (cos_a - row[COS_E]) / row[FADE] if row[FADE] > ZERO else ONE
    t = min(ONE, max(ZERO, t))
    return t * t * (np.float32(3) - t - t)


@kernel
def outline_cosine(row, p, wi):
    """Cosine of the largest angle between wi and the corners of a flat light."""
    cos_u = ONE
    for k in range(int(row[NUM_CORNERS])):
        c = CORNERS + 3 * k
        to_corner = sub((row[c], row[c + 1], row[c + 2]), p)
        len_sq = max(TINY, dot(to_corner, to_corner))
        cos_u = min(cos_u, dot(wi, to_corner) / math.sqrt(len_sq))
    return cos_u


@kernel
def light_importance(row, p, n):
    """(upper, lower) bound of what one light gives a point p with the unit normal n."""
    if row[RADIUS] < ZERO:
        return distant_importance(row, n)
    to_center, radius = sub((row[CENTER], row[CENTER + 1], row[CENTER + 2]), p), row[RADIUS]
    dist_sq = max(TINY, dot(to_center, to_center))
    wi = scale(to_center, ONE / math.sqrt(dist_sq))
    if row[NUM_CORNERS] > ZERO:
        cos_u = outline_cosine(row, p, wi)
    elif dist_sq > radius * radius:
        cos_u = math.sqrt(ONE - radius * radius / dist_sq)
    else:
        cos_u, dist_sq = -ONE, max(TINY, HALF * radius * radius)
    received, emitted = cosines_received(n, wi, cos_u), cosines_emitted(row, wi, cos_u)
    upper = received[0] * emitted[0] * spot_falloff(row, emitted[0])
    lower = received[1] * emitted[1] * spot_falloff(row, emitted[1]) * cos_u * cos_u
    return min(HUGE, row[ENERGY] / dist_sq * upper), min(HUGE, row[ENERGY] / dist_sq * lower)


@kernel
def left_share(tree, node, p, n):
    """Probability of a node's left part against its right one; -1 if neither can give light."""
    left = node_importance(tree.node[node + 1], p, n)
    right = node_importance(tree.node[tree.right[node]], p, n)
    if left[0] + right[0] == ZERO:
        return -1.0
    if left[0] == ZERO or right[0] == ZERO:
        return 1.0 if left[0] > ZERO else 0.0
    upper = np.float64(left[0]) / (left[0] + right[0])
    if left[1] + right[1] == ZERO:
        return 0.5 * upper + 0.25
    return 0.5 * upper + 0.5 * (left[1] / (left[1] + right[1]))


@kernel
def fill_shares(tree, node, p, n, shares):
    """Fill the first column of shares with the chances of a leaf's lights; whether any has one.

    shares: (lights of the largest leaf, 2), float64.
    """
    first, num = tree.first[node], tree.last[node] - tree.first[node]
    upper, lower, num_lit = 0.0, 0.0, 0
    for k in range(num):
        shares[k, 0], shares[k, 1] = light_importance(tree.light[first + k], p, n)
        upper += shares[k, 0]
        lower += shares[k, 1]
        num_lit += shares[k, 0] > 0.0
    for k in range(num):
        if shares[k, 0] > 0.0:
            low = shares[k, 1] / lower if lower > 0.0 else 1.0 / num_lit
            shares[k, 0] = 0.5 * (shares[k, 0] / upper + low)
    return num_lit > 0


@kernel
def choose_light(tree, p, n, u, shares):
    """Choose a light for one shading point: (light, pmf), or (NO_LIGHT, 0) if that came to nothing.

    u: uniform in [0, 1), float64. `pmf_light` returns the same pmf.
    """
    node, pmf = 0, 1.0
    while tree.right[node] > 0:
        left = left_share(tree, node, p, n)
        if left < 0.0:
            return NO_LIGHT, 0.0
        if u < left:
            node, u, pmf = node + 1, u / left, pmf * left
        else:
            node, u, pmf = tree.right[node], (u - left) / (1.0 - left), pmf * (1.0 - left)
        u = min(u, BELOW_ONE)
    if not fill_shares(tree, node, p, n, shares):
        return NO_LIGHT, 0.0
    chosen, first = 0, tree.first[node]
    for k in range(tree.last[node] - first):
        if shares[k, 0] > 0.0:
            chosen = k
            if u < shares[k, 0]:
                break
            u -= shares[k, 0]
    return tree.light_id[first + chosen], pmf * shares[chosen, 0]


@kernel
def pmf_light(tree, light, p, n, shares):
    """Probability with which `choose_light` returns a light: a walk from its leaf to the root."""
    place, node = tree.place[light], tree.leaf[light]
    if place < 0 or not fill_shares(tree, node, p, n, shares):
        return 0.0
    pmf = shares[place - tree.first[node], 0]
    while node > 0 and pmf > 0.0:
        parent = tree.parent[node]
        left = left_share(tree, parent, p, n)
        if left < 0.0:
            return 0.0
        pmf *= left if node == parent + 1 else 1.0 - left
        node = parent
    return pmf


@kernel
def choose_cycles_wave(tree, shares, p, n, u, light, expected):
    """Choose a light for each of m points; light, expected: (m, 1)."""
    for i in range(len(u)):
        light[i, 0], expected[i, 0] = choose_light(tree, load3(p, i), load3(n, i), u[i], shares)


@kernel
def expect_cycles_wave(tree, shares, p, n, light, expected):
    """Fill expected with the probabilities of lights at one point."""
    for i in range(len(light)):
        expected[i] = pmf_light(tree, light[i], p, n, shares)


def allocate_shares(tree: CyclesTree) -> np.ndarray:
    """Room for the lights of the largest leaf; one for each thread."""
    return np.zeros((int((tree.last - tree.first)[tree.right == 0].max()), 2))
