"""Wave kernels of the path tracer: spawn camera rays, shade hits, scatter paths.

One round is: `ray_visibility.closest_seen`, `shade_wave` (which proposes shadow rays and the next
wave), then `rays.occluded` and `shadows.add_unblocked`, or where some surface is transparent or
casts no shadow `rays.closest_before` and `shadows.pass_surfaces`. Paths that end are left out of
the next wave, so waves shrink. What a surface is, `surface.py` and `closures.py` say; what light
reaches it, `direct_light.py`.
"""

import math

import numpy as np

from .bsdf import sample_bsdf
from .camera import spawn_ray
from .closures import setup_lobes
from .direct_light import Vertex, emission_met, matt_share, propose_lights, receiver_at
from .jit import ONE, ZERO, kernel
from .light_tree.importance import matt_gloss
from .lobes import (
    STRAIGHT_RAY,
    TRANSPARENT_LOBE,
    find_gloss,
    is_glossy,
    lobes_albedo,
    sample_lobes,
    transmits,
    transparency,
)
from .sampling import BSDF, LOBE, ROULETTE, dim, uniform, uniform_pair
from .scene import DIFFUSE_RAY
from .surface import load_surface
from .vec import add3, dot, load3, max_abs, mean, mul, scale, store3
from .waves import (
    MEETS_LAMPS,
    TWO_SIDED,
    add_found,
    has_light_passes,
    load_receiver,
    store_receiver,
)

SAME_NORMAL = np.float32(0.9999)  # cosine


@kernel
def spawn_wave(wave, max_distance, camera, flags, seed, pixels, first_sample, num_samples):
    """Camera rays for samples of all given pixels; max_distance: (n,) up to the far clip plane.

    flags: as in Wave. pixels: (k, 2) column and row in the full frame.
    """
    for s in range(num_samples):
        for k in range(len(pixels)):
            i = s * len(pixels) + k
            pixel, sample = pixels[k, 1] * camera.width_px + pixels[k, 0], first_sample + s
            origin, direction, max_distance[i] = spawn_ray(camera, seed, pixel, sample)
            store3(wave.origin, i, origin)
            store3(wave.vertex, i, origin)
            store3(wave.direction, i, direction)
            store3(wave.throughput, i, (ONE, ONE, ONE))
            wave.slot[i], wave.pixel[i], wave.sample[i], wave.pdf[i] = i, pixel, sample, ZERO
            wave.flags[i], wave.bounce[i], wave.passes[i] = flags, 0, 0
            wave.travelled[i] = ZERO


@kernel
def load_vertex(world, wave, hits, i, lobes):
    """The vertex at which the ray of path i ends, its lobes written to `lobes`."""
    triangle, u, v = hits.triangle[i], hits.u[i], hits.v[i]
    direction = load3(wave.direction, i)
    p, p_behind, n_geo, n, side = load_surface(world.geometry, triangle, u, v, direction)
    material, wo = world.geometry.material[triangle], scale(direction, -ONE)
    albedo = load3(world.albedo[material], side)
    vertex = Vertex(p, p_behind, n_geo, n, wo, albedo, 0, False, False, matt_gloss(wo))
    if world.num_closures[material, side] > 0:
        return add_lobes(world, triangle, side, u, v, vertex, lobes)
    return vertex


@kernel
def add_lobes(world, triangle, side, u, v, vertex, lobes):
    """The vertex on a surface with the lobes of the closures that the side of the triangle has."""
    p, p_behind, n_geo, n, wo = vertex.p, vertex.p_behind, vertex.n_geo, vertex.n, vertex.wo
    num = setup_lobes(world, triangle, side, u, v, n_geo, n, wo, lobes)
    two_sided, meets_lamps = transmits(lobes, num), is_glossy(lobes, num)
    if len(world.textures.kind) > 0:
        n, is_one = lights_normal(lobes, num, n)
        two_sided |= not is_one
    black, gloss = (ZERO, ZERO, ZERO), find_gloss(lobes, num, n, wo)
    return Vertex(p, p_behind, n_geo, n, wo, black, num, two_sided, meets_lamps, gloss)


