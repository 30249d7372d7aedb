"""Hard cases of light trees, one test each: kinds of light, directions, energies.

The others of the 44 are in the files named alike: places, shapes, sampling.
"""

import numpy as np
import oracle
import pytest
from core_scenes import (
    add_triangles,
    camera,
    fewer,
    floor_scene,
    lamps_down,
    materials,
    point_lamps,
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
    lane_lights,
    lane_table,
    middles,
    pick,
    second_moment,
    vec3,
)

from lighttree_core import Settings, render
from lighttree_core.light_points import (
    emission_falloff,
)
from lighttree_core.light_tree.importance import BEAM_FLOOR_SHARE, LOBE_SCALE
from lighttree_core.light_tree.nodes import AXIS, COS_CONE, FLUX
from lighttree_core.light_tree.options import CONE_AXES, IMPORTANCES, TreeOptions
from lighttree_core.lights import MAX_BEAM_ANGLE, bound_lights, build_lights
from lighttree_core.scene import (
    BACKGROUND,
    ELLIPSE,
    LAMP_KINDS,
    POINT,
    RECTANGLE,
    SUN,
)

ABOVE = [[(-1, -1, 2), (-1, 1, 2), (1, -1, 2)]]  # a triangle whose front looks down


def make_spot(lamps, lamp, half_angle, blend=0.0, axis=(0, 0, -1)):
    """Let a lamp shine within a cone only."""
    w = np.asarray(axis, float) / np.linalg.norm(axis)
    lamps.axis_u[lamp], lamps.axis_v[lamp] = oracle.tangents(w)
    lamps.axis_w[lamp], lamps.cos_cone[lamp], lamps.blend[lamp] = w, np.cos(half_angle), blend


def test_hard_case_01_a_lone_light_of_any_kind_is_picked_for_certain():
    scenes = {f"kind {kind}": floor_scene(lamps_down(kind, [(0, 0, 2)])) for kind in LAMP_KINDS}
    spot, narrow = lamps_down(POINT, [(0, 0, 2)]), lamps_down(RECTANGLE, [(0, 0, 2)])
    make_spot(spot, 0, 0.5, blend=0.5)
    narrow.spread[0] = 0.5
    scenes |= {"spot": floor_scene(spot), "narrow": floor_scene(narrow), "sky": floor_scene()}
    scenes["sky"].background[:] = 0.5
    scenes["triangle"] = floor_scene()
    scenes["triangle"].materials = materials((0.5, 0.0), (0.0, 1.0))
    scenes["triangle"].materials.emission[1, 1] = 0
    add_triangles(scenes["triangle"], ABOVE, 1)
    for name, scene in scenes.items():
        f = contributions(scene, ORIGIN, UP)
        assert f.shape == (1,) and f[0] > 0, name
        for importance in IMPORTANCES:
            sampler = build(scene, options=TreeOptions(importance=importance))
            assert_sound(sampler, ORIGIN, UP, f)
            for num in NUM_PICKS:
                assert all_expected(sampler, ORIGIN, UP, num)[0] == 1, name
                for u in EDGE_US:
                    assert list(pick(sampler, ORIGIN, UP, num, u)[0]) == [0], name


def test_hard_case_02_without_light_all_is_black_and_nothing_is_picked():
    dark = floor_scene(lamps_down(POINT, np.ones((3, 3)), 0.0))
    for scene in (floor_scene(), dark):
        sampler = build(scene)
        assert len(sampler.lights.kind) == 0
        assert all(len(pick(sampler, ORIGIN, UP, num, u)[0]) == 0 for num, u in ((1, 0), (4, 0.5)))
        assert render(scene, Settings(samples=1)).mean.max() == 0
    # Of three with light one has no size, so its power is zero: it is never picked.
    lamps = lamps_down((POINT, RECTANGLE, POINT), [(0, 0, 2), (1, 0, 2), (2, 0, 2)])
    lamps.axis_u[1] = 0
    for strategy in ("tree", "power", "uniform"):
        sampler = build(floor_scene(lamps), strategy)
        assert all_expected(sampler, ORIGIN, UP)[1] == 0
        assert all(1 not in pick(sampler, ORIGIN, UP, 2, u)[0] for u in middles(64))


