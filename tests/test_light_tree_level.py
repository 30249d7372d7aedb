"""The sets of lights at a depth, against a walk down the tree and sums over their lights."""

import numpy as np
import pytest
from core_scenes import fewer, floor_scene, random_scene
from hypothesis import given, settings
from hypothesis import strategies as st
from tree_probe import lane_lights, lane_table, tree_options

from lighttree_core.light_tree.build import build_tree
from lighttree_core.light_tree.level import NO_SET, sets_at
from lighttree_core.light_tree.nodes import AXIS, MEAN_COS
from lighttree_core.light_tree.options import TreeOptions
from lighttree_core.lights import bound_lights, build_lights
from lighttree_core.scene import POINT, SUN, Lamps


def bounds_of(scene):
    return bound_lights(build_lights(scene)[0])


def members(level):
    """The sets as sets of ids of lights, in their order."""
    return [frozenset(np.flatnonzero(level.light_set == i)) for i in range(len(level.power))]


def walk(tree, lanes, node, depth):
    """The sets at a depth below a node, as sets of ids of lights."""
    below = {k: lights for (at, k), lights in lanes.items() if at == node}
    if depth == 0:
        return [frozenset(light for lights in below.values() for light in lights)]
    sets = []
    for k, lights in below.items():
        child = int(tree.child[node, k])
        sets += walk(tree, lanes, child, depth - 1) if child > 0 else [frozenset(lights)]
    return sets


@settings(max_examples=fewer(40, 6), deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    num_lamps=st.integers(1, fewer(300, 40)),
    options=tree_options(),
)
def test_sets_are_those_of_a_walk_and_bound_their_lights(seed, num_lamps, options):
    bounds = bounds_of(random_scene(np.random.default_rng(seed), num_lamps, 10))
    tree = build_tree(bounds, options)
    lanes = lane_lights(tree) if len(tree.child) else {}
    local = frozenset(np.flatnonzero((bounds.flux > 0) & ~bounds.is_distant))
    for depth in range(tree.depth + 2):
        level = sets_at(tree, bounds, depth)
        found = members(level)
        walked = [lights & local for lights in walk(tree, lanes, 0, depth)] if lanes else []
        assert set(found) == {lights for lights in walked if lights}
        # Each light lies in one set, and distant ones in none.
        assert sum(len(lights) for lights in found) == len(local) == len(frozenset().union(*found))
        np.testing.assert_allclose(level.power.sum(), bounds.flux[list(local)].sum())
        for i, lights in enumerate(found):
            assert_bounds(level, i, bounds, sorted(lights))
        if depth >= tree.depth:
            assert all(len(lights) == 1 for lights in found)


def assert_bounds(level, i, bounds, lights):
    """Set i is what its lights add up to."""
    np.testing.assert_array_equal(level.box_min[i], bounds.box_min[lights].min(0))
    np.testing.assert_array_equal(level.box_max[i], bounds.box_max[lights].max(0))
    assert level.power[i] == pytest.approx(bounds.flux[lights].sum())
    emission = (bounds.flux[lights] * bounds.mean_cos[lights]) @ bounds.axis[lights]
    length = np.linalg.norm(emission)
    if length <= 1e-6 * level.power[i]:
        assert not level.axis[i].any() and level.theta_o[i] == np.pi
        return
    np.testing.assert_allclose(level.axis[i], emission / length, atol=1e-6)
    angles = [
        np.arccos(np.clip(axis @ level.axis[i], -1, 1)) if axis.any() else np.pi
        for axis in bounds.axis[lights]
    ]
    assert level.theta_o[i] == pytest.approx(max(angles), abs=1e-6)


def test_axes_are_those_that_lights_are_chosen_by():
    bounds = bounds_of(random_scene(np.random.default_rng(7), fewer(300, 40)))
    tree = build_tree(bounds)
    lanes = {frozenset(lights): key for key, lights in lane_lights(tree).items()}
    level = sets_at(tree, bounds, 1)
    num_checked = 0
    for lights, axis in zip(members(level), level.axis, strict=True):
        node, k = lanes[lights]
        if lane_table(tree)[node, MEAN_COS, k] > 1e-3:
            np.testing.assert_allclose(lane_table(tree)[node, AXIS : AXIS + 3, k], axis, atol=1e-5)
            num_checked += 1
    assert num_checked > 3


def lamps(kinds, positions, directions, cos_cone=0.9):
    """Lamps of 1 W/sr; spots where they have a direction, points where it is zero."""
    table = Lamps.empty(len(kinds))
    table.kind[:], table.position[:], table.radiance[:] = kinds, positions, 1
    for row, direction in enumerate(np.array(directions, float)):
        if direction.any():
            w = direction / np.linalg.norm(direction)
            u = np.cross(w, np.eye(3)[np.argmin(np.abs(w))])
            u /= np.linalg.norm(u)
            table.axis_u[row], table.axis_v[row], table.axis_w[row] = u, np.cross(w, u), w
            table.cos_cone[row] = cos_cone
    return table


def test_two_spots_and_a_point_by_hand():
    spots = lamps([POINT] * 2, [[0, 0, 5], [4, 0, 3]], [[1, 0, -1], [-1, 0, -1]])
    bounds = bounds_of(floor_scene(spots))
    level = sets_at(build_tree(bounds), bounds, 0)
    np.testing.assert_allclose((level.box_min, level.box_max), ([[0, 0, 3]], [[4, 0, 5]]))
    np.testing.assert_allclose(level.axis, [[0, 0, -1]], atol=1e-6)
    np.testing.assert_allclose(level.theta_o, [np.pi / 4], rtol=1e-6)
    # A point shines everywhere, so no cone holds all axes.
    some = lamps([POINT] * 2, [[0, 0, 5], [4, 0, 3]], [[1, 0, -1], [0, 0, 0]])
    bounds = bounds_of(floor_scene(some))
    tree = build_tree(bounds)
    assert sets_at(tree, bounds, 0).theta_o.tolist() == [np.pi]
    alone = sets_at(tree, bounds, 1)
    assert sorted(alone.theta_o.tolist()) == pytest.approx([0, np.pi], abs=1e-6)


def test_a_scene_of_the_sun_alone_and_one_without_lights_have_no_sets():
    sun = lamps([SUN], [[0, 0, 0]], [[0, 0, -1]])
    for table in (sun, Lamps.empty()):
        bounds = bounds_of(floor_scene(table))
        tree = build_tree(bounds)
        for depth in range(3):
            level = sets_at(tree, bounds, depth)
            assert level.box_min.shape == (0, 3) and level.power.shape == (0,)
            assert level.light_set.tolist() == [NO_SET] * len(bounds.flux)


def test_a_binary_tree_halves_its_sets():
    rng = np.random.default_rng(7)
    table = lamps([POINT] * 64, rng.uniform(-5, 5, (64, 3)), np.zeros((64, 3)))
    bounds = bounds_of(floor_scene(table))
    tree = build_tree(bounds, TreeOptions(width=2, split="equal"))
    counts = [len(sets_at(tree, bounds, depth).power) for depth in range(tree.depth + 1)]
    assert counts == [1, 2, 4, 8, 16, 32, 64]