@kernel
def lights_normal(lobes, num, n):
    """(normal to choose lights by, whether it is that of all lobes); n where no lobe has any."""
    is_first, is_one = True, True
    for k in range(num):
        if lobes.kind[k] != TRANSPARENT_LOBE:
            own = load3(lobes.normal, k)
            n = own if is_first else n
            is_first, is_one = False, is_one and dot(own, n) > SAME_NORMAL
    return n, is_one


@kernel
def sample_surface(vertex, lobes, u_lobe, u):
    """A direction to scatter to: (wi, BSDF x cosine / pdf, pdf, kind of the ray)."""
    if vertex.num_lobes > 0:
        return sample_lobes(lobes, vertex.num_lobes, vertex.n_geo, vertex.wo, u_lobe, u)
    wi, weight, pdf = sample_bsdf(vertex.albedo, vertex.n, u)
    if dot(wi, vertex.n_geo) <= ZERO:  # a smooth normal leans over
        weight = (ZERO, ZERO, ZERO)
    return wi, weight, pdf, DIFFUSE_RAY


@kernel
def extend_path(wave, i, origin, direction, throughput, next_wave, k):
    """Row k of the next wave goes on with path i from another place."""
    next_wave.slot[k], next_wave.pixel[k] = wave.slot[i], wave.pixel[i]
    next_wave.sample[k] = wave.sample[i]
    store3(next_wave.origin, k, origin)
    store3(next_wave.direction, k, direction)
    store3(next_wave.throughput, k, throughput)


@kernel
def scatter(settings, wave, hits, i, depth, vertex, samples, lobes, next_wave, num_next):
    """Go on with path i into a scattered direction, or end it; rows of `next_wave` in use."""
    pixel, sample = wave.pixel[i], wave.sample[i]
    u = uniform_pair(settings.seed, pixel, sample, dim(depth, BSDF))
    u_lobe = np.float32(uniform(settings.seed, pixel, sample, dim(depth, LOBE)))
    wi, weight, pdf, ray_kind = sample_surface(vertex, lobes, u_lobe, u)
    throughput = mul(load3(wave.throughput, i), weight)
    if max_abs(throughput) == ZERO:
        return num_next
    share = load3(wave.matt_share, i)
    if has_light_passes(samples) and wave.bounce[i] == 0 and ray_kind != STRAIGHT_RAY:
        share = ZERO, ZERO, ZERO
        if pdf > ZERO:
            share = matt_share(vertex, wi, scale(weight, pdf), lobes)
    if depth >= settings.roulette_depth:
        # By the root, as in Cycles; by the throughput itself noise x time is 4 to 8 % higher.
        survival = min(ONE, math.sqrt(max_abs(throughput)))
        if not uniform(settings.seed, pixel, sample, dim(depth, ROULETTE)) < survival:
            return num_next
        throughput = scale(throughput, ONE / survival)
    if ray_kind == STRAIGHT_RAY:
        return pass_straight(wave, hits, i, vertex, throughput, next_wave, num_next)
    origin = vertex.p_behind if dot(wi, vertex.n_geo) < ZERO else vertex.p
    extend_path(wave, i, origin, wi, throughput, next_wave, num_next)
    ray_kind |= TWO_SIDED if vertex.two_sided else 0
    ray_kind |= MEETS_LAMPS if vertex.meets_lamps else 0
    next_wave.flags[num_next], next_wave.bounce[num_next] = ray_kind, wave.bounce[i] + 1
    next_wave.pdf[num_next], next_wave.travelled[num_next] = pdf, ZERO
    next_wave.passes[num_next] = wave.passes[i]
    store_receiver(next_wave, num_next, receiver_at(vertex))
    store3(next_wave.matt_share, num_next, share)
    return num_next + 1