def test_hard_case_13_cones_with_almost_the_same_or_opposite_axes_are_held():
    for turn in (0, 1e-7, 1e-4, np.pi / 2, np.pi - 1e-4, np.pi - 1e-7, np.pi):
        for half_angle in (1e-4, 0.3, np.pi / 2):
            lamps = lamps_down(POINT, [(x, 0, 2) for x in np.linspace(-1, 1, 20)])
            for lamp in range(20):
                angle = turn * (lamp % 2)
                make_spot(lamps, lamp, half_angle, axis=(np.sin(angle), 0, -np.cos(angle)))
            for cone_axis in CONE_AXES:
                sampler = build(floor_scene(lamps), options=TreeOptions(cone_axis=cone_axis))
                bounds = bound_lights(sampler.lights)
                for (node, k), lights in lane_lights(sampler.tree).items():
                    column = lane_table(sampler.tree)[node, :, k]
                    assert np.isfinite(column).all()
                    between = np.arccos(
                        np.clip(bounds.axis[lights] @ column[AXIS : AXIS + 3].astype(float), -1, 1)
                    )
                    # The cosine of a cone is rounded by 2^-24: its angle by sqrt(2 x 2^-24).
                    reach = between + bounds.theta_e[lights]
                    assert np.all(np.minimum(reach, np.pi) <= np.arccos(column[COS_CONE]) + 4e-4)
                p = vec3((0.02, 0, 0.5))
                assert_sound(sampler, p, UP, contributions(floor_scene(lamps), p, UP))


def test_hard_case_14_spots_of_all_angles_cover_all_that_they_light():
    for half_angle in (np.pi / 2, np.radians(89.9999), 1.0, np.radians(0.5), 1e-4):
        lamps = lamps_down(POINT, [(0, 0, 2), (5, 0, 2)])
        make_spot(lamps, 0, half_angle)
        scene = floor_scene(lamps)
        bounds, sampler = bound_lights(build_lights(scene)[0]), build(scene)
        assert np.all((bounds.theta_e[0] >= 0) & (bounds.theta_e[0] <= np.pi / 2 + 1e-6))
        assert np.isfinite(bounds.flux).all() and bounds.flux[0] > 0
        shares = []
        for x in 2 * np.tan(np.minimum(half_angle, 1.55) * np.linspace(0, 1.2, fewer(100, 20))):
            p = vec3((x, 0, 0))
            f = contributions(scene, p, UP)
            expected = assert_sound(sampler, p, UP, f)
            if f[0] > 0:
                shares.append(expected[0])
        if half_angle == 1e-4:
            # In float32 its cosine is one: an empty cone. Blender's narrowest is of 0.5 degrees.
            assert lamps.cos_cone[0] == 1 and not shares
            continue
        # Where it shines its share changes little from step to step: no flip, no hole.
        assert min(shares) > 0
        assert np.max(np.abs(np.diff(shares)), initial=0) < fewer(0.1, 0.4)


def test_hard_case_15_a_soft_spot_costs_little_across_the_edge_of_its_cone():
    half_angle, height = np.radians(30), 3.0
    for degrees in np.linspace(0, 35, fewer(141, 15)):
        x = height * np.tan(np.radians(degrees))
        # Beside a lamp as bright as the spot is on its axis, and beside dimmer ones.
        for dimmer in (1, 30, 1000):
            lamps = lamps_down(POINT, [(0, 0, height), (x, 0, height)], [10.0, 10.0 / dimmer])
            make_spot(lamps, 0, half_angle, blend=1.0)
            scene, p = floor_scene(lamps), vec3((x, 0, 0))
            f = contributions(scene, p, UP)
            expected = assert_sound(build(scene), p, UP, f)
            assert second_moment(f, expected) < 1.2
            # It goes to zero with the light, but for the floor of a beam.
            assert expected[0] <= 1.1 * f[0] / f.sum() + 2 * BEAM_FLOOR_SHARE * dimmer
            if degrees > 31:
                assert expected[0] == 0


