"""Choosing a light: by the tree, or by a fixed distribution; and the probability of a choice.

Every sampler is reached through `sample_light` and its twin `pmf_light`.
"""

from typing import NamedTuple

import numpy as np

from ..jit import ZERO, kernel
from ..lights import NO_LIGHT, LightBounds, Lights
from .build import build_tree
from .importance import light_importance, node_importance
from .nodes import NO_NODE, LightTree, allocate_tree, load_node

TREE, POWER, UNIFORM = "tree", "power", "uniform"
SAMPLERS = (TREE, POWER, UNIFORM)


class LightSampler(NamedTuple):
    """A light tree, or if `cdf` is not empty a fixed distribution over all lights.

    cdf: (num_lights + 1,) float64, from 0 to 1.
    """

    lights: Lights
    tree: LightTree
    cdf: np.ndarray


def build_sampler(lights: Lights, bounds: LightBounds, strategy: str = TREE) -> LightSampler:
    """The sampler of the given strategy, one of SAMPLERS."""
    if strategy == TREE or not np.any(bounds.energy > 0):
        return LightSampler(lights, build_tree(bounds), np.zeros(0))
    weights = _power(bounds) if strategy == POWER else (bounds.energy > 0).astype(np.float64)
    cdf = np.concatenate([[0.0], np.cumsum(weights)])
    return LightSampler(lights, allocate_tree(0, 0), cdf / cdf[-1])


def _power(bounds: LightBounds) -> np.ndarray:
    """Emitted power of each light, W; of a distant one what falls on a disk around all others."""
    solid_angle = np.where(bounds.is_cosine, np.pi, 2 * np.pi * (1 - np.cos(bounds.theta_e)))
    local = ~bounds.is_distant & (bounds.energy > 0)
    radius_sq = 1.0
    if local.any():
        low, high = bounds.box_min[local].min(0), bounds.box_max[local].max(0)
        radius_sq = ((high - low) ** 2).sum() / 4
    return bounds.energy * np.where(bounds.is_distant, np.pi * radius_sq, solid_angle)


@kernel
def child_probability(sampler, first_child, p, n):
    """Probability of the left child of a node, or -1 if neither child can contribute."""
    left = importance(sampler, first_child, p, n)
    right = importance(sampler, first_child + 1, p, n)
    total = left + right
    if not total > ZERO:
        return np.float64(-1.0)
    return np.float64(left) / np.float64(total)


@kernel
def importance(sampler, node, p, n):
    """Importance of a node, that of a single light by its own shape."""
    row, light = load_node(sampler.tree, node), ~sampler.tree.first_child[node]
    if light >= 0:
        return light_importance(row, sampler.lights, light, p, n)
    return node_importance(row, p, n)


@kernel
def sample_light(sampler, p, n, u):
    """Pick a light for one shading point: (light_id, pmf), or (NO_LIGHT, 0).

    p, n: vec3 in world space, n unit. u: uniform in [0, 1), float64.
    `pmf_light` returns the same pmf.
    """
    if len(sampler.cdf) > 0:
        light = np.searchsorted(sampler.cdf, u, side="right") - 1
        return light, np.float32(sampler.cdf[light + 1] - sampler.cdf[light])
    first_child = sampler.tree.first_child
    if len(first_child) == 0 or not importance(sampler, 0, p, n) > ZERO:
        return NO_LIGHT, ZERO
    node, pmf = 0, 1.0
    while first_child[node] >= 0:
        p_left = child_probability(sampler, first_child[node], p, n)
        if p_left < 0.0:
            return NO_LIGHT, ZERO
        # The number is stretched over the chosen part, so one number lasts for the whole descent.
        if u < p_left:
            node = first_child[node]
            u /= p_left
            pmf *= p_left
        else:
            node = first_child[node] + 1
            u = min((u - p_left) / (1.0 - p_left), 1.0 - 2.0**-53)
            pmf *= 1.0 - p_left
    return ~first_child[node], np.float32(pmf)


@kernel
def pmf_light(sampler, light, p, n):
    """Probability with which `sample_light` picks this light: a walk down its trail of turns."""
    if len(sampler.cdf) > 0:
        return np.float32(sampler.cdf[light + 1] - sampler.cdf[light])
    tree = sampler.tree
    leaf, trail = tree.leaf[light], tree.trail[light]
    if leaf == NO_NODE or not importance(sampler, 0, p, n) > ZERO:
        return ZERO
    node, pmf = 0, 1.0
    while node != leaf:
        p_left = child_probability(sampler, tree.first_child[node], p, n)
        if p_left < 0.0:
            return ZERO
        turns_right = trail & np.uint64(1)
        node = tree.first_child[node] + np.int32(turns_right)
        pmf *= 1.0 - p_left if turns_right else p_left
        trail >>= np.uint64(1)
    return np.float32(pmf)