@kernel
def pass_straight(wave, hits, i, vertex, throughput, next_wave, num_next):
    """Go on with path i straight through a surface, which is no vertex of it; rows in use."""
    direction = load3(wave.direction, i)
    extend_path(wave, i, vertex.p_behind, direction, throughput, next_wave, num_next)
    next_wave.flags[num_next], next_wave.bounce[num_next] = wave.flags[i], wave.bounce[i]
    next_wave.pdf[num_next], next_wave.passes[num_next] = wave.pdf[i], wave.passes[i] + 1
    next_wave.travelled[num_next] = wave.travelled[i] + hits.distance[i]
    store_receiver(next_wave, num_next, load_receiver(wave, i))
    store3(next_wave.matt_share, num_next, load3(wave.matt_share, i))
    return num_next + 1


@kernel
def shade_wave(
    world,
    settings,
    wave,
    hits,
    num_paths,
    depth,
    samples,
    next_wave,
    shadow,
    scratch,
):
    """Add emission met, propose shadow rays and the next wave: (num_shadow, num_next)."""
    num_shadow, num_next = 0, 0
    for i in range(num_paths):
        emitted = emission_met(world, settings, wave, i, hits, scratch.picks)
        if hits.triangle[i] < 0:
            add_background(samples, wave, i, emitted, world.film_transparent)
            continue
        add_found(samples, wave, i, emitted)
        is_last = wave.bounce[i] > settings.max_bounces
        if is_last and not world.is_see_through:
            continue
        if world.is_see_through and wave.passes[i] >= settings.max_passes:
            continue
        vertex = load_vertex(world, wave, hits, i, scratch.lobes)
        if depth == 0:
            add_albedo(samples, wave.slot[i], vertex, scratch.lobes)
        if is_last:
            num_next = leave(wave, hits, i, vertex, scratch.lobes, next_wave, num_next)
            continue
        if vertex.num_lobes == 0 and max_abs(vertex.albedo) == ZERO:
            continue
        num_shadow = propose_lights(
            world, settings, wave, i, depth, vertex, shadow, num_shadow, samples, scratch
        )
        num_next = scatter(
            settings, wave, hits, i, depth, vertex, samples, scratch.lobes, next_wave, num_next
        )
    return num_shadow, num_next


@kernel
def add_background(samples, wave, i, radiance, film_transparent):
    """Add what path i saw beyond the scene to its sample; it is no emission to a light pass."""
    throughput = load3(wave.throughput, i)
    if wave.bounce[i] > 0:
        add_found(samples, wave, i, radiance)
        return
    add3(samples.radiance, wave.slot[i], mul(throughput, radiance))
    if film_transparent:
        samples.transparency[wave.slot[i], 0] += mean(throughput)


@kernel
def add_albedo(samples, slot, vertex, lobes):
    """Write the albedo of the first surface to a sample."""
    albedo = matt = vertex.albedo
    if vertex.num_lobes > 0:
        albedo = lobes_albedo(lobes, vertex.num_lobes, False)
        matt = lobes_albedo(lobes, vertex.num_lobes, True)
    store3(samples.albedo, slot, albedo)
    if has_light_passes(samples):
        store3(samples.diffuse_color, slot, matt)


@kernel
def leave(wave, hits, i, vertex, lobes, next_wave, num_next):
    """After its last bounce a path still goes straight through surfaces; rows in use."""
    through = transparency(lobes, vertex.num_lobes)
    if max_abs(through) == ZERO:
        return num_next
    throughput = mul(load3(wave.throughput, i), through)
    return pass_straight(wave, hits, i, vertex, throughput, next_wave, num_next)


@kernel
def add_first_hits(geometry, camera, wave, hits, num_pixels, num_paths, normal, depth):
    """Sum normals over first hits, and keep the depth of each pixel's first sample.

    normal: flat rows of sums. depth: flat; written where it is given, (0,) to leave it.
    """
    for i in range(num_paths):
        k = i % num_pixels
        triangle = hits.triangle[i]
        if triangle < 0:
            continue
        direction = load3(wave.direction, i)
        _, _, _, n, _ = load_surface(geometry, triangle, hits.u[i], hits.v[i], direction)
        add3(normal, k, n)
        if i < len(depth):
            m = camera.world_from_camera
            cos_axis = -dot(direction, (m[0, 2], m[1, 2], m[2, 2]))
            depth[k] = camera.clip_start + hits.distance[i] * cos_axis
