"""Nodes hold each light once and bound what is below; the twin of float64 builds the same tree."""

import numpy as np
import pytest
import tree_twin
from core_scenes import JIT_IS_OFF, fewer, floor_scene, random_lamps, random_scene
from hypothesis import given, settings
from hypothesis import strategies as st
from tree_probe import build, depth_of, lane_lights, lane_table, tree_options, vec3

from lighttree_core.light_tree import build as build_module
from lighttree_core.light_tree.bounds import LANE_RADIUS, LANE_THETA_E, LANE_THETA_O
from lighttree_core.light_tree.build import build_tree
from lighttree_core.light_tree.importance import (
    BEAM_FLOOR_SHARE,
    FLOOR_SHARE,
    LOBE_SCALE,
    lane_importance,
    lobe,
    matt_receiver,
)
from lighttree_core.light_tree.nodes import (
    AXIS,
    FLUX,
    HALF_EXTENT,
    MEAN,
    NO_LANE,
    NUM_LANES,
    VARIANCE,
    load_lane,
)
from lighttree_core.light_tree.options import MOMENTS, TreeOptions
from lighttree_core.light_tree.split import orientation_measure
from lighttree_core.lights import bound_lights, build_lights
from lighttree_core.scene import LAMP_KINDS, SUN

SEEDS = st.integers(0, 2**32)
LOCAL_KINDS = tuple(kind for kind in LAMP_KINDS if kind != SUN)
# What a float32 sum of a few rounded numbers may be off by.
FLOAT32 = 1e-6


def examples(num, without_jit):
    return settings(max_examples=fewer(num, without_jit), deadline=None, derandomize=True)


def random_bounds(seed, num_lamps, num_triangles=10):
    return bound_lights(
        build_lights(random_scene(np.random.default_rng(seed), num_lamps, num_triangles))[0]
    )


@examples(60, 8)
@given(seed=SEEDS, num_lamps=st.integers(0, fewer(300, 40)), options=tree_options())
def test_every_light_lies_in_one_place_that_all_tables_agree_on(seed, num_lamps, options):
    bounds = random_bounds(seed, num_lamps)
    tree = build_tree(bounds, options)
    lanes = lane_lights(tree)
    in_nodes = [light for (node, _), lights in lanes.items() if node == 0 for light in lights]
    assert sorted(in_nodes) == list(np.flatnonzero(bounds.flux > 0))
    for (node, k), lights in lanes.items():
        if tree.child[node, k] < 0:
            assert tree.light_lane[lights[0]] == node * NUM_LANES + k
        else:
            assert tree.parent[tree.child[node, k]] == node * NUM_LANES + k
            assert len(lights) > 1
    assert tree.parent[0] == NO_LANE
    assert tree.depth == depth_of(tree)
    num_lanes = np.bincount([node for node, _ in lanes], minlength=len(tree.child))
    assert num_lanes.max() <= options.width
    # A node of one lane would be a step for nothing.
    assert len(in_nodes) == 1 or num_lanes.min() >= 2
    # Lanes without lights cannot be picked, and give nothing.
    is_used = np.zeros((len(tree.child), NUM_LANES), bool)
    is_used[tuple(np.array(list(lanes)).T)] = True
    assert np.all(lane_table(tree).transpose(0, 2, 1)[~is_used] == 0)


@examples(40, 6)
@given(seed=SEEDS, num_lamps=st.integers(1, fewer(300, 40)), options=tree_options())
def test_lanes_bound_their_lights_and_add_up_their_fluxes(seed, num_lamps, options):
    bounds = random_bounds(seed, num_lamps)
    tree = build_tree(bounds, options)
    for (node, k), lights in lane_lights(tree).items():
        column = lane_table(tree)[node, :, k].astype(np.float64)
        scale = LOBE_SCALE if options.importance == MOMENTS else 1.0
        flux = bounds.flux[lights].sum()
        if options.importance == MOMENTS and _is_beam(bounds, lights):
            scale = bounds.peak[lights[0]] / flux
        if bounds.is_distant[lights].any():
            assert bounds.is_distant[lights].all()
            assert column[VARIANCE] == np.inf
            assert column[FLUX] == pytest.approx(flux, rel=FLOAT32)
            continue
        assert column[FLUX] == pytest.approx(scale * flux, rel=FLOAT32)
        # The box, with no tolerance at all.
        mean, half_extent = column[MEAN : MEAN + 3], column[HALF_EXTENT : HALF_EXTENT + 3]
        assert np.all(mean - half_extent <= bounds.box_min[lights])
        assert np.all(mean + half_extent >= bounds.box_max[lights])
        if options.importance == MOMENTS:
            _check_moments(load_lane(tree.columns, node, k), bounds, lights)
        else:
            _check_cone(column, bounds, lights)


