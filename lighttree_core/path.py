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
from .features import is_on
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
    p, p_behind, n_geo, n, side = load_surface(world, triangle, u, v, direction)
    material, wo = world.triangle_material[triangle], scale(direction, -ONE)
    albedo = load3(world.albedo[material], side)
    gloss = matt_gloss(world.features.gloss, wo)
    vertex = Vertex(p, p_behind, n_geo, n, wo, albedo, 0, False, False, gloss)
    return add_lobes(world.features.lobes, world, triangle, side, u, v, vertex, lobes)


@kernel
def add_lobes(feature, world, triangle, side, u, v, vertex, lobes):
    """The vertex on a surface with its lobes, if the side of the triangle has closures."""
    if feature is not None and world.num_closures[world.triangle_material[triangle], side] > 0:
        p, p_behind, n_geo, n, wo = vertex.p, vertex.p_behind, vertex.n_geo, vertex.n, vertex.wo
        num = setup_lobes(world, triangle, side, u, v, n_geo, n, wo, lobes)
        two_sided = is_on(world.features.transmission) and transmits(lobes, num)
        meets_lamps = is_on(world.features.met_lamps) and is_glossy(lobes, num)
        if is_on(world.features.textures):
            n, is_one = lights_normal(lobes, num, n)
            two_sided |= not is_one
        black, gloss = (ZERO, ZERO, ZERO), find_gloss(world.features.gloss, lobes, num, n, wo)
        return Vertex(p, p_behind, n_geo, n, wo, black, num, two_sided, meets_lamps, gloss)
    return vertex


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
def sample_surface(feature, vertex, lobes, u_lobe, u):
    """A direction to scatter to: (wi, BSDF x cosine / pdf, pdf, kind of the ray)."""
    if feature is not None and vertex.num_lobes > 0:
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
def scatter(world, settings, wave, hits, i, depth, vertex, lobes, next_wave, num_next):
    """Go on with path i into a scattered direction, or end it; rows of `next_wave` in use."""
    pixel, sample = wave.pixel[i], wave.sample[i]
    u = uniform_pair(settings.seed, pixel, sample, dim(depth, BSDF))
    u_lobe = np.float32(uniform(settings.seed, pixel, sample, dim(depth, LOBE)))
    wi, weight, pdf, ray_kind = sample_surface(world.features.lobes, vertex, lobes, u_lobe, u)
    throughput = mul(load3(wave.throughput, i), weight)
    if max_abs(throughput) == ZERO:
        return num_next
    share = load3(wave.matt_share, i)
    if is_on(world.features.light_passes) and wave.bounce[i] == 0 and ray_kind != STRAIGHT_RAY:
        share = ZERO, ZERO, ZERO
        if pdf > ZERO:
            share = matt_share(world.features.lobes, vertex, wi, scale(weight, pdf), lobes)
    if depth >= settings.roulette_depth:
        # By the root, as in Cycles; by the throughput itself noise x time is 4 to 8 % higher.
        survival = min(ONE, math.sqrt(max_abs(throughput)))
        if not uniform(settings.seed, pixel, sample, dim(depth, ROULETTE)) < survival:
            return num_next
        throughput = scale(throughput, ONE / survival)
    if ray_kind == STRAIGHT_RAY:
        features = world.features
        return pass_straight(features, wave, hits, i, vertex, throughput, next_wave, num_next)
    origin = vertex.p
    if is_on(world.features.transmission) and dot(wi, vertex.n_geo) < ZERO:
        origin = vertex.p_behind
    extend_path(wave, i, origin, wi, throughput, next_wave, num_next)
    ray_kind |= TWO_SIDED if vertex.two_sided else 0
    ray_kind |= MEETS_LAMPS if vertex.meets_lamps else 0
    next_wave.flags[num_next], next_wave.bounce[num_next] = ray_kind, wave.bounce[i] + 1
    next_wave.pdf[num_next], next_wave.travelled[num_next] = pdf, ZERO
    next_wave.passes[num_next] = wave.passes[i]
    store_receiver(next_wave, num_next, receiver_at(vertex))
    if is_on(world.features.light_passes):
        store3(next_wave.matt_share, num_next, share)
    return num_next + 1


