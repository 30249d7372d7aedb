"""The light tree picks lights as often as it says and leaves none out, so all light counts once."""

import numpy as np
import pytest
from core_scenes import add_triangles, fewer, floor_scene, point_lamps, random_scene
from hypothesis import given, settings
from hypothesis import strategies as st
from tree_probe import (
    EDGE_US,
    NUM_PICKS,
    UP,
    all_expected,
    build,
    contributions,
    frequencies,
    lane_table,
    middles,
    pick,
    random_points,
    tree_options,
    vec3,
)

from lighttree_core.light_tree.options import IMPORTANCES, TreeOptions
from lighttree_core.light_tree.sample import POWER, SAMPLERS, UNIFORM
from lighttree_core.scene import SUN

SEEDS = st.integers(0, 2**32)
NUM_LAMPS = st.integers(0, fewer(60, 24))
# Products of a few probabilities in float64, and a sum of all of them. Where kernels run as plain
# Python, sums that start from 0.0 are float32.
ROUNDING = fewer(1e-9, 1e-5)


def examples(num, without_jit):
    return settings(max_examples=fewer(num, without_jit), deadline=None, derandomize=True)


@examples(60, 10)
@given(seed=SEEDS, num_lamps=NUM_LAMPS, options=tree_options())
def test_expected_picks_are_probabilities_that_add_up_to_the_budget_or_less(
    seed, num_lamps, options
):
    rng = np.random.default_rng(seed)
    sampler = build(random_scene(rng, num_lamps), options=options)
    for p, n in random_points(rng, fewer(5, 1)):
        for num in NUM_PICKS:
            expected = all_expected(sampler, p, n, num)
            assert np.all((expected >= 0) & (expected <= 1))
            # The rest is lost where a node promised light that none of its children can give.
            assert expected.sum() <= num * (1 + ROUNDING)


@pytest.mark.parametrize("strategy", [POWER, UNIFORM])
@pytest.mark.parametrize("num", NUM_PICKS)
def test_without_a_tree_the_whole_budget_is_spent(strategy, num):
    rng = np.random.default_rng(7)
    sampler = build(random_scene(rng, 40), strategy)
    expected = all_expected(sampler, vec3((0, 0, 0)), UP, num)
    assert np.all(expected >= 0)
    assert expected.sum() == pytest.approx(num, rel=ROUNDING)


@pytest.mark.parametrize("importance", IMPORTANCES)
@pytest.mark.parametrize("extent", [3, 0])
def test_a_threshold_of_zero_lets_every_set_have_more_than_one_pick(importance, extent):
    rng = np.random.default_rng(7)
    positions = rng.uniform(-extent, extent, (100, 3)) + (0, 0, 5)
    sampler = build(
        floor_scene(point_lamps(positions)),
        options=TreeOptions(importance=importance, split_threshold=0.0, width=4),
    )
    for num in NUM_PICKS:
        # All lamps shine on the point, so nothing is lost on the way to them.
        expected = all_expected(sampler, vec3((0, 0, 0)), UP, num)
        assert expected.sum() == pytest.approx(num, rel=1e-6)


@pytest.mark.parametrize("importance", IMPORTANCES)
def test_a_threshold_of_one_means_one_pick_for_any_number_asked_for(importance):
    rng = np.random.default_rng(7)
    options = TreeOptions(importance=importance, split_threshold=1.0)
    sampler = build(random_scene(rng, 40), options=options)
    for p, n in random_points(rng, fewer(5, 2)):
        expected = all_expected(sampler, p, n, 1)
        for num in NUM_PICKS:
            np.testing.assert_array_equal(all_expected(sampler, p, n, num), expected)
            for u in EDGE_US:
                assert len(pick(sampler, p, n, num, u)[0]) <= 1


@examples(60, 8)
@given(seed=SEEDS, num_lamps=NUM_LAMPS, options=tree_options())
def test_every_pick_is_expected_as_often_as_its_twin_tells(seed, num_lamps, options):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, num_lamps)
    for strategy in SAMPLERS:
        sampler = build(scene, strategy, options)
        for p, n in random_points(rng, fewer(3, 1)):
            for num in NUM_PICKS:
                expected = all_expected(sampler, p, n, num)
                for u in (*EDGE_US[: fewer(5, 2)], *rng.random(fewer(5, 2))):
                    lights, told = pick(sampler, p, n, num, u)
                    assert len(lights) <= num
                    assert np.all(told > 0)
                    # To the last bit: what a scattered ray finds is weighed against this.
                    np.testing.assert_array_equal(told, expected[lights])


@pytest.mark.parametrize("strategy", SAMPLERS)
def test_the_largest_and_the_least_random_numbers_pick_lights_that_exist(strategy):
    rng = np.random.default_rng(7)
    sampler = build(random_scene(rng, 40), strategy)
    for p, n in random_points(rng, fewer(20, 2)):
        for num in NUM_PICKS:
            expected = all_expected(sampler, p, n, num)
            for u in EDGE_US:
                lights, _ = pick(sampler, p, n, num, u)
                assert np.all((lights >= 0) & (lights < len(expected)))
                assert np.all(expected[lights] > 0)
                assert len(lights) <= num


