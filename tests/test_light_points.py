"""Sampled light points give the oracle's irradiance, with the density that their twin tells."""

import numpy as np
import oracle
import pytest
from core_scenes import fewer, random_scene

from lighttree_core.light_points import light_radiance, pdf_light_point, sample_light_point
from lighttree_core.lights import bound_lights, build_lights
from lighttree_core.sampling import uniform_pair
from lighttree_core.scene import LAMP_KINDS, POINT, SUN

NUM = fewer(4096, 256)
NAMES = ("point", "sphere", "disk", "rectangle", "ellipse", "sun")


def _vec3(a):
    return tuple(np.float32(x) for x in a)


def _irradiance_samples(lights, light, p, n):
    """Irradiance at p from one light by each of NUM samples, (NUM, 3)."""
    values = np.zeros((NUM, 3))
    for i in range(NUM):
        wi, distance, pdf = sample_light_point(lights, light, p, n, False, uniform_pair(7, 0, i, 0))
        cos = np.dot(n, wi)
        if pdf > 0 and cos > 0:
            values[i] = np.array(light_radiance(lights, light, wi, distance)) * cos / pdf
    return values


def _assert_irradiance(values, expected):
    # 4 deviations of the mean, as if samples were random; they are stratified and better. Half a
    # percent more for the oracle's own grid.
    tolerance = 4 * values.std(0) / np.sqrt(NUM) + 5e-3 * np.abs(expected) + 1e-7
    np.testing.assert_array_less(np.abs(values.mean(0) - expected), tolerance)


@pytest.mark.parametrize("kind", LAMP_KINDS, ids=NAMES)
def test_samples_of_a_lamp_give_its_irradiance(kind):
    rng = np.random.default_rng(7 + kind)
    scene = random_scene(rng, num_lamps=6, num_triangles=0, kinds=(kind,), extent=2)
    scene.background[:] = 0
    lights, _, _ = build_lights(scene)
    for light in range(6):
        p, n = rng.uniform([-2, -2, -1], [2, 2, 0]), np.array([0.0, 0.0, 1.0])
        expected = oracle.lamp_irradiance(scene.lamps, light, p, n)
        _assert_irradiance(_irradiance_samples(lights, light, _vec3(p), _vec3(n)), expected)


def test_samples_of_triangles_and_background_give_their_irradiance():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, num_lamps=0, num_triangles=6)
    lights, triangle_light, background = build_lights(scene)
    p, n = np.array([0.2, 0.3, 0.0]), np.array([0.0, 0.0, 1.0])
    sky = _irradiance_samples(lights, background, _vec3(p), _vec3(n))
    _assert_irradiance(sky, np.pi * scene.background)
    for triangle in range(2, len(scene.triangles)):
        corners = scene.vertices[scene.triangles[triangle]]
        emission = scene.materials.emission[scene.triangle_material[triangle]]
        expected = oracle.triangle_irradiance(corners, emission, p, n)
        rows = [light for light in triangle_light[triangle] if light >= 0]
        values = sum(_irradiance_samples(lights, row, _vec3(p), _vec3(n)) for row in rows)
        _assert_irradiance(values, expected)


def test_densities_integrate_to_one():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, num_lamps=20, num_triangles=4)
    lights, _, _ = build_lights(scene)
    p, n = _vec3((0.3, -0.2, 0.0)), _vec3((0.0, 0.0, 1.0))
    for light in range(len(lights.kind)):
        kind, radius = lights.kind[light], lights.radius[light]
        if kind == POINT or (kind == SUN and radius == 0):
            continue
        inverse = []
        for i in range(NUM):
            wi, distance, pdf = sample_light_point(
                lights, light, p, n, False, uniform_pair(7, 0, i, 0)
            )
            twin = pdf_light_point(lights, light, p, n, False, wi, distance)
            assert twin == pytest.approx(pdf, rel=1e-6)
            inverse.append(1 / pdf if pdf > 0 else 0.0)
        solid_angle = np.mean(inverse)  # E[1 / pdf] is the solid angle of the support
        assert 0 <= solid_angle < 4 * np.pi * 1.01


def test_bounds_hold_every_sampled_point():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, num_lamps=40, num_triangles=10)
    lights, _, _ = build_lights(scene)
    bounds = bound_lights(lights)
    p, n = np.array([0.3, -0.2, -3.0]), np.array([0.0, 0.0, 1.0])
    for light in np.flatnonzero(~bounds.is_distant):
        for i in range(16):
            wi, distance, _ = sample_light_point(
                lights, light, _vec3(p), _vec3(n), False, uniform_pair(7, 0, i, 0)
            )
            q = p + distance * np.array(wi)
            slack = 1e-5 * (1 + np.abs(q))
            assert np.all(q >= bounds.box_min[light] - slack)
            assert np.all(q <= bounds.box_max[light] + slack)
            if max(light_radiance(lights, light, wi, distance)) > 0 and bounds.axis[light].any():
                cos = -np.dot(wi, bounds.axis[light])
                assert np.arccos(np.clip(cos, -1, 1)) <= bounds.theta_e[light] + 1e-3