@kernel
def pass_straight(features, wave, hits, i, vertex, throughput, next_wave, num_next):
    """Go on with path i straight through a surface, which is no vertex of it; rows in use."""
    direction = load3(wave.direction, i)
    extend_path(wave, i, vertex.p_behind, direction, throughput, next_wave, num_next)
    next_wave.flags[num_next], next_wave.bounce[num_next] = wave.flags[i], wave.bounce[i]
    next_wave.pdf[num_next], next_wave.passes[num_next] = wave.pdf[i], wave.passes[i] + 1
    next_wave.travelled[num_next] = wave.travelled[i] + hits.distance[i]
    store_receiver(next_wave, num_next, load_receiver(features.gloss, wave, i))
    if is_on(features.light_passes):
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
    # Plain zeros are of a type of their own: what gets these too would be compiled for both types.
    num_shadow, num_next, features = np.int64(0), np.int64(0), world.features
    for i in range(num_paths):
        emitted = emission_met(world, settings, wave, i, hits, scratch.picks)
        if hits.triangle[i] < 0:
            add_background(world, samples, wave, i, emitted)
            continue
        add_found(world, samples, wave, i, emitted)
        is_last = wave.bounce[i] > settings.max_bounces
        if is_last and not is_on(features.transparency):
            continue
        if is_on(features.transparency) and wave.passes[i] >= settings.max_passes:
            continue
        vertex = load_vertex(world, wave, hits, i, scratch.lobes)
        if depth == 0:
            add_albedo(world, samples, wave.slot[i], vertex, scratch.lobes)
        if is_last:
            num_next = leave(features, wave, hits, i, vertex, scratch.lobes, next_wave, num_next)
            continue
        if vertex.num_lobes == 0 and max_abs(vertex.albedo) == ZERO:
            continue
        num_shadow = propose_lights(
            world, settings, wave, i, depth, vertex, shadow, num_shadow, samples, scratch
        )
        num_next = scatter(
            world, settings, wave, hits, i, depth, vertex, scratch.lobes, next_wave, num_next
        )
    return num_shadow, num_next


@kernel
def add_background(world, samples, wave, i, radiance):
    """Add what path i saw beyond the scene to its sample; it is no emission to a light pass."""
    throughput = load3(wave.throughput, i)
    if wave.bounce[i] > 0:
        add_found(world, samples, wave, i, radiance)
        return
    add3(samples.radiance, wave.slot[i], mul(throughput, radiance))
    if is_on(world.features.film_alpha):
        samples.transparency[wave.slot[i], 0] += mean(throughput)


@kernel
def add_albedo(world, samples, slot, vertex, lobes):
    """Write the albedo of the first surface to a sample."""
    albedo = matt = vertex.albedo
    if is_on(world.features.lobes) and vertex.num_lobes > 0:
        albedo = lobes_albedo(lobes, vertex.num_lobes, False)
        matt = lobes_albedo(lobes, vertex.num_lobes, True)
    store3(samples.albedo, slot, albedo)
    if is_on(world.features.light_passes):
        store3(samples.diffuse_color, slot, matt)


@kernel
def leave(features, wave, hits, i, vertex, lobes, next_wave, num_next):
    """After its last bounce a path still goes straight through surfaces; rows in use."""
    through = transparency(lobes, vertex.num_lobes)
    if max_abs(through) == ZERO:
        return num_next
    throughput = mul(load3(wave.throughput, i), through)
    return pass_straight(features, wave, hits, i, vertex, throughput, next_wave, num_next)


@kernel
def add_first_hits(world, camera, wave, hits, num_pixels, num_paths, normal, depth):
    """Sum normals over first hits, and keep the depth of each pixel's first sample.

    normal: flat rows of sums. depth: flat; written where it is given, (0,) to leave it.
    """
    for i in range(num_paths):
        k = i % num_pixels
        triangle = hits.triangle[i]
        if triangle < 0:
            continue
        direction = load3(wave.direction, i)
        _, _, _, n, _ = load_surface(world, triangle, hits.u[i], hits.v[i], direction)
        add3(normal, k, n)
        if i < len(depth):
            m = camera.world_from_camera
            cos_axis = -dot(direction, (m[0, 2], m[1, 2], m[2, 2]))
            depth[k] = camera.clip_start + hits.distance[i] * cos_axis
