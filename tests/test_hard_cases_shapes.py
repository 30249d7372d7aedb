"""Hard cases of light trees, one test each: emitters tiny, thin, mirrored, instanced, many.

The others of the 44 are in the files named alike: places, lights, sampling.
"""

import numpy as np
import pytest
from core_scenes import (
    add_triangles,
    emitters,
    fewer,
    floor_scene,
    materials,
    point_lamps,
)
from tree_probe import (
    DOWN,
    EDGE_US,
    UP,
    all_expected,
    assert_complete,
    assert_sound,
    build,
    contributions,
    pick,
    sampled_irradiance,
    vec3,
)

from lighttree_core import Settings, render
from lighttree_core.light_tree.options import IMPORTANCES, TreeOptions
from lighttree_core.lights import NO_LIGHT, bound_lights, build_lights
from lighttree_core.scene import (
    DISK,
    ELLIPSE,
    RECTANGLE,
    SPHERE,
)

QUAD = np.array([[(-1, -1, 0), (1, -1, 0), (1, 1, 0)], [(-1, -1, 0), (1, 1, 0), (-1, 1, 0)]], float)


def test_hard_case_18_tiny_thin_and_grazing_emitters_give_the_light_they_have():
    lamps = point_lamps([(1000, 0, 5), (0, 0, 2)])
    lamps.kind[:] = RECTANGLE
    # A square millimetre a kilometre away, and a square seen at an angle of 1:2000.
    lamps.axis_u[:], lamps.axis_v[:] = [(0, 1e-3, 0), (1, 0, 0)], [(0, 0, 1e-3), (0, 0, 1)]
    lamps.axis_w[:], lamps.radiance[0] = [(-1, 0, 0), (0, -1, 0)], 1e9
    scene = floor_scene(lamps)
    scene.materials = materials((0.5, 0.0), (0.0, 1.0))
    for height, width in ((2, 1e-2), (2.5, 1e-3), (3, 1e-4)):  # the last 1:1e5
        add_triangles(scene, [[(-5, 1, height), (5, 1 + width, height), (5, 1, height)]], 1)
    p = vec3((0.1, -1e-3, 0.0))
    sampler = build(scene)
    f = contributions(scene, p, UP, 64)
    assert_sound(sampler, p, UP, f)
    num = fewer(2048, 256)
    for light in np.flatnonzero(f > 0):
        values = sampled_irradiance(sampler.lights, light, p, UP, num)
        assert np.isfinite(values).all()
        # 4 deviations, and one percent for the grid of the oracle.
        slack = 4 * values.std() / np.sqrt(num) + 1e-2 * f[light]
        assert abs(values.mean() - f[light]) < slack
        # No bands: the estimates differ by what cosines and distances do, hardly at all.
        assert values[values > 0].max() < 50 * f[light]


def test_hard_case_19_emitters_of_no_area_are_left_out():
    scene = emitters(QUAD + (0, 0, 3), back=1.0)
    expected = render(scene, Settings(samples=fewer(16, 2), max_bounces=1)).mean
    add_triangles(scene, [[(0, 0, 1), (1, 1, 1), (2, 2, 1)], [(1, 1, 1)] * 3], 1)
    lamps = point_lamps([(0, 0, 2)] * 4)
    lamps.kind[:] = (RECTANGLE, ELLIPSE, SPHERE, DISK)
    lamps.axis_u[:2], lamps.axis_w[:2] = (1, 0, 0), (0, 0, -1)
    scene.lamps = lamps
    lights, triangle_light, _ = build_lights(scene)
    assert np.all(triangle_light[-2:] == NO_LIGHT)
    sampler = build(scene)
    assert np.all(sampler.tree.light_lane[:4] == -1)
    assert np.all(assert_sound(sampler, vec3((0.1, 0, 0)), UP)[:4] == 0)
    for strategy in ("power", "uniform"):
        assert np.all(all_expected(build(scene, strategy), vec3((0.1, 0, 0)), UP)[:4] == 0)
    lights_of = np.flatnonzero(bound_lights(lights).flux > 0)
    assert len(lights_of) == 4
    scene.lamps = point_lamps(np.zeros((0, 3)))
    np.testing.assert_array_equal(
        render(scene, Settings(samples=fewer(16, 2), max_bounces=1)).mean, expected
    )


