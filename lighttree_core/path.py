"""Wave kernels of the path tracer: spawn camera rays, shade hits, add light that arrived.

A wave is a bundle of paths at the same depth. One round is: `rays.closest`, `shade_wave` (which
proposes shadow rays and the next wave), `rays.occluded`, `add_light_wave`. Paths that end are left
out of the next wave, so waves shrink. Next-event estimation and scattered rays are combined by
multiple importance sampling (Veach 1997).
"""

import math
from typing import NamedTuple

import numpy as np

from .bsdf import eval_bsdf, pdf_bsdf, sample_bsdf
from .jit import FAR, ONE, TWO, ZERO, kernel
from .light_points import light_radiance, pdf_light_point, sample_light_point
from .light_tree.sample import LightSampler, expected_picks, sample_lights
from .lights import NO_LIGHT
from .sampling import BSDF, LIGHT_PICK, LIGHT_POINT, PIXEL, ROULETTE, dim, uniform, uniform_pair
from .scene import BACK, FRONT, TRIANGLE
from .vec import (
    add3,
    cross,
    dot,
    load3,
    madd,
    max_abs,
    mul,
    normalize,
    offset_point,
    scale,
    store3,
    sub,
)


class CameraTable(NamedTuple):
    """`scene.Camera` for kernels."""

    world_from_camera: np.ndarray
    half_width: np.float32
    half_height: np.float32
    shift_x: np.float32
    shift_y: np.float32
    clip_start: np.float32
    clip_end: np.float32
    orthographic: bool
    width_px: int
    height_px: int


class World(NamedTuple):
    """All that kernels read: geometry, materials, lights.

    triangle_light: (T, 2) lights of front and back. background: (1, 3). diameter: of all geometry.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    triangle_material: np.ndarray
    triangle_light: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    background: np.ndarray
    background_light: int
    diameter: np.float32
    sampler: LightSampler


class PathSettings(NamedTuple):
    """What kernels read of `render.Settings`."""

    seed: int
    max_bounces: int
    split_lights: int
    roulette_depth: int
    balance_heuristic: bool


class Wave(NamedTuple):
    """Paths at one depth. slot: row of the path's radiance. n, pdf: normal at the last vertex and
    density of the direction taken there; pdf 0 for camera rays."""

    slot: np.ndarray
    pixel: np.ndarray
    sample: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    n: np.ndarray
    throughput: np.ndarray
    pdf: np.ndarray


class ShadowWave(NamedTuple):
    """Light that arrives unless something lies between origin and origin + to_light."""

    slot: np.ndarray
    origin: np.ndarray
    to_light: np.ndarray
    radiance: np.ndarray


def allocate_wave(size: int) -> Wave:
    """Room for `size` paths."""
    f3 = (size, 3)
    return Wave(
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
        *(np.zeros(f3, np.float32) for _ in range(4)),
        np.zeros(size, np.float32),
    )


def allocate_shadow_wave(size: int) -> ShadowWave:
    """Room for `size` shadow rays."""
    return ShadowWave(
        np.zeros(size, np.int32), *(np.zeros((size, 3), np.float32) for _ in range(3))
    )


@kernel
def camera_ray(camera, x, y):
    """(origin, unit direction, cosine to the viewing axis) through a point of the image, in px."""
    px = (TWO * x / np.float32(camera.width_px) - ONE) * camera.half_width + camera.shift_x
    py = (TWO * y / np.float32(camera.height_px) - ONE) * camera.half_height + camera.shift_y
    m = camera.world_from_camera
    right, up, back = (
        (m[0, 0], m[1, 0], m[2, 0]),
        (m[0, 1], m[1, 1], m[2, 1]),
        (m[0, 2], m[1, 2], m[2, 2]),
    )
    origin = m[0, 3], m[1, 3], m[2, 3]
    on_plane = madd(scale(right, px), py, up)
    if camera.orthographic:
        return madd(origin, ONE, on_plane), scale(back, -ONE), ONE
    direction = madd(on_plane, -ONE, back)
    cos_axis = ONE / math.sqrt(dot(direction, direction))
    return origin, scale(direction, cos_axis), cos_axis


@kernel
def spawn_wave(wave, max_distance, camera, settings, pixels, first_sample, num_samples):
    """Camera rays for samples of all given pixels; max_distance: (n,) up to the far clip plane.

    pixels: (k, 2) column and row in the full frame.
    """
    for s in range(num_samples):
        for k in range(len(pixels)):
            i = s * len(pixels) + k
            column, row = pixels[k]
            pixel, sample = row * camera.width_px + column, first_sample + s
            jitter = uniform_pair(settings.seed, pixel, sample, PIXEL)
            x, y = np.float32(column) + jitter[0], np.float32(row) + jitter[1]
            origin, direction, cos_axis = camera_ray(camera, x, y)
            store3(wave.origin, i, madd(origin, camera.clip_start / cos_axis, direction))
            store3(wave.direction, i, direction)
            store3(wave.throughput, i, (ONE, ONE, ONE))
            wave.slot[i], wave.pixel[i], wave.sample[i], wave.pdf[i] = i, pixel, sample, ZERO
            max_distance[i] = (camera.clip_end - camera.clip_start) / cos_axis


@kernel
def load_corners(world, triangle):
    """The three vertices of a triangle."""
    vertices, ids = world.vertices, world.triangles[triangle]
    return load3(vertices, ids[0]), load3(vertices, ids[1]), load3(vertices, ids[2])


@kernel
def hit_side(world, triangle, direction):
    """The side of a triangle that a ray meets, FRONT or BACK."""
    v0, v1, v2 = load_corners(world, triangle)
    return BACK if dot(cross(sub(v1, v0), sub(v2, v0)), direction) > ZERO else FRONT


@kernel
def load_surface(world, triangle, u, v, direction):
    """Where a ray met a triangle: (p, n, side), n facing the ray, p safe to start the next from."""
    v0, v1, v2 = load_corners(world, triangle)
    side = hit_side(world, triangle, direction)
    n = normalize(cross(sub(v1, v0), sub(v2, v0)))
    if side == BACK:
        n = scale(n, -ONE)
    # Barycentric coordinates place p on the triangle; along the ray it would miss by more.
    p = madd(madd(scale(v0, ONE - u - v), u, v1), v, v2)
    return offset_point(p, n, max(max_abs(v0), max_abs(v1), max_abs(v2))), n, side


@kernel
def mis_weight(pdf, other_pdf, balance_heuristic):
    """Weight of a sample of density pdf against another technique's density; each may be 0."""
    if balance_heuristic:
        return pdf / (pdf + other_pdf)
    ratio = other_pdf / pdf
    return ONE / (ONE + ratio * ratio)


