"""The sets of lights at one depth of a tree, to be looked at.

At depth 0 the root holds all lights. Its lanes are the sets at depth 1, the lanes of their nodes
those at depth 2, and so on; a light that has come to a lane of its own is a set of one at every
greater depth, so each light is in one set at any depth. Nodes of 16 lanes come down to single
lights in a few steps, those of a tree of width 2 in many. Distant lights have no place and are left
out.
"""

from typing import NamedTuple

import numpy as np

from ..lights import LightBounds
from .nodes import NO_LANE, NUM_LANES, LightTree

NO_SET = -1
# Of a mean direction no longer than this rounding is left: both sides of a triangle are opposite.
NO_AXIS = 1e-6


class Level(NamedTuple):
    """n sets, those of several lights first; all float64 but `light_set`.

    box_min, box_max: (n, 3) around the emitters. axis: (n, 3) unit mean direction of emission, by
    flux, zero if there is none. theta_o: (n,) largest angle from there to the axis of any light, pi
    if one has none. power: (n,) sum of the fluxes, W. light_set: (num_lights,) int32 set of each
    light, NO_SET of one that is distant or never chosen.
    """

    box_min: np.ndarray
    box_max: np.ndarray
    axis: np.ndarray
    theta_o: np.ndarray
    power: np.ndarray
    light_set: np.ndarray


def sets_at(tree: LightTree, bounds: LightBounds, depth: int) -> Level:
    """The sets at a depth, 0 or more; from `tree.depth` on each light is by itself."""
    lights = np.flatnonzero((tree.light_lane != NO_LANE) & ~bounds.is_distant)
    light_set = np.full(len(tree.light_lane), NO_SET, np.int32)
    _, light_set[lights] = np.unique(_nodes_at(tree, lights, depth), return_inverse=True)
    lights = lights[np.argsort(light_set[lights], kind="stable")]
    of, num = light_set[lights], light_set.max(initial=NO_SET) + 1
    first = np.searchsorted(of, np.arange(num))
    power = np.add.reduceat(bounds.flux[lights], first)
    weight = (bounds.flux * bounds.mean_cos)[lights, None]
    axis = np.add.reduceat(weight * bounds.axis[lights], first)
    length = np.linalg.norm(axis, axis=1)
    has_axis = length > NO_AXIS * power
    axis *= (has_axis / np.where(has_axis, length, 1))[:, None]
    cos_between = (bounds.axis[lights] * axis[of]).sum(1)
    is_directed = bounds.axis[lights].any(1) & has_axis[of]
    between = np.where(is_directed, np.arccos(np.clip(cos_between, -1, 1)), np.pi)
    return Level(
        box_min=np.minimum.reduceat(bounds.box_min[lights], first),
        box_max=np.maximum.reduceat(bounds.box_max[lights], first),
        axis=axis,
        theta_o=np.maximum.reduceat(between, first),
        power=power,
        light_set=light_set,
    )


def _nodes_at(tree: LightTree, lights: np.ndarray, depth: int) -> np.ndarray:
    """The node at a depth that holds each light; for a light by itself a number beyond them all."""
    above = np.maximum(tree.parent, 0) // NUM_LANES
    node_depth, on_way = np.zeros(len(above), int), np.arange(len(above))
    while on_way.any():
        node_depth += on_way > 0
        on_way = above[on_way]
    node = tree.light_lane[lights] // NUM_LANES
    is_alone = node_depth[node] < depth
    while (is_deeper := node_depth[node] > depth).any():
        node = np.where(is_deeper, above[node], node)
    return np.where(is_alone, len(above) + lights, node)
