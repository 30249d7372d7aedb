"""Rays meet lamps: what they see is the lamps' irradiance, each lamp counts once on every ray."""

import numpy as np
import oracle
import pytest
from core_scenes import fewer, floor_scene, lamps_down, random_lamps
from tree_probe import vec3

from lighttree_core.jit import ZERO
from lighttree_core.lamp_shapes import (
    NUM_FACES,
    behind_shape,
    build_lamp_shapes,
    counts,
    intersect_lamp,
    is_inside_shape,
)
from lighttree_core.light_points import (
    is_hittable,
    is_in_sun,
    light_radiance,
    pdf_light_point,
    sample_light_point,
    shares_hits,
)
from lighttree_core.lights import build_lights
from lighttree_core.rays import Tracer
from lighttree_core.sampling import sample_cosine_hemisphere, uniform_pair
from lighttree_core.scene import (
    ALL_RAYS,
    CAMERA_RAY,
    DIFFUSE_RAY,
    DISK,
    ELLIPSE,
    GLOSSY_RAY,
    LAMP_KINDS,
    NO_CONE,
    POINT,
    RECTANGLE,
    SPHERE,
    SUN,
    Lamps,
)

NUM = fewer(1 << 14, 1 << 10)
LOCAL = {"sphere": SPHERE, "disk": DISK, "rectangle": RECTANGLE, "ellipse": ELLIPSE}
P, UP = vec3((0.3, -0.2, 0)), vec3((0, 0, 1))


def tables(lamps):
    """(lights, shapes) of some lamps."""
    lights, _, _ = build_lights(floor_scene(lamps))
    return lights, build_lamp_shapes(lights)


def near_lamps(rng, kind, num=4):
    """Lamps of a kind, large enough to be met often, each cut by the horizon or not."""
    lamps = random_lamps(rng, num, kinds=(kind,), extent=1.0)
    lamps.radius *= 3
    lamps.position[:, 2] = rng.uniform(0.2, 2, num)
    # No edge of a cone that a quadrature would have to resolve.
    is_spot = lamps.cos_cone != NO_CONE
    lamps.blend[is_spot] = 1
    turned = np.sign(np.sum(lamps.axis_w * (np.array(P) - lamps.position), axis=1))
    lamps.axis_w[:] *= np.where(turned == 0, 1, turned)[:, None]
    if kind == SUN:
        lamps.radius[:] = rng.uniform(0.2, 0.8, num)
        lamps.axis_w[:, 2] = -np.abs(lamps.axis_w[:, 2])
    return lamps


def pair(pixel, i):
    """Two stratified random numbers, as float32 as kernels have them."""
    return tuple(np.float32(x) for x in uniform_pair(7, pixel, i, 0))


def sample(lights, light, i, p=P):
    """Point i of a light as seen from p: (wi, distance, pdf)."""
    wi, distance, pdf = sample_light_point(lights, light, p, UP, False, pair(0, i))
    return vec3(wi), np.float32(distance), pdf


def meet(lights, light, wi):
    """(radiance, distance) of a light along a ray from P; radiance 0 if the ray misses it."""
    if lights.kind[light] == SUN:
        hit, distance = is_in_sun(lights, light, wi), np.float32(1e30)
    else:
        distance = np.float32(intersect_lamp(lights, light, P, wi))
        hit = distance > 0
    return np.array(light_radiance(lights, light, wi, distance)) if hit else np.zeros(3), distance


def by_rays(lights, light, with_mis):
    """(NUM, 3) irradiance by rays scattered with the density cos / pi, with MIS weights or not."""
    values = np.zeros((NUM, 3))
    for i in range(NUM):
        wi = vec3(sample_cosine_hemisphere(pair(1, i)))
        radiance, distance = meet(lights, light, wi)
        values[i] = np.pi * radiance
        if with_mis and radiance.any():
            pdf = wi[2] / np.pi
            other = pdf_light_point(lights, light, P, UP, False, wi, distance)
            values[i] *= pdf**2 / (pdf**2 + other**2)
    return values