@kernel
def num_light_samples(settings, depth):
    """Lights chosen at the vertex of this depth: the same for what the camera sees and for the next
    vertex, where most noise is made; one after that. Figures are in light_tree.md.
    """
    return settings.split_lights if depth < 2 else 1


@kernel
def scattered_weight(world, settings, wave, i, depth, light, distance, picks):
    """MIS weight of a light that the ray of path i hit, against choosing it at the last vertex."""
    if light == NO_LIGHT or wave.pdf[i] == ZERO:
        return ONE
    p, n, wi = load3(wave.origin, i), load3(wave.n, i), load3(wave.direction, i)
    num = num_light_samples(settings, depth - 1)
    expected = np.float32(expected_picks(world.sampler, light, p, n, num, picks))
    if expected == ZERO:
        return ONE
    pdf = pdf_light_point(world.sampler.lights, light, p, n, wi, distance)
    return mis_weight(wave.pdf[i], expected * pdf, settings.balance_heuristic)


@kernel
def propose_light(world, settings, p, n, albedo, light, expected, u_point):
    """A sample of one picked light: (radiance x BSDF x cosine x weight / density, vector to it).

    The vector ends short of a light that is part of the geometry. Radiance 0: nothing to test.
    """
    dark, nowhere = (ZERO, ZERO, ZERO), (ZERO, ZERO, ZERO)
    lights = world.sampler.lights
    wi, distance, pdf = sample_light_point(lights, light, p, n, u_point)
    cos_surface = dot(n, wi)
    density = np.float32(expected) * pdf
    if not (cos_surface > ZERO and density > ZERO):
        return dark, nowhere
    weight = ONE / density
    kind = lights.kind[light]
    to_light = scale(wi, distance if distance < FAR else world.diameter)
    if kind == TRIANGLE or light == world.background_light:
        weight *= mis_weight(density, pdf_bsdf(n, wi), settings.balance_heuristic)
    if kind == TRIANGLE:
        q = madd(p, ONE, to_light)
        reach = max(max_abs(p), max_abs(q), max_abs(load3(lights.position, light)))
        to_light = sub(offset_point(q, load3(lights.axis_w, light), reach), p)
    radiance = mul(light_radiance(lights, light, wi, distance), eval_bsdf(albedo, n, wi))
    return scale(radiance, weight), to_light


@kernel
def emission_seen(world, settings, wave, i, depth, hits, picks):
    """Weighted emission of what path i met: a triangle or the background."""
    triangle = hits.triangle[i]
    light, emission, distance = world.background_light, load3(world.background, 0), FAR
    if triangle >= 0:
        side = hit_side(world, triangle, load3(wave.direction, i))
        emission = load3(world.emission[world.triangle_material[triangle]], side)
        light, distance = world.triangle_light[triangle, side], hits.distance[i]
    if max_abs(emission) == ZERO:
        return emission
    weight = scattered_weight(world, settings, wave, i, depth, light, distance, picks)
    return scale(emission, weight)