def test_hard_case_20_behind_a_wall_of_windows_no_light_is_asked():
    windows = [
        (QUAD * 0.4)[:, :, [0, 2, 1]] + (x, 0, z) for x in range(-8, 9, 2) for z in range(1, 9, 2)
    ]
    scene = emitters(*windows)
    for importance in IMPORTANCES:
        sampler = build(scene, options=TreeOptions(importance=importance))
        lit, dark = vec3((0.5, -3, 0)), vec3((0.5, 3, 0))
        f = contributions(scene, lit, UP)
        if not f.any():
            lit, dark = dark, lit
            f = contributions(scene, lit, UP)
        assert assert_sound(sampler, lit, UP, f).sum() == pytest.approx(1, abs=1e-5)
        assert np.all(assert_sound(sampler, dark, UP) == 0)
        for u in EDGE_US:
            assert len(pick(sampler, dark, UP, 4, u)[0]) == 0


def test_hard_case_21_a_two_sided_plane_lights_both_rooms_alike():
    scene = emitters(QUAD + (0, 0, 2), back=1.0)
    sampler = build(scene)
    below, above = vec3((0.3, 0.2, 0)), vec3((0.3, 0.2, 4))
    expected = assert_sound(sampler, below, UP, contributions(scene, below, UP))
    mirrored = assert_sound(sampler, above, DOWN, contributions(scene, above, DOWN))
    # Rows: two fronts, then two backs; each room sees one side of each triangle, at equal shares.
    np.testing.assert_allclose(mirrored, np.roll(expected, 2), rtol=1e-5)
    assert expected.sum() == pytest.approx(1, abs=1e-5)
    np.testing.assert_array_equal(expected[:2], 0)
    flux = bound_lights(sampler.lights).flux
    assert flux.sum() == pytest.approx(2 * 4 * np.pi, rel=1e-5)  # pi x radiance x area a side


def test_hard_case_22_a_mirrored_emitter_lights_the_mirrored_side():
    rng = np.random.default_rng(7)
    mesh = rng.uniform((-2, -2, 1), (2, 2, 4), (20, 3, 3))
    # A mesh comes as its triangles in the world, their corners exchanged where it is mirrored.
    mirrored = (mesh * (-1, 1, 1))[:, ::-1]
    one, other = emitters(mesh), emitters(mirrored)
    for x, y in rng.uniform(-3, 3, (fewer(10, 2), 2)):
        p, q = vec3((x, y, 0)), vec3((-x, y, 0))
        f, g = contributions(one, p, UP), contributions(other, q, UP)
        # The oracle's grid is not the same seen in a mirror.
        np.testing.assert_allclose(g, f, rtol=3e-2, atol=1e-3 * f.max())
        expected = assert_sound(build(one), p, UP, f)
        np.testing.assert_allclose(assert_sound(build(other), q, UP, g), expected, rtol=1e-3)