def by_light_samples(lights, light):
    """(NUM, 3) irradiance by sampled points of the light, weighed against `by_rays`."""
    values = np.zeros((NUM, 3))
    for i in range(NUM):
        wi, distance, pdf = sample(lights, light, i)
        if pdf > 0 and wi[2] > 0:
            other = wi[2] / np.pi
            radiance = np.array(light_radiance(lights, light, wi, distance))
            values[i] = radiance * wi[2] / pdf * (pdf**2 / (pdf**2 + other**2))
    return values


def assert_mean(values, expected, most):
    """4 deviations of the mean, as if samples were random; 1 % for the oracle's own grid.

    most: of any sample; 4 of them where so few are hits that their deviation tells nothing.
    """
    tolerance = 4 * values.std(0) / np.sqrt(NUM) + 0.01 * np.abs(expected) + 4 * most / NUM
    np.testing.assert_array_less(np.abs(values.mean(0) - expected), tolerance)


@pytest.mark.parametrize("kind", [*LOCAL.values(), SUN], ids=[*LOCAL, "sun"])
def test_what_rays_meet_is_the_irradiance_of_a_lamp(kind):
    lamps = near_lamps(np.random.default_rng(7 + kind), kind)
    lights, _ = tables(lamps)
    for light in range(len(lights.kind)):
        expected = oracle.lamp_irradiance(lamps, light, P, UP)
        most = np.pi * lamps.radiance[light]
        assert_mean(by_rays(lights, light, with_mis=False), expected, most)
        both = by_rays(lights, light, with_mis=True) + by_light_samples(lights, light)
        assert_mean(both, expected, most)


def test_a_sphere_around_the_origin_of_a_ray_is_met_at_its_far_side():
    lamps = random_lamps(np.random.default_rng(7), 1, kinds=(SPHERE,))
    lamps.position[0], lamps.radius[0], lamps.cos_cone[0] = (0.3, -0.2, 0.5), 2.0, NO_CONE
    lights, shapes = tables(lamps)
    assert intersect_lamp(lights, 0, P, UP) == pytest.approx(2.5)
    assert intersect_lamp(lights, 0, P, vec3((0, 0, -1))) == pytest.approx(1.5)
    assert is_inside_shape(shapes, 0, P)
    np.testing.assert_allclose(
        by_rays(lights, 0, with_mis=False).mean(0), np.pi * lamps.radiance[0], rtol=1e-5
    )


@pytest.mark.parametrize("kind", LOCAL.values(), ids=LOCAL)
def test_sampled_points_are_met_at_their_distance(kind):
    lights, _ = tables(near_lamps(np.random.default_rng(7), kind))
    num = fewer(2000, 200)
    for light in range(len(lights.kind)):
        missed = 0
        for i in range(num):
            wi, distance, pdf = sample(lights, light, i)
            if pdf > 0:
                found = intersect_lamp(lights, light, P, wi)
                if found > 0:
                    # At its rim a sphere is met at a flat angle: errors are of the root of 2^-22.
                    assert found == pytest.approx(distance, rel=2e-3 if kind == SPHERE else 1e-4)
                missed += found < 0
        assert missed <= 2  # points on the very rim may round to the outside