@kernel
def propose_lights(world, settings, wave, i, depth, p, n, albedo, shadow, num_shadow, picks):
    """Shadow rays from p to lights picked there; the number of rows of `shadow` in use."""
    pixel, sample, num = wave.pixel[i], wave.sample[i], num_light_samples(settings, depth)
    u_pick = uniform(settings.seed, pixel, sample, dim(depth, LIGHT_PICK))
    for k in range(sample_lights(world.sampler, p, n, num, u_pick, picks)):
        # Consecutive numbers, so points on the lights of one vertex are stratified too.
        u_point = uniform_pair(settings.seed, pixel, sample * num + k, dim(depth, LIGHT_POINT))
        arriving, to_light = propose_light(
            world, settings, p, n, albedo, picks.light[k], picks.expected[k], u_point
        )
        if max_abs(arriving) > ZERO:
            shadow.slot[num_shadow] = wave.slot[i]
            store3(shadow.origin, num_shadow, p)
            store3(shadow.to_light, num_shadow, to_light)
            store3(shadow.radiance, num_shadow, mul(load3(wave.throughput, i), arriving))
            num_shadow += 1
    return num_shadow


@kernel
def scatter(settings, wave, i, depth, p, n, albedo, next_wave, num_next):
    """Go on with path i into a scattered direction, or end it; rows of `next_wave` in use."""
    pixel, sample = wave.pixel[i], wave.sample[i]
    u_bsdf = uniform_pair(settings.seed, pixel, sample, dim(depth, BSDF))
    wi, weight, pdf = sample_bsdf(albedo, n, u_bsdf)
    throughput = mul(load3(wave.throughput, i), weight)
    if depth >= settings.roulette_depth:
        survival = min(ONE, max_abs(throughput))
        if not uniform(settings.seed, pixel, sample, dim(depth, ROULETTE)) < survival:
            return num_next
        throughput = scale(throughput, ONE / survival)
    next_wave.slot[num_next], next_wave.pixel[num_next] = wave.slot[i], pixel
    next_wave.sample[num_next], next_wave.pdf[num_next] = sample, pdf
    store3(next_wave.origin, num_next, p)
    store3(next_wave.direction, num_next, wi)
    store3(next_wave.n, num_next, n)
    store3(next_wave.throughput, num_next, throughput)
    return num_next + 1


@kernel
def shade_wave(world, settings, wave, hits, num_paths, depth, radiance, next_wave, shadow, picks):
    """Add emission met, propose shadow rays and the next wave: (num_shadow, num_next)."""
    num_shadow, num_next = 0, 0
    for i in range(num_paths):
        emitted = emission_seen(world, settings, wave, i, depth, hits, picks)
        add3(radiance, wave.slot[i], mul(load3(wave.throughput, i), emitted))
        triangle = hits.triangle[i]
        if triangle < 0 or depth > settings.max_bounces:
            continue
        direction = load3(wave.direction, i)
        p, n, side = load_surface(world, triangle, hits.u[i], hits.v[i], direction)
        albedo = load3(world.albedo[world.triangle_material[triangle]], side)
        if max_abs(albedo) == ZERO:
            continue
        num_shadow = propose_lights(
            world, settings, wave, i, depth, p, n, albedo, shadow, num_shadow, picks
        )
        num_next = scatter(settings, wave, i, depth, p, n, albedo, next_wave, num_next)
    return num_shadow, num_next


@kernel
def add_light_wave(shadow, num_shadow, is_occluded, radiance):
    """Add the light of all shadow rays that met nothing."""
    for i in range(num_shadow):
        if not is_occluded[i]:
            add3(radiance, shadow.slot[i], load3(shadow.radiance, i))


@kernel
def add_first_hits(world, camera, wave, hits, num_pixels, num_paths, normal, albedo, depth):
    """Sum normal and albedo over first hits, and keep the depth of each pixel's first sample.

    normal, albedo: flat rows of sums. depth: flat; written where it is given, (0,) to leave it.
    """
    for i in range(num_paths):
        k = i % num_pixels
        triangle = hits.triangle[i]
        if triangle < 0:
            continue
        direction = load3(wave.direction, i)
        _, n, side = load_surface(world, triangle, hits.u[i], hits.v[i], direction)
        add3(normal, k, n)
        add3(albedo, k, load3(world.albedo[world.triangle_material[triangle]], side))
        if i < len(depth):
            m = camera.world_from_camera
            cos_axis = -dot(direction, (m[0, 2], m[1, 2], m[2, 2]))
            depth[k] = camera.clip_start + hits.distance[i] * cos_axis