def _is_beam(bounds, lights):
    return len(lights) == 1 and bounds.fade[lights[0]] < np.inf


def _check_moments(lane, bounds, lights):
    twin = tree_twin.Lane(bounds, lights)
    np.testing.assert_allclose(lane.mean, twin.mean, atol=FLOAT32 * (1 + np.abs(twin.mean)).max())
    assert lane.variance == pytest.approx(twin.variance, rel=FLOAT32, abs=1e-9)
    is_beam = _is_beam(bounds, lights)
    floor = BEAM_FLOOR_SHARE if is_beam else FLOOR_SHARE
    assert lane.floor == pytest.approx(floor * bounds.peak[lights].sum(), rel=FLOAT32)
    mean_cos = -1 / twin.fade if is_beam else min(twin.mean_cos, 0.9999)
    assert lane.mean_cos == pytest.approx(mean_cos, rel=FLOAT32, abs=FLOAT32)
    if twin.mean_cos > 1e-3:
        np.testing.assert_allclose(lane.axis, twin.axis, atol=1e-3)
        # The kernel's cosine of a narrow cone leaves this much open, and widens it when it culls.
        cone = np.arccos(lane.cos_cone)
        assert cone == pytest.approx(np.pi if twin.cone > 3 else max(twin.cone, 1e-3), abs=1e-3)


def _check_cone(column, bounds, lights):
    axis = column[AXIS : AXIS + 3]
    has_axis = bounds.axis[lights].any(axis=1)
    between = np.arccos(np.clip(bounds.axis[lights][has_axis] @ axis, -1, 1))
    # Without an axis of its own a set calls every direction a right angle away.
    reach = column[LANE_THETA_O] + (np.pi / 2 if not axis.any() else 0)
    assert np.all(between <= reach)
    assert has_axis.all() or column[LANE_THETA_O] >= np.pi
    theta_e = np.minimum(bounds.theta_e[lights], np.pi / 2)
    assert np.all(theta_e <= column[LANE_THETA_E] + FLOAT32)
    corners = column[HALF_EXTENT : HALF_EXTENT + 3]
    assert np.linalg.norm(corners) <= column[LANE_RADIUS] * (1 + FLOAT32)


@pytest.mark.parametrize("importance", ["moments", "clamped"])
def test_any_number_of_threads_builds_the_same_tree(importance, monkeypatch):
    if JIT_IS_OFF:
        monkeypatch.setattr(build_module, "GRAIN", 20)
    lamps = random_lamps(np.random.default_rng(7), fewer(40_000, 60))
    bounds = bound_lights(build_lights(floor_scene(lamps))[0])
    assert (~bounds.is_distant).sum() > 2 * build_module.GRAIN
    options = TreeOptions(importance=importance)
    first, *others = (build_tree(bounds, options, threads) for threads in (1, 2, 5))
    for other in others:
        for name in first._fields:
            np.testing.assert_array_equal(getattr(other, name), getattr(first, name))


def nested_sets(tree, node=0):
    """A tree as its twin returns it."""
    return frozenset(
        ~int(child) if child < 0 else nested_sets(tree, child)
        for child in tree.child[node]
        if child
    )


@examples(15, 8)
@given(seed=SEEDS, num_lamps=st.integers(fewer(1, 20), fewer(300, 60)))
def test_the_twin_builds_the_same_tree(seed, num_lamps):
    # No two random lamps are at one place; two sides of a triangle would be.
    rng = np.random.default_rng(seed)
    scene = floor_scene(random_lamps(rng, num_lamps, kinds=LOCAL_KINDS))
    scene.lamps.kind[: rng.integers(0, 3)] = SUN
    bounds = bound_lights(build_lights(scene)[0])
    assert nested_sets(build_tree(bounds)) == tree_twin.build(bounds)