@examples(60, 6)
@given(seed=SEEDS, num_lamps=NUM_LAMPS, options=tree_options())
def test_no_light_that_contributes_is_left_out(seed, num_lamps, options):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, num_lamps, 5)
    sampler = build(scene, options=options)
    for p, n in random_points(rng, fewer(4, 1)):
        f = contributions(scene, p, n)
        for num in NUM_PICKS:
            expected = all_expected(sampler, p, n, num)
            # Below this share float32 cannot tell whether the light grazes the surface.
            assert np.all(expected[f > 1e-6 * f.sum()] > 0)


def test_without_a_tree_no_light_that_contributes_is_left_out():
    lamps = point_lamps([(0, 0, 2), (0, 0, 0)])
    lamps.kind[1], lamps.axis_w[1] = SUN, (0, 0, -1)
    for strategy in (POWER, UNIFORM):
        # One lamp has no extent that could tell how much of a sun's light falls on the scene.
        expected = all_expected(build(floor_scene(lamps), strategy), vec3((0, 0, 0)), UP)
        assert np.all(expected > 1e-3)


@examples(40, 5)
@given(seed=SEEDS, options=tree_options(), num=st.sampled_from(NUM_PICKS))
def test_over_all_random_numbers_each_light_is_picked_as_often_as_expected(seed, options, num):
    rng = np.random.default_rng(seed)
    sampler = build(random_scene(rng, 20, 5), options=options)
    p, n = next(random_points(rng, 1))
    expected = all_expected(sampler, p, n, num)
    num_u = fewer(512, 32)
    picked = frequencies(sampler, p, n, num, middles(num_u))
    # The u that pick one light are one stretch of the unit interval, taken as a circle: a light's
    # part of the budget, moved by a whole number. Of equally spaced u as many fall on it as its
    # length says, give or take one.
    np.testing.assert_allclose(picked, expected, rtol=0, atol=1 / num_u + ROUNDING)


@examples(30, 3)
@given(seed=SEEDS, options=tree_options(), num=st.sampled_from(NUM_PICKS))
def test_mean_of_the_estimates_is_the_light_of_all_lights(seed, options, num):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 20, 5)
    sampler = build(scene, options=options)
    p, n = next(random_points(rng, 1))
    f = contributions(scene, p, n, 8)
    expected = all_expected(sampler, p, n, num)
    num_u = fewer(1024, 64)
    estimates = []
    for u in middles(num_u):
        lights, told = pick(sampler, p, n, num, u)
        estimates.append(np.sum(f[lights] / told))
    # As in the test above each light comes up num_u x expected times, give or take one, and each
    # time it adds f / expected.
    lit = f > 1e-6 * f.sum()
    slack = np.sum(f[lit] / expected[lit]) / num_u + 1e-5 * f.sum()
    assert abs(np.mean(estimates) - f.sum()) <= slack


def test_counts_of_random_picks_pass_a_chi_square_test():
    rng = np.random.default_rng(7)
    for options in (TreeOptions(), TreeOptions(width=2, importance="clamped")):
        sampler = build(random_scene(rng, 30), options=options)
        num = fewer(20000, 500)
        for p, n in random_points(rng, fewer(3, 1)):
            expected = num * all_expected(sampler, p, n)
            counts = num * frequencies(sampler, p, n, 1, rng.random(num))
            assert np.all(counts[expected == 0] == 0)
            lost, num_lost = max(0, num - expected.sum()), num - counts.sum()
            common = expected > 10
            chi_sq = np.sum((counts - expected)[common] ** 2 / expected[common])
            # Chi-square has this mean and variance 2 x degrees; 5 deviations.
            assert chi_sq < common.sum() + 5 * np.sqrt(2 * common.sum())
            assert abs(num_lost - lost) <= 5 * np.sqrt(lost) + 1


@examples(30, 4)
@given(seed=SEEDS, options=tree_options(), log_energy=st.integers(-12, 12))
def test_nothing_is_infinite_or_not_a_number(seed, options, log_energy):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 20, 5)
    scene.lamps.radiance *= np.float32(10.0**log_energy)
    scene.materials.emission *= np.float32(10.0**-log_energy)
    sampler = build(scene, options=options)
    assert np.isfinite(lane_table(sampler.tree)[:, :6]).all()
    points = [*random_points(rng, fewer(3, 1)), (vec3(scene.lamps.position[0]), UP)]
    for p, n in [*points, (vec3((1e6, -1e6, 0)), UP)]:
        for num in NUM_PICKS:
            assert np.isfinite(all_expected(sampler, p, n, num)).all()
            for u in EDGE_US:
                lights, told = pick(sampler, p, n, num, u)
                assert np.all(np.isfinite(told) & (told > 0))
                assert len(lights) <= num


def test_a_light_behind_the_surface_is_never_picked():
    sampler = build(floor_scene(point_lamps([[0, 0, -1], [2, 0, -3]])))
    for num in NUM_PICKS:
        for u in EDGE_US:
            assert len(pick(sampler, vec3((0, 0, 0)), UP, num, u)[0]) == 0


def test_a_side_that_does_not_emit_is_never_picked():
    scene = random_scene(np.random.default_rng(7), 0, 0)
    scene.background[:] = 0
    add_triangles(scene, [[(-1, -1, 2), (0, 1, 2), (1, -1, 2)]], 1)  # its front looks down
    below, above = vec3((0, 0, 0)), vec3((0, 0, 4))
    sampler = build(scene)
    assert len(pick(sampler, below, UP, 4, 0.5)[0]) == 1
    assert len(pick(sampler, above, vec3((0, 0, -1)), 4, 0.5)[0]) == 0