def test_hard_case_23_thousands_of_instances_are_their_triangles_in_the_world():
    rng = np.random.default_rng(7)
    tetrahedron = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])[
        np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    ]
    num = fewer(2500, 12)  # 4 triangles each
    matrices = rng.normal(size=(num, 3, 3)) * 0.3  # sheared, scaled unevenly, some mirrored
    matrices[::3] = np.eye(3) * rng.uniform(0.1, 1, (len(matrices[::3]), 1, 1))
    places = rng.uniform((-30, -30, 2), (30, 30, 20), (num, 1, 1, 3))
    corners = np.einsum("mij,tcj->mtci", matrices, tetrahedron) + places
    scene = emitters(corners.reshape(-1, 3, 3), back=0.5)
    sampler = assert_complete(scene)
    bounds = bound_lights(sampler.lights)
    a, b, c = np.moveaxis(corners, 2, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2
    assert bounds.flux.sum() == pytest.approx(np.pi * area * 1.5, rel=1e-4)
    p = vec3((1, 2, 0))
    # What a triangle gives as if all of it were in its middle, front and back.
    to_light = (a + b + c).reshape(-1, 3) / 3 - np.array(p, float)
    doubled = np.cross(b - a, c - a).reshape(-1, 3)
    cosines = -np.sum(doubled * to_light, axis=1) * np.maximum(to_light[:, 2], 0) / 2
    front = cosines / np.sum(to_light**2, axis=1) ** 2
    f = np.concatenate([np.maximum(front, 0), 0.5 * np.maximum(-front, 0)])
    expected = all_expected(sampler, p, UP, 4)
    assert np.all(expected[f > 1e-6 * f.sum()] > 0)
    assert expected.sum() <= 4 + 1e-5
    num, estimates = fewer(4096, 64), []
    for u in (np.arange(num) + 0.5) / num:
        lights, told = pick(sampler, p, UP, 4, u)
        np.testing.assert_array_equal(told, expected[lights])
        estimates.append(np.sum(f[lights] / told))
    # A light comes up num x expected times, off by less than one either way: over thousands of
    # lights these differences add up as if at random, here to 4 of their deviations.
    lit = f > 1e-6 * f.sum()
    deviation = np.sqrt(np.sum((f[lit] / expected[lit]) ** 2)) / num
    assert abs(np.mean(estimates) - f.sum()) <= 4 * deviation + 1e-5 * f.sum()


def test_hard_case_24_an_emitting_material_that_no_triangle_has_adds_nothing():
    with_slot, without = emitters(QUAD + (0, 0, 2)), emitters(QUAD + (0, 0, 2))
    with_slot.materials = materials((0.5, 0.0), (0.0, (1.0, 1.0, 1.0)), (0.5, 1e9))
    with_slot.materials.emission[1, 1] = 0
    trees = [build(scene).tree for scene in (with_slot, without)]
    for name in trees[0]._fields:
        np.testing.assert_array_equal(getattr(trees[0], name), getattr(trees[1], name))


def test_hard_case_25_picks_are_shared_by_power_not_by_number_of_triangles():
    def panel(num_triangles):
        side = round(np.sqrt(num_triangles / 2))
        cells = np.stack(np.meshgrid(*[np.arange(side)] * 2), -1).reshape(-1, 1, 1, 2)
        corners = np.concatenate([(QUAD[..., :2] + 1) / side + 2 * cells / side - 1])
        return np.insert(corners, 1, 0, axis=-1).reshape(-1, 3, 3) + (0, 0, 3)

    lamp, sign = panel(8), panel(fewer(100_000, 200))
    scene = emitters(lamp - (1.5, 0, 0), sign + (1.5, 0, 0), back=1.0)
    sampler = build(scene)
    bounds = bound_lights(sampler.lights)
    is_lamp = np.arange(len(bounds.flux)) % (len(lamp) + len(sign)) < len(lamp)
    assert bounds.flux[is_lamp].sum() == pytest.approx(bounds.flux[~is_lamp].sum(), rel=1e-3)
    # Halfway between both, so each gives half of the light; in each one, all cells count.
    for p in ((0, -2, 0), (0, 4, 1)):
        lights, _ = zip(
            *(pick(sampler, vec3(p), UP, 1, u) for u in np.linspace(0, 1, 400, endpoint=False)),
            strict=True,
        )
        share = np.mean([is_lamp[light[0]] for light in lights])
        # By symmetry a half; lanes of the finer panel are estimated a little differently.
        assert share == pytest.approx(0.5, abs=0.05)