def test_hard_case_16_scaled_and_sheared_lamps_lie_within_their_bounds():
    rng = np.random.default_rng(7)
    for is_sheared in (False, True):
        for _ in range(fewer(100, 20)):
            axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag(rng.uniform(0.3, 3, 3))
            if is_sheared:
                axes = axes @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
            lamps = lamps_down(POINT, [(0, 0, 0)])
            local_from_world = np.linalg.inv(axes)
            lamps.axis_u[0], lamps.axis_v[0] = local_from_world[:2]
            lamps.axis_w[0], lamps.cos_cone[0] = -local_from_world[2], np.cos(rng.uniform(0.2, 1.4))
            lights, _, _ = build_lights(floor_scene(lamps))
            bounds = bound_lights(lights)
            directions = rng.normal(size=(fewer(300, 40), 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            is_lit = [emission_falloff(lights, 0, vec3(d)) > 0 for d in directions]
            angles = np.arccos(np.clip(directions[is_lit] @ bounds.axis[0], -1, 1))
            assert np.max(angles, initial=0) <= bounds.theta_e[0] + 1e-3, (
                f"a {'sheared' if is_sheared else 'scaled'} spot shines beyond its cone"
            )
    # Of zero scale: without light, not in the tree, no number that is none.
    lamps = lamps_down((RECTANGLE, ELLIPSE, POINT), [(0, 0, 2), (1, 0, 2), (2, 0, 2)])
    lamps.axis_u[:2] = lamps.axis_v[:2] = lamps.axis_w[:2] = 0
    sampler = build(floor_scene(lamps))
    np.testing.assert_array_equal(assert_sound(sampler, ORIGIN, UP), (0, 0, 1))


def test_hard_case_17_an_area_lamp_of_any_spread_is_weighed_by_its_peak():
    for spread_deg in (180, 60, 10, 3, 1):
        half = min(np.radians(spread_deg) / 2, np.pi / 2 - 1e-7)
        # Of 1 W in all, its radiance rises as it narrows: pi x area x (1 - half / tan half).
        let_through = np.pi * (1 - half / np.tan(half))
        lamps = lamps_down((RECTANGLE, POINT), [(0, 0, 50), (0, 0.01, 50)], 1 / let_through)
        lamps.radiance[0] /= 0.01
        lamps.spread[0] = 2 * half
        scene = floor_scene(lamps)
        f, sampler = contributions(scene, ORIGIN, UP, 64), build(scene)
        assert f[0] == pytest.approx(f[1], rel=0.1)  # a point lamp of the same peak
        expected = assert_sound(sampler, ORIGIN, UP, f)
        # On its axis a beam is weighed by its peak. A wider lamp is a lobe of its flux and mean
        # cosine, whose peak is not quite the lamp's.
        is_beam = half < MAX_BEAM_ANGLE
        assert expected[0] / expected[1] == pytest.approx(1, rel=0.02 if is_beam else 0.35)
    # No spread at all: of no light, but not of none that are numbers.
    lamps.spread[0] = 0
    scene = floor_scene(lamps)
    assert np.isfinite(bound_lights(build_lights(scene)[0]).flux).all()
    assert_sound(build(scene), ORIGIN, UP)
    assert np.isfinite(emission_falloff(build_lights(scene)[0], 0, vec3((0, 0, -1))))


def test_hard_case_27_suns_of_all_sizes_are_found_beside_lamps():
    rng = np.random.default_rng(7)
    positions = np.vstack([(0, 0, 3), rng.uniform((-20, -20, 2), (20, 20, 6), (2000, 3))])
    for angle_deg in (0, 0.01, 0.5, 180):
        radius = np.radians(angle_deg) / 2
        for num_lamps, irradiance in ((1, 0.1), (1, 1e-3), (fewer(2000, 100), 0.1)):
            lamps = lamps_down(POINT, positions[: num_lamps + 1])
            lamps.kind[0], lamps.radius[0] = SUN, radius
            lamps.axis_w[0] = (0.6, 0, -0.8)
            lamps.radiance[0] = irradiance / (np.pi * np.sin(radius) ** 2 if radius else 1)
            scene, p = floor_scene(lamps), vec3((0.3, 0, 0))
            f = contributions(scene, p, UP)
            expected = assert_sound(build(scene), p, UP, f)
            # Its share is that of its irradiance, of the largest sun by its bound from above.
            assert 0.6 < (expected[0] / f[0]) / (expected[1:].sum() / f[1:].sum()) < 2.5
            assert second_moment(f, expected) < 1.3
    two = lamps_down(SUN, np.zeros((2, 3)), (1.0, 3.0))
    two.radius[1] = 1.0
    two.radiance[1] /= np.pi * np.sin(1.0) ** 2
    expected = assert_sound(build(floor_scene(two)), ORIGIN, UP)
    np.testing.assert_allclose(expected, (0.25, 0.75), rtol=1e-5)


def test_hard_case_28_a_sky_that_cannot_be_seen_takes_one_pick_at_most():
    rng = np.random.default_rng(7)
    scene = floor_scene(lamps_down(POINT, rng.uniform((-3, -3, 1), (3, 3, 2), (12, 3))))
    p = vec3((0.3, 0.2, 0))
    alone, f = build(scene), contributions(scene, p, UP)
    for brightness in (1e-6, 1.0, 1e6):
        scene.background[:] = brightness
        sampler = build(scene)
        sky = int(np.flatnonzero(sampler.lights.kind == BACKGROUND)[0])
        for num in (2, 4, 16):
            expected = all_expected(sampler, p, UP, num)
            # Sealed indoors the sky is a light like any other, which gets one pick; all others
            # are as if they were alone with one pick fewer, and the loss is bounded by that.
            fewer_picks = all_expected(alone, p, UP, num - 1)
            assert expected[sky] <= 1
            assert np.all(np.delete(expected, sky) >= fewer_picks * (1 - 1e-5))
        # One pick is shared: the loss there is the sky's part of the light, were it seen.
        expected = assert_sound(sampler, p, UP)
        seen = np.pi * brightness / (np.pi * brightness + f.sum())
        assert expected[sky] == pytest.approx(seen, rel=0.05)


def test_hard_case_29_no_energy_is_lost_between_lights_of_all_orders_of_magnitude():
    exponents = np.linspace(-12, 12, 75)
    rng = np.random.default_rng(7)
    for order in (np.arange(75), np.arange(75)[::-1], rng.permutation(75)):
        lamps = lamps_down(POINT, rng.uniform((-1, -1, 2), (1, 1, 3), (75, 3)))
        lamps.radiance[:] = 10.0 ** exponents[order][:, None]
        scene = floor_scene(lamps)
        for importance in IMPORTANCES:
            sampler = build(scene, options=TreeOptions(importance=importance))
            bounds = bound_lights(sampler.lights)
            scale = LOBE_SCALE if importance == "moments" else 1.0
            for (node, k), lights in lane_lights(sampler.tree).items():
                flux = lane_table(sampler.tree)[node, FLUX, k]
                assert flux == pytest.approx(scale * bounds.flux[lights].sum(), rel=1e-6)
            assert_sound(sampler, ORIGIN, UP)
            for num in NUM_PICKS:
                # All shine on the point, the faintest with 1e-24 of the light of the brightest.
                assert np.all(all_expected(sampler, ORIGIN, UP, num) > 0)
        film = render(scene, Settings(samples=2, max_bounces=1))
        assert film.dropped_samples == 0 and np.isfinite(film.mean).all()


def test_hard_case_30_a_negative_lamp_takes_away_exactly_its_light():
    lamps = lamps_down(POINT, [(0, 0, 2), (1, 0, 2), (0, 1, 3)], (10.0, -5.0, 2.0))
    scene = floor_scene(lamps)
    sampler, f = build(scene), contributions(scene, ORIGIN, UP)
    assert f[1] < 0
    expected = assert_sound(sampler, ORIGIN, UP, f)
    num = fewer(1024, 64)
    for num_picks in NUM_PICKS:
        estimates = []
        for u in middles(num):
            lights, told = pick(sampler, ORIGIN, UP, num_picks, u)
            estimates.append(np.sum(f[lights] / told))
        # Each light comes up num x expected times, give or take one.
        assert abs(np.mean(estimates) - f.sum()) <= np.sum(np.abs(f) / expected) / num


def test_hard_case_32_light_from_behind_is_found_on_surfaces_and_emitters_of_two_sides():
    # Both sides of a surface are lit and both may emit; translucent ones: test_hard_cases_surfaces.
    lamps = lamps_down(POINT, [(0, 0, -2)], 10.0)
    scene = floor_scene(lamps, camera=camera(1, 1, position=(0, 0, -1), half_width=1e-3))
    scene.camera.world_from_camera[:, 1:3] *= -1  # looks up, at the floor's back
    scene.materials = materials((0.5, 0.0), (0.0, 2.0))
    add_triangles(scene, np.array(ABOVE) * (1, 1, -1), 1)
    p, down = ORIGIN, vec3((0, 0, -1))
    f = contributions(scene, p, down, 128)
    assert (f > 0).sum() == 2  # the lamp and one side of the triangle, which would hide it
    assert_sound(build(scene), p, down, f)
    assert np.all(all_expected(build(scene), p, UP) == 0)
    scene.lamps = point_lamps(np.zeros((0, 3)))
    film = render(scene, Settings(samples=fewer(4096, 128), max_bounces=0))
    exact = contributions(scene, p, down, 128).sum() * 0.5 / np.pi
    tolerance = 4 * np.sqrt(film.variance[0, 0, 0]) + 5e-3 * exact
    assert abs(film.mean[0, 0, 0] - exact) < tolerance
