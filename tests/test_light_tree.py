"""The light tree: what it bounds, and that it chooses lights with the probabilities it tells."""

import numpy as np
import oracle
import pytest
from core_scenes import fewer, floor_scene, random_lamps, random_scene
from hypothesis import given, settings
from hypothesis import strategies as st

from lighttree_core.light_tree.nodes import NUM_TRAIL_BITS, load_node
from lighttree_core.light_tree.sample import SAMPLERS, build_sampler, pmf_light, sample_light
from lighttree_core.lights import NO_LIGHT, bound_lights, build_lights
from lighttree_core.scene import POINT, TRIANGLE, Lamps

UP = (np.float32(0), np.float32(0), np.float32(1))


def vec3(a):
    return tuple(np.float32(x) for x in a)


def build(scene, strategy="tree"):
    lights, _, _ = build_lights(scene)
    return build_sampler(lights, bound_lights(lights), strategy)


def random_points(rng, num):
    for _ in range(num):
        n = rng.normal(size=3)
        yield vec3(rng.uniform([-10, -10, -1], [10, 10, 4])), vec3(n / np.linalg.norm(n))


def all_pmfs(sampler, p, n):
    return np.array([pmf_light(sampler, i, p, n) for i in range(len(sampler.lights.kind))])


@pytest.mark.parametrize("strategy", SAMPLERS)
@settings(max_examples=fewer(20, 2), deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32), num_lamps=st.integers(0, 40))
def test_probabilities_sum_to_one_or_less(strategy, seed, num_lamps):
    rng = np.random.default_rng(seed)
    sampler = build(random_scene(rng, num_lamps), strategy)
    for p, n in random_points(rng, 5):
        pmfs = all_pmfs(sampler, p, n)
        assert np.all((pmfs >= 0) & (pmfs <= 1))
        # The rest is lost where a node promised light that none of its children can give.
        assert pmfs.sum() <= 1 + 1e-5
        if strategy != "tree":
            assert pmfs.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("strategy", SAMPLERS)
def test_sampled_probability_is_the_one_its_twin_tells(strategy):
    rng = np.random.default_rng(7)
    sampler = build(random_scene(rng, 40), strategy)
    for p, n in random_points(rng, 20):
        for u in (0.0, 0.25, 2.0**-149, 1 - 2.0**-24, 1 - 2.0**-53, *rng.random(10)):
            light, pmf = sample_light(sampler, p, n, u)
            if light != NO_LIGHT:
                assert pmf > 0
                assert pmf == pmf_light(sampler, light, p, n)


def test_lights_are_chosen_as_often_as_their_probability_says():
    rng = np.random.default_rng(7)
    sampler = build(random_scene(rng, 30))
    num = fewer(20000, 1000)
    for p, n in random_points(rng, 3):
        pmfs = all_pmfs(sampler, p, n)
        chosen = [sample_light(sampler, p, n, u)[0] for u in rng.random(num)]
        counts = np.bincount(np.array(chosen) + 1, minlength=len(pmfs) + 1)[1:]
        assert np.all(counts[pmfs == 0] == 0)
        common = num * pmfs > 10
        chi_sq = np.sum((counts - num * pmfs)[common] ** 2 / (num * pmfs)[common])
        degrees = common.sum()
        # Chi-square has this mean and variance 2 x degrees; 5 deviations.
        assert chi_sq < degrees + 5 * np.sqrt(2 * degrees)


@settings(max_examples=fewer(30, 3), deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32))
def test_tree_never_starves_a_light_that_contributes(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 15, 5)
    sampler = build(scene)
    lights, triangle_light, background = build_lights(scene)
    for p, n in random_points(rng, 4):
        for lamp in range(15):
            if oracle.lamp_irradiance(scene.lamps, lamp, p, n, 16).max() > 1e-6:
                assert pmf_light(sampler, lamp, p, n) > 0
        for triangle, sides in enumerate(triangle_light):
            emission = scene.materials.emission[scene.triangle_material[triangle]]
            corners = scene.vertices[scene.triangles[triangle]]
            for side in (0, 1):
                one_side = emission * (np.arange(2) == side)[:, None]
                if oracle.triangle_irradiance(corners, one_side, p, n, 16).max() > 1e-6:
                    assert pmf_light(sampler, sides[side], p, n) > 0
        assert pmf_light(sampler, background, p, n) > 0
    assert np.sum(lights.kind == TRIANGLE) == np.sum(triangle_light >= 0)