def along_ray(lights, shapes, tracer, origin, direction):
    """Lamps that count on a ray, in the order in which their shapes are met."""
    found, start = [], origin
    while True:
        hits = tracer.closest(np.array([start], np.float32), np.array([direction], np.float32))
        triangle = hits.triangle[0]
        if triangle < 0:
            return found
        lamp = shapes.lamp[triangle // NUM_FACES]
        if counts(shapes, triangle, origin, direction):
            distance = intersect_lamp(lights, lamp, origin, direction)
            if distance > ZERO:
                found.append(lamp)
        start = vec3(behind_shape(shapes, triangle, hits.u[0], hits.v[0], direction))


@pytest.mark.parametrize("far", [0.0, 1000.0])
def test_every_lamp_counts_once_on_a_ray(far):
    rng = np.random.default_rng(7)
    lamps = random_lamps(rng, 30, kinds=tuple(LOCAL.values()), extent=2.0)
    lamps.radius *= 3
    # Some lamps at one place, of one size; a row of spheres whose octahedra share planes.
    for name in ("kind", "position", "axis_u", "axis_v", "axis_w", "radius"):
        getattr(lamps, name)[10:20] = getattr(lamps, name)[[0] * 5 + [1] * 5]
    lamps.kind[20:24], lamps.radius[20:24] = SPHERE, 0.5
    lamps.position[20:24] = np.array([1, -1, 0]) * np.arange(4)[:, None] * 0.1 + (0, 0, 2)
    lamps.position += np.float32(far)
    lights, shapes = tables(lamps)
    tracer = Tracer(shapes.vertices, shapes.triangles)
    num, num_met, num_missed = fewer(1000, 100), 0, 0
    for _ in range(num):
        origin, target = rng.uniform([-2, -2, 0], [2, 2, 4], (2, 3)) + far
        direction = np.float32(target - origin)
        direction /= np.linalg.norm(direction)
        origin, direction = vec3(origin), vec3(direction)
        found = along_ray(lights, shapes, tracer, origin, direction)
        every = [k for k in range(30) if intersect_lamp(lights, k, origin, direction) > 0]
        assert len(set(found)) == len(found) and set(found) <= set(every)
        num_met += len(found)
        num_missed += len(every) - len(found)
    assert num_met > num
    # A ray goes on 0.5 mm behind a shape that lies at 1000 m, and may pass another's surface.
    assert num_missed <= 0.005 * num * (far > 0)


def test_shapes_hold_their_lamps_and_end_within_the_slack():
    rng = np.random.default_rng(7)
    lights, shapes = tables(random_lamps(rng, 40, kinds=tuple(LOCAL.values())))
    p = vec3((0.1, 0.2, -3))
    for shape, light in enumerate(shapes.lamp):
        for i in range(8):
            wi, distance, _ = sample(lights, light, i, p)
            q = vec3(np.array(p) + distance * np.array(wi))
            assert is_inside_shape(shapes, shape, q)
    corners = shapes.vertices.reshape(-1, 6, 3)
    assert np.all(np.linalg.norm(corners[:, :3] - corners[:, 3:], axis=2) <= shapes.slack * 1.001)


def test_lamps_that_no_ray_sees_have_no_shape():
    lamps = lamps_down([DISK, SPHERE, RECTANGLE, POINT, SUN], np.arange(15).reshape(5, 3) + 1.0)
    lamps.visible[:3] = DIFFUSE_RAY, CAMERA_RAY, GLOSSY_RAY
    lights, shapes = tables(lamps)
    assert list(shapes.lamp) == [1, 2]
    assert list(build_lamp_shapes(lights, CAMERA_RAY).lamp) == [1]
    assert len(build_lamp_shapes(build_lights(floor_scene(Lamps.empty()))[0]).lamp) == 0


def test_which_lights_rays_meet_and_which_share_their_work():
    lamps = lamps_down(LAMP_KINDS, np.ones((len(LAMP_KINDS), 3)))
    scene = floor_scene(lamps)
    scene.background[:] = 1
    scene.materials.emission[0, 0] = 1
    lights, _, background = build_lights(scene)
    for light in range(len(lights.kind)):
        has_extent = lights.kind[light] not in (POINT, SUN)  # the sun here is a point
        assert is_hittable(lights, light) == shares_hits(lights, light) == has_extent
    lamps.radius[lamps.kind == SUN] = 0.1
    lamps.casts_shadow[lamps.kind == DISK] = False
    lamps.visible[lamps.kind == SPHERE] = ALL_RAYS & ~GLOSSY_RAY
    lamps.visible[lamps.kind == RECTANGLE] = ALL_RAYS
    lamps.max_bounces[:] = 2
    scene.environment.visible = ALL_RAYS & ~DIFFUSE_RAY
    lights, _, background = build_lights(scene)
    assert list(lights.suns) == [int(np.flatnonzero(lights.kind == SUN)[0])]
    assert is_hittable(lights, background) and not shares_hits(lights, background)
    shares = [shares_hits(lights, light) for light in range(len(LAMP_KINDS))]
    kinds = dict(zip(lights.kind.tolist(), shares, strict=False))
    assert kinds == {
        POINT: False, SPHERE: False, DISK: False, RECTANGLE: True, ELLIPSE: True, SUN: True
    }  # fmt: skip
    assert set(lights.max_bounces[: len(LAMP_KINDS)]) == {2}
    assert shares_hits(lights, len(LAMP_KINDS))  # a triangle
