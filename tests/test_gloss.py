"""Lights are chosen by what a glossy surface reflects, too."""

import numpy as np
import pytest
from core_scenes import (
    fewer,
    floor_scene,
    lamps_down,
    needs_float32,
    random_scene,
)
from lobe_cases import evaluate, lambert, make_lobes, mirror, towards, transparent
from tree_probe import EDGE_US, ORIGIN, UP, all_expected, build, pick, random_points, vec3

from lighttree_core.light_tree.importance import GLOSS_SHARE, Gloss, glossy_part
from lighttree_core.light_tree.nodes import load_lane
from lighttree_core.lobes import find_gloss
from lighttree_core.scene import SPHERE


def gloss_of(makers, wo):
    lobes = make_lobes(makers, wo)
    return lobes, find_gloss(lobes, len(makers), vec3(UP), wo)


@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.4])
@pytest.mark.parametrize("degrees", [0, 40, 70])
def test_the_glossy_part_is_that_of_the_bsdf(alpha, degrees):
    wo = towards(degrees)
    lobes, gloss = gloss_of((mirror(alpha), lambert), wo)
    for turn in (0, 3, 10, 25):
        wi = towards(degrees - turn, 180)
        scene = floor_scene(lamps_down(SPHERE, [np.array(wi) * 1e4], 1.0))
        lane = load_lane(build(scene).tree.columns, 0, 0)
        top, bottom = glossy_part(gloss, vec3(UP), lane, lane.mean, np.float32(1e4))
        shine = top / bottom / GLOSS_SHARE
        whole, _ = evaluate(lobes, 2, wo, [wi])
        matt, _ = evaluate(make_lobes((lambert,), wo), 1, wo, [wi])
        expected = (whole - matt).mean() / (matt.mean() / wi[2])
        # Smith's term of wi is left out.
        assert expected * 0.99 < shine < expected * 1.3


def test_what_passes_straight_is_neither_glossy_nor_matt():
    wo = towards(30)
    assert (
        gloss_of((mirror(0.1), lambert), wo)[1]
        == gloss_of((transparent, mirror(0.1), lambert), wo)[1]
    )
    assert gloss_of((lambert, transparent), wo)[1].scale == 0


def glosses(rng, num):
    for _ in range(num):
        wo = vec3(np.array(towards(rng.uniform(0, 89), rng.uniform(0, 360))))
        yield Gloss(wo, np.float32(10 ** rng.uniform(-6, 0)), np.float32(10 ** rng.uniform(-2, 4)))


@needs_float32
@pytest.mark.parametrize("num", [1, 4])
def test_picks_by_gloss_are_as_expected_and_lose_no_light(num):
    rng = np.random.default_rng(7)
    sampler = build(random_scene(rng))
    points = random_points(rng, fewer(30, 4))
    for (p, _), gloss in zip(points, glosses(rng, fewer(30, 4)), strict=True):
        expected = all_expected(sampler, p, vec3(UP), num, gloss)
        assert np.all(expected[all_expected(sampler, p, vec3(UP), num) > 0] > 0)
        assert expected.sum() <= num * (1 + 1e-6)
        for u in (*EDGE_US, *rng.random(8)):
            lights, told = pick(sampler, p, vec3(UP), num, u, gloss)
            np.testing.assert_array_equal(told, expected[lights])


def test_a_lamp_in_the_mirror_is_chosen_more_often_than_its_like():
    sampler = build(floor_scene(lamps_down(SPHERE, [(3, 0, 3), (-3, 0, 3)], 1.0)))
    _, gloss = gloss_of((mirror(0.01), lambert), towards(45, 180))
    plain, (mirrored, other) = (
        all_expected(sampler, ORIGIN, UP),
        all_expected(sampler, ORIGIN, UP, 1, gloss),
    )
    np.testing.assert_allclose(plain, 0.5, rtol=1e-5)
    assert mirrored > 20 * other > 0


def test_small_lamps_in_a_wet_road_leave_fewer_spikes():
    """Against choosing lights as if the road were matt, by the mean square of one pick exactly."""
    rng = np.random.default_rng(7)
    lamps = rng.uniform([-30, 5, 1], [30, 60, 6], (fewer(400, 40), 3))
    sampler = build(floor_scene(lamps_down(SPHERE, lamps, 100.0), size=200.0))
    by_gloss, as_matt = [], []
    for place in rng.uniform([-5, 2, 0], [5, 20, 0], (fewer(60, 6), 3)):
        to_eye, to_lamps = np.array([0, 0, 1.5]) - place, lamps - place
        wo = vec3(to_eye / np.linalg.norm(to_eye))
        lobes, gloss = gloss_of((mirror(0.0625), lambert), wo)
        distance = np.linalg.norm(to_lamps, axis=1)
        value, _ = evaluate(lobes, 2, wo, to_lamps / distance[:, None])
        light = value.mean(axis=-1) / distance**2
        for found, own in ((by_gloss, gloss), (as_matt, None)):
            found.append((light**2 / all_expected(sampler, vec3(place), UP, 1, own)).sum())
    assert 3 * sum(by_gloss) < sum(as_matt)
