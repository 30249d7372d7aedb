"""What a light tree is told of each light is what the light emits, summed up numerically."""

import numpy as np
import oracle
import pytest
from core_scenes import add_triangles, fewer, floor_scene, materials, random_lamps
from tree_probe import vec3

from lighttree_core.light_points import emission_falloff, sample_light_point
from lighttree_core.lights import bound_lights, build_lights
from lighttree_core.sampling import uniform_pair
from lighttree_core.scene import DISK, ELLIPSE, POINT, RECTANGLE, SPHERE, SUN

KINDS = {"point": POINT, "sphere": SPHERE, "disk": DISK, "rectangle": RECTANGLE, "ellipse": ELLIPSE}
NUM_LAMPS, NUM_ANGLES = fewer(20, 4), fewer(2000, 400)


def emission(lights, light):
    """(angles from the axis, share of the peak intensity there); every light is round about it."""
    theta = (np.arange(NUM_ANGLES) + 0.5) / NUM_ANGLES * np.pi
    axis = lights.axis_w[light].astype(float)
    side, _ = oracle.tangents(axis) if axis.any() else ((1.0, 0.0, 0.0), None)
    axis = axis if axis.any() else np.array((0.0, 0.0, 1.0))
    directions = np.outer(np.cos(theta), axis) + np.outer(np.sin(theta), side)
    share = np.array([emission_falloff(lights, light, vec3(d)) for d in directions])
    if lights.kind[light] in (RECTANGLE, ELLIPSE):
        share = share * np.maximum(np.cos(theta), 0)
    return theta, share


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_flux_and_mean_cosine_are_the_integrals_of_what_is_emitted(kind):
    lamps = random_lamps(np.random.default_rng(7 + kind), NUM_LAMPS, kinds=(kind,))
    lights, _, _ = build_lights(floor_scene(lamps))
    bounds = bound_lights(lights)
    for light in range(NUM_LAMPS):
        theta, share = emission(lights, light)
        ring = 2 * np.pi * np.sin(theta) * np.pi / NUM_ANGLES
        # Half a ring at the edge of a cone, against its whole solid angle.
        edge = 2 * np.sin(bounds.theta_e[light]) * np.pi / NUM_ANGLES
        total = np.sum(share * ring)
        rel = 1e-3 + edge * np.pi / total
        assert bounds.flux[light] == pytest.approx(bounds.peak[light] * total, rel=rel)
        mean_cos = np.sum(share * ring * np.cos(theta)) / total
        if bounds.axis[light].any():
            assert bounds.mean_cos[light] == pytest.approx(mean_cos, abs=1e-3 + rel / 2)
        else:
            assert bounds.mean_cos[light] == 0
        assert theta[share > 0].max() <= bounds.theta_e[light] + 1e-3
        assert share.max() <= 1


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_peak_is_the_largest_irradiance_times_the_squared_distance(kind):
    lamps = random_lamps(np.random.default_rng(7 + kind), NUM_LAMPS, kinds=(kind,))
    bounds = bound_lights(build_lights(floor_scene(lamps))[0])
    for lamp in range(NUM_LAMPS):
        axis = bounds.axis[lamp] if bounds.axis[lamp].any() else np.array((1.0, 0, 0))
        distance = 1000.0
        far = bounds.mean[lamp] + distance * axis
        irradiance = oracle.lamp_irradiance(lamps, lamp, far, -axis, 32) @ oracle.LUMINANCE
        # The sizes of lamps over that distance are below 1e-2, and so are their angles.
        assert irradiance * distance**2 == pytest.approx(bounds.peak[lamp], rel=2e-2)


def test_a_sun_and_a_sky_are_told_by_their_irradiance():
    lamps = random_lamps(np.random.default_rng(7), NUM_LAMPS, kinds=(SUN,))
    scene = floor_scene(lamps)
    scene.background[:] = (0.1, 0.2, 0.3)
    bounds = bound_lights(build_lights(scene)[0])
    assert bounds.is_distant.all()
    for lamp in range(NUM_LAMPS):
        towards = -lamps.axis_w[lamp].astype(float)
        irradiance = oracle.lamp_irradiance(lamps, lamp, np.zeros(3), towards, 64)
        assert bounds.flux[lamp] == pytest.approx(irradiance @ oracle.LUMINANCE, rel=1e-3)
    assert bounds.flux[-1] == pytest.approx(np.pi * scene.background @ oracle.LUMINANCE, rel=1e-6)


def test_mean_and_variance_are_those_of_points_on_the_light():
    rng = np.random.default_rng(7)
    scene = floor_scene(random_lamps(rng, 6, kinds=(RECTANGLE, ELLIPSE)))
    scene.materials = materials((0.5, 0.0), (0.0, 1.0))
    add_triangles(scene, rng.uniform((-3, -3, 1), (3, 3, 4), (3, 3, 3)), 1)
    lights, _, _ = build_lights(scene)
    bounds, num = bound_lights(lights), fewer(4096, 256)
    p = np.array((1e3, 2e3, 3e3))  # so far that points are uniform over the light
    for light in range(len(lights.kind)):
        points = []
        for i in range(num):
            wi, distance, _ = sample_light_point(
                lights, light, vec3(p), vec3((1, 0, 0)), False, uniform_pair(7, 0, i, 0)
            )
            points.append(p + distance * np.array(wi, float))
        size = np.sqrt(bounds.variance[light])
        # Stratified points; distances of 4 km are rounded by 2^-12 m in float32.
        np.testing.assert_allclose(
            np.mean(points, axis=0), bounds.mean[light], atol=0.05 * size + 2e-3
        )
        spread = np.sum(np.var(points, axis=0))
        assert spread == pytest.approx(bounds.variance[light], rel=fewer(0.03, 0.15), abs=1e-4)


def test_the_two_sides_of_a_triangle_are_two_lights_with_opposite_axes():
    scene = floor_scene()
    scene.materials = materials((0.5, 0.0), (0.0, 1.0))
    scene.materials.emission[1, 1] = 3
    add_triangles(scene, [[(0, 0, 1), (2, 0, 1), (0, 2, 1)]], 1)
    lights, triangle_light, _ = build_lights(scene)
    bounds = bound_lights(lights)
    assert list(triangle_light[-1]) == [0, 1]
    np.testing.assert_allclose(bounds.axis, [(0, 0, 1), (0, 0, -1)], atol=1e-7)
    np.testing.assert_allclose(bounds.flux, [2 * np.pi, 6 * np.pi], rtol=1e-6)  # pi x area x L
    np.testing.assert_allclose(bounds.mean_cos, 2 / 3, rtol=1e-6)