def test_nodes_bound_their_lights_and_hold_each_once():
    rng = np.random.default_rng(7)
    lights, _, _ = build_lights(random_scene(rng, 200, 50))
    bounds = bound_lights(lights)
    tree = build_sampler(lights, bounds).tree
    local = ~bounds.is_distant
    assert np.unique(tree.leaf[bounds.energy > 0]).size == len(lights.kind)

    def visit(node):
        child = tree.first_child[node]
        below = [~child] if child < 0 else visit(child) + visit(child + 1)
        row = load_node(tree, node)
        if np.isfinite(row.variance):
            low, high = np.subtract(row.mean, row.half_extent), np.add(row.mean, row.half_extent)
            assert np.all(low <= bounds.box_min[below] + 1e-6)
            assert np.all(high >= bounds.box_max[below] - 1e-6)
            assert row.energy == pytest.approx(bounds.energy[below].sum(), rel=1e-5)
            if row.cos_cone > -1:
                between = np.arccos(np.clip(bounds.axis[below] @ row.axis, -1, 1))
                assert np.all(between + bounds.theta_e[below] <= np.arccos(row.cos_cone) + 1e-3)
        return below

    assert sorted(visit(0)) == list(range(len(lights.kind)))
    assert local.any()


def lamps_at(positions, intensities) -> Lamps:
    lamps = Lamps.empty(len(positions))
    lamps.kind[:] = POINT
    lamps.position[:] = positions
    lamps.radiance[:] = np.asarray(intensities, float)[:, None]
    lamps.names = [f"Lamp.{i}" for i in range(len(positions))]
    return lamps


@pytest.mark.parametrize(
    "positions",
    [
        np.zeros((1000, 3)) + 1,
        np.outer(np.arange(1000), [1, 0, 0]),
        np.array([[12.0**k, 0, 1] for k in range(-20, 15)]),
        np.stack([*np.mgrid[:10, :10, :10]], -1).reshape(-1, 3),
    ],
    ids=["coincident", "on a line", "powers of 12", "grid"],
)
def test_awkward_positions_build_a_tree_within_its_trail(positions):
    lights, _, _ = build_lights(floor_scene(lamps_at(positions, np.ones(len(positions)))))
    sampler = build_sampler(lights, bound_lights(lights))
    first_child = sampler.tree.first_child
    depth = np.zeros(len(first_child), int)
    for node, child in enumerate(first_child):
        if child >= 0:
            depth[child : child + 2] = depth[node] + 1
    assert depth.max() < NUM_TRAIL_BITS
    p = vec3((0.1, 0.2, 0.0))
    pmfs = all_pmfs(sampler, p, UP)
    for u in np.linspace(0, 1, 50, endpoint=False):
        light, pmf = sample_light(sampler, p, UP, u)
        assert light == NO_LIGHT or pmf == pmfs[light] > 0


def test_no_light_or_none_with_energy_is_never_chosen():
    assert sample_light(build(floor_scene()), vec3((0, 0, 0)), UP, 0.5) == (NO_LIGHT, 0)
    dark = floor_scene(lamps_at(np.ones((3, 3)), [0, 5, 0]))
    lights, _, _ = build_lights(dark)
    assert len(lights.kind) == 1


def test_light_behind_the_surface_is_never_chosen():
    sampler = build(floor_scene(lamps_at([[0, 0, -1], [2, 0, -3]], [1, 1])))
    assert sample_light(sampler, vec3((0, 0, 0)), UP, 0.5) == (NO_LIGHT, 0)


def test_probabilities_do_not_depend_on_the_scale_of_the_scene():
    rng = np.random.default_rng(7)
    lamps = random_lamps(rng, 30, kinds=(POINT,))
    p, n = next(random_points(rng, 1))
    expected = all_pmfs(build(floor_scene(lamps)), p, n)
    for factor in (1e-4, 1e4):
        lamps.position *= np.float32(factor)
        pmfs = all_pmfs(build(floor_scene(lamps)), vec3(np.multiply(p, factor)), n)
        lamps.position /= np.float32(factor)
        np.testing.assert_allclose(pmfs, expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("num_lamps", [1, 20, 500])
def test_tree_is_never_worse_than_power_sampling(num_lamps):
    rng = np.random.default_rng(7)
    scene = floor_scene(random_lamps(rng, num_lamps, kinds=(POINT,)))
    tree, power = build(scene), build(scene, "power")
    variances = {"tree": 0.0, "power": 0.0}
    for p, _ in random_points(rng, fewer(50, 5)):
        f = np.array([oracle.lamp_irradiance(scene.lamps, i, p, UP)[0] for i in range(num_lamps)])
        for name, sampler in (("tree", tree), ("power", power)):
            pmfs = all_pmfs(sampler, p, UP)
            lit = f > 0
            variances[name] += np.sum(f[lit] ** 2 / pmfs[lit]) - f.sum() ** 2
    assert variances["tree"] <= 1.05 * variances["power"] + 1e-6
