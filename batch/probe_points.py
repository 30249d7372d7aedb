"""Points of a scene that paths reach, and what each of its lights gives them, for `probe.py`."""

import math

import numpy as np

from lighttree_core.bsdf import sample_bsdf
from lighttree_core.camera import build_camera_table
from lighttree_core.jit import FAR, ONE, TWO, ZERO, kernel
from lighttree_core.light_points import light_radiance, sample_light_point
from lighttree_core.path import extend_path, spawn_wave
from lighttree_core.ray_visibility import closest_seen
from lighttree_core.rays import Tracer
from lighttree_core.sampling import BSDF, LIGHT_POINT, dim, uniform_pair
from lighttree_core.scene import (
    BACKGROUND,
    CAMERA_RAY,
    DIFFUSE_RAY,
    DISK,
    POINT,
    SPHERE,
    SUN,
    TRIANGLE,
    Camera,
)
from lighttree_core.surface import load_surface
from lighttree_core.vec import (
    dot,
    load3,
    luminance,
    madd,
    max_abs,
    offset_point,
    scale,
    store3,
    sub,
)
from lighttree_core.waves import allocate_wave
from lighttree_core.world import World

# Rays tried for each point wanted; some meet nothing.
TRIES = 16
# Points on a light: so many times its squared size over squared distance, between these.
LIGHT_POINTS, FEWEST_LIGHT_POINTS, MOST_LIGHT_POINTS = 4096, 4, 256
NUM_SUN_POINTS = 16


def surface_points(
    camera: Camera, world: World, tracer: Tracer, num: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """(p, n) of up to num camera hits, and of as many hits after one diffuse bounce."""
    rng, (x0, y0, x1, y1) = np.random.default_rng(seed), camera.crop_px
    pixels = rng.integers((x0, y0), (x1, y1), (TRIES * num, 2))
    pixels = rng.permutation(np.unique(pixels, axis=0)).astype(np.int32)
    num_samples = -(-TRIES * num // len(pixels))
    num_paths = num_samples * len(pixels)
    wave, next_wave = allocate_wave(num_paths), allocate_wave(num_paths)
    max_distance, table = np.zeros(num_paths, np.float32), build_camera_table(camera)
    spawn_wave(wave, max_distance, table, CAMERA_RAY, seed, pixels, 0, num_samples)
    points, normals = [], []
    for depth in range(2):
        hits = closest_seen(tracer, world.geometry, wave, num_paths, max_distance)
        num_paths = bounce_wave(world, seed, wave, hits, num_paths, depth, next_wave)
        points.append(next_wave.origin[: min(num, num_paths)].copy())
        normals.append(next_wave.n[: min(num, num_paths)].copy())
        wave, next_wave, max_distance = next_wave, wave, None
    return np.concatenate(points), np.concatenate(normals)


@kernel
def bounce_wave(world, seed, wave, hits, num_paths, depth, next_wave):
    """Scatter all paths that met a surface that reflects, as if it were Lambertian; how many."""
    num_next = 0
    for i in range(num_paths):
        triangle, direction = hits.triangle[i], load3(wave.direction, i)
        if triangle < 0:
            continue
        p, _, _, n, side = load_surface(world.geometry, triangle, hits.u[i], hits.v[i], direction)
        albedo = load3(world.albedo[world.geometry.material[triangle]], side)
        if max_abs(albedo) > ZERO:
            u = uniform_pair(seed, wave.pixel[i], wave.sample[i], dim(depth, BSDF))
            wi, throughput, _ = sample_bsdf(albedo, n, u)
            extend_path(wave, i, p, wi, throughput, next_wave, num_next)
            store3(next_wave.n, num_next, n)
            next_wave.flags[num_next] = DIFFUSE_RAY
            num_next += 1
    return num_next


@kernel
def num_light_points(lights, i, p, n):
    """How many points on light i tell its irradiance at p; 0 where it cannot give any."""
    kind, radius = lights.kind[i], lights.radius[i]
    if kind == BACKGROUND:
        return MOST_LIGHT_POINTS
    if kind == SUN:
        return NUM_SUN_POINTS if radius > ZERO else 1
    to_light = sub(load3(lights.position, i), p)
    is_round = kind in (POINT, SPHERE, DISK)
    size_sq = TWO * TWO * radius * radius if is_round else lights.size_sq[i]
    is_behind = not is_round and dot(to_light, load3(lights.axis_w, i)) >= ZERO
    if is_behind or dot(to_light, n) + math.sqrt(size_sq) <= ZERO:
        return 0
    num, dist_sq = FEWEST_LIGHT_POINTS, dot(to_light, to_light)
    while num < MOST_LIGHT_POINTS and num * dist_sq < LIGHT_POINTS * size_sq:
        num *= 2
    return 1 if kind == POINT else num


@kernel
def count_light_points(lights, p, n, num_points):
    """`num_light_points` of all lights."""
    for i in range(len(num_points)):
        num_points[i] = num_light_points(lights, i, p, n)


@kernel
def shine(world, light, p, n, u):
    """(irradiance at p by a point of a light, over its density; vector to that point)."""
    lights = world.sampler.lights
    wi, distance, pdf = sample_light_point(lights, light, p, n, False, u)
    to_light = scale(wi, distance if distance < FAR else world.geometry.diameter)
    if not (dot(n, wi) > ZERO and pdf > ZERO):
        return ZERO, to_light
    if lights.kind[light] == TRIANGLE:
        # As in path.propose_light: the light's own surface must not block it.
        q = madd(p, ONE, to_light)
        reach = max(max_abs(p), max_abs(q), max_abs(load3(lights.position, light)))
        to_light = sub(offset_point(q, load3(lights.axis_w, light), reach), p)
    radiance = luminance(light_radiance(lights, light, wi, distance))
    return radiance * dot(n, wi) / pdf, to_light


@kernel
def shine_wave(world, seed, p, n, light, sample, irradiance, to_light):
    """Fill the last two with `shine` of given samples of lights at points p."""
    for i in range(len(light)):
        u = uniform_pair(seed, light[i], sample[i], LIGHT_POINT)
        irradiance[i], arrow = shine(world, light[i], load3(p, i), load3(n, i), u)
        store3(to_light, i, arrow)


def contributions(
    world: World, tracer: Tracer, p: np.ndarray, n: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """(num_lights,) luminance of the irradiance that each light gives a point: (f, fV)."""
    lights = world.sampler.lights
    num_points = np.zeros(len(lights.kind), np.int32)
    count_light_points(lights, tuple(p), tuple(n), num_points)
    light = np.repeat(np.arange(len(num_points), dtype=np.int32), num_points)
    sample = np.arange(len(light)) - np.repeat(np.cumsum(num_points) - num_points, num_points)
    irradiance, to_light = np.zeros(len(light), np.float32), np.zeros((len(light), 3), np.float32)
    origin, normal = np.tile(p, (len(light), 1)), np.tile(n, (len(light), 1))
    shine_wave(world, seed, origin, normal, light, sample, irradiance, to_light)
    shines = np.flatnonzero(irradiance)
    light, values = light[shines], irradiance[shines] / num_points[light[shines]]
    is_free = ~tracer.occluded(origin[shines], to_light[shines])
    f = np.bincount(light, values, len(num_points))
    return f, np.bincount(light, values * is_free, len(num_points))