@examples(30, 4)
@given(seed=SEEDS, num_lamps=st.integers(1, fewer(100, 30)))
def test_the_twin_weighs_lanes_alike(seed, num_lamps):
    rng = np.random.default_rng(seed)
    bounds = random_bounds(seed, num_lamps)
    tree = build_tree(bounds)
    for (node, k), lights in lane_lights(tree).items():
        if bounds.is_distant[lights].any():
            continue
        lane, twin = load_lane(tree.columns, node, k), tree_twin.Lane(bounds, lights)
        for _ in range(4):
            p, n = rng.uniform([-10, -10, -1], [10, 10, 4]), rng.normal(size=3)
            n /= np.linalg.norm(n)
            p, n = np.float32(p), np.float32(n)
            importance = lane_importance(lane, matt_receiver(vec3(p), vec3(n)), None)
            if twin.importance(p, n) > 0:
                # cos_axis is rounded by 2^-22, and counts k/4 x 4 times; k is below 3 / rest.
                rest = 1 - min(twin.mean_cos, 0.9999) ** 2
                tolerance = 1e-4 + 3 / rest * 2.0**-22 * 4
                # That rounding over a beam's fade, where a smoothstep is steepest, of its peak.
                beam_error = 2.0**-22 * 1.5 / twin.fade * twin.peak * twin.received(p, n)
                assert importance == pytest.approx(
                    twin.importance(p, n), rel=tolerance, abs=beam_error
                )
            elif twin.importance(p, n, tree_twin.CONE_SLACK) == 0:
                assert importance == 0
            # Between the two the kernel's rounding decides, so that no light is lost.


@examples(100, 20)
@given(theta_o=st.floats(0, np.pi), theta_e=st.floats(0, np.pi / 2))
def test_orientation_measure_is_its_integral(theta_o, theta_e):
    theta = (np.arange(20_000) + 0.5) / 20_000 * min(theta_o + theta_e, np.pi)
    step = theta[1] - theta[0]
    integrand = np.cos(np.maximum(theta - theta_o, 0)) * np.sin(theta)
    expected = 2 * np.pi * integrand.sum() * step
    assert orientation_measure(theta_o, theta_e) == pytest.approx(expected, abs=1e-5)
    assert tree_twin.orientation_measure(theta_o, theta_e) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("mean_cos", [0.0, 0.3, 0.6, 0.9, 0.99, 0.9999])
def test_a_lobe_sends_all_its_flux_at_about_its_mean_cosine(mean_cos):
    # Close to the axis, where narrow lobes are, the steps are finest.
    drop = 2 * ((np.arange(fewer(20_000, 2000)) + 0.5) / fewer(20_000, 2000)) ** 4
    width = 8 * (drop / 2) ** 0.75 / len(drop)
    r = np.float32(mean_cos)
    here = (r * np.float32(1 - x) for x in drop)
    shares = np.array([np.divide(*lobe(r, x)) for x in here]) * LOBE_SCALE
    # Rounding of r (1 - drop), of 2^-24, against 1 - r: the fourth power of a number near it.
    tolerance = 1e-3 + 4 * 2.0**-24 / (1 - mean_cos)
    assert 2 * np.pi * (shares * width).sum() == pytest.approx(1, rel=tolerance)
    mean = 2 * np.pi * (shares * width * (1 - drop)).sum()
    # The fit of k to the mean cosine is that good, and worst in the middle.
    assert mean == pytest.approx(mean_cos, abs=0.15)


@examples(20, 4)
@given(seed=SEEDS, options=tree_options(importance=MOMENTS))
def test_a_light_alone_is_weighed_by_its_own_numbers_at_any_depth(seed, options):
    # No bound or moment of a light depends on the company that it is built with.
    rng = np.random.default_rng(seed)
    scene = floor_scene(random_lamps(rng, 30, kinds=LOCAL_KINDS))
    sampler = build(scene, options=options)
    tree, bounds = sampler.tree, bound_lights(sampler.lights)
    for light in range(len(bounds.flux)):
        row = bounds._replace(flux=np.where(np.arange(len(bounds.flux)) == light, bounds.flux, 0))
        alone = build_tree(row, options)
        node, k = divmod(tree.light_lane[light], NUM_LANES)
        np.testing.assert_array_equal(lane_table(tree)[node, :, k], lane_table(alone)[0, :, 0])
