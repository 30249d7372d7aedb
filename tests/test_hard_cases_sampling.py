"""Hard cases of light trees, one test each: random numbers, budgets of picks, threads.

The others of the 44 are in the files named alike: places, shapes, lights.
"""

import dataclasses

import numpy as np
import oracle
import pytest
from core_scenes import (
    camera,
    fewer,
    floor_scene,
    furnace,
    lamps_down,
    random_scene,
)
from tree_probe import (
    EDGE_US,
    NUM_PICKS,
    ORIGIN,
    UP,
    all_expected,
    assert_sound,
    build,
    contributions,
    middles,
    pick,
    random_points,
    second_moment,
    vec3,
)

from lighttree_core import Settings, render
from lighttree_core.light_tree.nodes import load_lane
from lighttree_core.light_tree.options import IMPORTANCES, TreeOptions
from lighttree_core.light_tree.sample import uncertainty
from lighttree_core.scene import (
    POINT,
    SUN,
)


def test_hard_case_35_random_numbers_on_the_bounds_pick_lights_that_can_be():
    lamps = lamps_down(POINT, [(x, 0, 2) for x in range(8)], np.arange(1, 9))
    lamps.position[[0, 3, 7], 2] = -1  # the first, the last and one more are below the floor
    sampler = build(floor_scene(lamps))
    expected = all_expected(sampler, ORIGIN, UP)
    assert list(np.flatnonzero(expected == 0)) == [0, 3, 7]
    order = np.argsort(sampler.tree.light_lane)
    for num in NUM_PICKS:
        expected = all_expected(sampler, ORIGIN, UP, num)
        bounds = np.cumsum(expected[order]) % 1
        us = [*EDGE_US, 1 - 2.0**-24, *bounds, *np.nextafter(bounds, 0), *np.nextafter(bounds, 1)]
        for u in us:
            if 0 <= u < 1:
                lights, told = pick(sampler, ORIGIN, UP, num, u)
                assert len(lights) <= num and np.all((lights >= 0) & (lights < 8))
                assert np.all(expected[lights] > 0)
                np.testing.assert_array_equal(told, expected[lights])


def test_hard_case_36_infinite_and_local_lights_are_all_reached_as_u_goes_from_0_to_1():
    lamps = lamps_down(
        (SUN, SUN, *[POINT] * 20), np.mgrid[:22, :1, :1].reshape(3, -1).T + (0, 0, 2)
    )
    lamps.axis_w[1] = (0.6, 0, -0.8)
    scene = floor_scene(lamps)
    scene.background[:] = 0.3
    sampler = build(scene)
    num = fewer(4096, 512)
    p = vec3((4.5, 0, 0))
    for num_picks in NUM_PICKS:
        expected = all_expected(sampler, p, UP, num_picks)
        picked = {
            int(light) for u in middles(num) for light in pick(sampler, p, UP, num_picks, u)[0]
        }
        assert set(np.flatnonzero(expected > 1.01 / num)) <= picked
        assert {0, 1, 22} <= picked


def test_hard_case_37_points_and_normals_that_are_no_numbers_do_no_harm():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, 40)
    nan, inf = np.float32(np.nan), np.float32(np.inf)
    for importance in IMPORTANCES:
        sampler = build(scene, options=TreeOptions(importance=importance))
        for bad in ((nan, nan, nan), (nan, ORIGIN[0], ORIGIN[0]), (inf, -inf, inf)):
            for p, n in ((bad, UP), (vec3((1, 2, 0)), bad), (bad, bad)):
                for num in NUM_PICKS:
                    for u in EDGE_US:
                        lights, told = pick(sampler, p, n, num, u)
                        assert len(lights) <= num
                        assert np.all((lights >= 0) & (lights < len(sampler.lights.kind)))
                        assert not np.any(told <= 0)
    # In a render such a path would be counted and dropped; no finite scene is known to have one.
    film = render(scene, Settings(samples=2, max_bounces=1))
    assert film.dropped_samples == 0 and np.isfinite(film.mean).all()


@pytest.mark.skip(reason="There is no light linking: every light shines on all; import notes it.")
def test_hard_case_38_unlinked_lights_are_never_picked():
    pass


@pytest.mark.skip(reason="There are no volumes: light is gathered on surfaces alone.")
def test_hard_case_39_a_ray_through_a_volume_gathers_light_without_bands():
    pass


def test_hard_case_40_splitting_keeps_to_its_number_at_any_threshold():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, 60, 10)
    plain = build(scene)
    p, n = next(random_points(rng, 1))
    lanes = [k for k in range(16) if plain.tree.child[0, k] > 0]
    borderline = [float(uncertainty(load_lane(plain.tree.columns, 0, k), p)) for k in lanes]
    assert borderline
    for threshold in (0.0, 1.0, *borderline, *np.nextafter(np.float32(borderline), 0)):
        sampler = build(scene, options=TreeOptions(split_threshold=min(1.0, float(threshold))))
        expected = assert_sound(sampler, p, n)
        if threshold == 1:
            np.testing.assert_array_equal(all_expected(sampler, p, n, 16), expected)
    # A light that a scattered ray hits is weighed by what picking expects of it.
    for threshold in (0.0, 0.3, 1.0):
        settings = Settings(
            samples=fewer(64, 4),
            split_lights=4,
            max_bounces=1,
            tree=TreeOptions(split_threshold=threshold),
        )
        film = render(furnace(albedo=0.5, emission=1.0), settings)
        variance = film.variance.mean() / film.depth.size
        assert abs(film.mean.mean() - 1.75) < 4 * np.sqrt(variance) + 1e-5  # 1 + 1/2 + 1/4


def test_hard_case_42_one_image_for_one_two_and_eight_threads():
    # Nothing is learned while rendering, so there is nothing that threads could read too early.
    scene = random_scene(np.random.default_rng(7), 40)
    scene.camera = camera(fewer(24, 6), fewer(16, 4))
    settings = Settings(samples=fewer(8, 1), seed=5)
    images = [
        render(scene, dataclasses.replace(settings, threads=threads)).mean for threads in (1, 2, 8)
    ]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_hard_case_43_in_smooth_scenes_the_tree_is_never_noisier_than_power_or_uniform():
    for seed in range(fewer(10, 2)):
        rng = np.random.default_rng(100 + seed)
        scene = random_scene(rng, fewer(80, 20), 0, extent=rng.choice([2, 10, 40]))
        samplers = {name: build(scene, name) for name in ("tree", "power", "uniform")}
        variance = dict.fromkeys(samplers, 0.0)
        for p, n in random_points(rng, fewer(10, 2)):
            f = contributions(scene, p, n, 8)
            best = oracle.best_probabilities(scene, np.array(p, float), np.array(n, float), 8)
            assert second_moment(f, best) == pytest.approx(1, rel=1e-6)
            for name, sampler in samplers.items():
                variance[name] += (second_moment(f, all_expected(sampler, p, n)) - 1) * f.sum() ** 2
        assert variance["tree"] <= 1.05 * min(variance["power"], variance["uniform"])
