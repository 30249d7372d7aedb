"""Light that reaches a vertex straight: chosen by next-event estimation, or met by its ray.

Both are combined by multiple importance sampling (Veach 1997). Triangles and background are met by
every ray. Lamps are met only where a surface is glossy, and by the camera; elsewhere light sampling
has them to itself.
"""

from typing import NamedTuple

import numpy as np

from .bsdf import eval_bsdf, pdf_bsdf
from .environment import environment_radiance
from .jit import FAR, ONE, ZERO, called_kernel, flag, i64, kernel, table
from .light_points import light_radiance, pdf_light_point, sample_light_point, shares_hits
from .light_tree.importance import Gloss, Receiver
from .light_tree.sample import expected_picks, sample_lights
from .lights import NO_LIGHT
from .lobes import eval_lobes, eval_matt_lobes
from .sampling import LIGHT_PICK, LIGHT_POINT, dim, uniform, uniform_pair
from .scene import (
    ALL_RAYS,
    BACK,
    BACKGROUND,
    CAMERA_RAY,
    DIFFUSE_RAY,
    FRONT,
    NO_TEXTURE,
    TRIANGLE,
)
from .surface import hit_side
from .textures import texture_value
from .vec import dot, load3, madd, max_abs, mul, offset_point, scale, store3, sub
from .waves import RAY_KIND, add_light, has_light_passes, load_receiver


@table
class PathSettings(NamedTuple):
    """What kernels read of `render.Settings`."""

    seed: i64
    max_bounces: i64
    max_passes: i64
    split_lights: i64
    roulette_depth: i64
    balance_heuristic: flag


class Vertex(NamedTuple):
    """A point where light is scattered.

    p, p_behind: safe starts for rays on the side of wo, and on the other. n_geo, n: normals of the
    triangle and for shading, on the side of wo. albedo: of a Lambertian surface, where num_lobes is
    0. two_sided, gloss: see `Receiver`. meets_lamps: whether scattered rays do.
    """

    p: tuple
    p_behind: tuple
    n_geo: tuple
    n: tuple
    wo: tuple
    albedo: tuple
    num_lobes: int
    two_sided: bool
    meets_lamps: bool
    gloss: Gloss


@kernel
def receiver_at(vertex):
    """What lights are chosen by at a vertex."""
    return Receiver(vertex.p, vertex.n, vertex.two_sided, vertex.gloss)


@kernel
def mis_weight(pdf, other_pdf, balance_heuristic):
    """Weight of a sample of density pdf against another technique's density; each may be 0."""
    if balance_heuristic:
        return pdf / (pdf + other_pdf)
    ratio = other_pdf / pdf
    return ONE / (ONE + ratio * ratio)


@kernel
def num_light_samples(settings, bounce):
    """Lights chosen at a vertex: the same for what the camera sees and for the next vertex, where
    most noise is made; one after that. Figures are in light_tree.md.
    """
    return settings.split_lights if bounce < 2 else 1


@kernel
def shines_on(world, light, ray_kind, bounce):
    """Whether a light is there for a ray of some kind after so many bounces."""
    lights = world.sampler.lights
    return (lights.visible[light] & ray_kind) != 0 and bounce <= lights.max_bounces[light]


@called_kernel
def met_weight(world, settings, wave, i, light, distance, picks):
    """MIS weight of a light that the ray of path i met, against choosing it at the last vertex.

    distance: from where the ray starts. 0 for a light that is not there for this ray.
    """
    flags, bounce = wave.flags[i], wave.bounce[i]
    if light == NO_LIGHT:
        return ONE
    if not shines_on(world, light, flags & RAY_KIND, max(0, bounce - 1)):
        return ZERO
    if wave.pdf[i] == ZERO:
        return ONE
    if not shares_hits(world.sampler.lights, light):
        return ZERO
    receiver = load_receiver(wave, i)
    num = num_light_samples(settings, bounce - 1)
    expected = np.float32(expected_picks(world.sampler, light, receiver, num, picks))
    if expected == ZERO:
        return ONE
    distance += wave.travelled[i]
    p, n, two_sided, _ = receiver
    wi = load3(wave.direction, i)
    pdf = pdf_light_point(world.sampler.lights, light, p, n, two_sided, wi, distance)
    return mis_weight(wave.pdf[i], expected * pdf, settings.balance_heuristic)


@kernel
def emission_met(world, settings, wave, i, hits, picks):
    """Weighted emission of what path i met: a triangle or the background."""
    triangle, direction = hits.triangle[i], load3(wave.direction, i)
    light, emission, distance = world.background_light, (ZERO, ZERO, ZERO), FAR
    if triangle >= 0:
        material = world.geometry.material[triangle]
        side = hit_side(world.geometry, triangle, direction)
        emission = load3(world.emission[material], side)
        light, distance = world.triangle_light[triangle, side], hits.distance[i]
        texture = world.emission_texture[material, side]
        u, v = hits.u[i], hits.v[i]
        emission = textured(world, emission, texture, triangle, u, v, direction)
    elif world.film_transparent and wave.flags[i] & RAY_KIND == CAMERA_RAY:
        return ZERO, ZERO, ZERO
    elif len(world.camera_background) > 0 and wave.flags[i] & RAY_KIND == CAMERA_RAY:
        return load3(world.camera_background, 0)
    else:
        emission = environment_radiance(world.sampler.lights.environment, direction)
    if max_abs(emission) == ZERO:
        return emission
    return scale(emission, met_weight(world, settings, wave, i, light, distance, picks))


@kernel
def textured(world, radiance, texture, triangle, u, v, direction):
    """Radiance times the value of a texture at a point of a triangle, if there is one."""
    if texture != NO_TEXTURE:
        value = texture_value(world.geometry, world.textures, texture, triangle, u, v, direction)
        return mul(radiance, value)
    return radiance


@kernel
def scattered_share(vertex, rays, wi, lobes):
    """(BSDF x cosine for light from wi, density with which rays are scattered there).

    rays: bits of the kinds of ray that see the light.
    """
    if vertex.num_lobes > 0:
        return eval_lobes(lobes, vertex.num_lobes, vertex.n_geo, vertex.wo, wi, rays)
    if rays & DIFFUSE_RAY == 0:
        return (ZERO, ZERO, ZERO), pdf_bsdf(vertex.n, wi)
    return eval_bsdf(vertex.albedo, vertex.n, wi), pdf_bsdf(vertex.n, wi)


@kernel
def matt_share(vertex, wi, value, lobes):
    """The share of `scattered_share`'s value that matt lobes have, as a colour."""
    if vertex.num_lobes == 0:
        return ONE, ONE, ONE
    matt = eval_matt_lobes(lobes, vertex.num_lobes, vertex.wo, wi)
    return share_of(matt[0], value[0]), share_of(matt[1], value[1]), share_of(matt[2], value[2])


@kernel
def share_of(part, whole):
    """part / whole, 0 to 1; 0 of nothing."""
    return min(ONE, part / whole) if whole > ZERO else ZERO


@kernel
def is_also_met(world, vertex, light):
    """Whether rays scattered at a vertex meet a light too, with densities that add up."""
    lights, kind = world.sampler.lights, world.sampler.lights.kind[light]
    if kind in (TRIANGLE, BACKGROUND):
        return shares_hits(lights, light)
    return vertex.meets_lamps and shares_hits(lights, light)


@kernel
def textured_light(world, radiance, light, q, direction):
    """Radiance of an emitting triangle from its point q along a line, its texture included."""
    lights, triangle = world.sampler.lights, world.light_triangle[light]
    side = FRONT if world.triangle_light[triangle, FRONT] == light else BACK
    texture = world.emission_texture[world.geometry.material[triangle], side]
    a, b = load3(lights.axis_u, light), load3(lights.axis_v, light)
    to_q = sub(q, load3(lights.position, light))
    # Barycentric coordinates along the two edges; those of a back are in the other order.
    aa, ab, bb, aq, bq = dot(a, a), dot(a, b), dot(b, b), dot(a, to_q), dot(b, to_q)
    scale_all = ONE / (aa * bb - ab * ab)
    u, v = (bb * aq - ab * bq) * scale_all, (aa * bq - ab * aq) * scale_all
    if side == BACK:
        u, v = v, u
    return textured(world, radiance, texture, triangle, u, v, direction)


@kernel
def propose_light(world, settings, vertex, light, expected, u_point, lobes, tells_matt):
    """A sample of one picked light: (radiance x BSDF x cosine x weight / density, origin of the
    shadow ray, vector to the light, share of it that matt lobes scatter).

    The vector ends short of a light that is part of the geometry. Radiance 0: nothing to test. The
    share is 0 unless tells_matt.
    """
    dark, lights, p = (ZERO, ZERO, ZERO), world.sampler.lights, vertex.p
    wi, distance, pdf = sample_light_point(lights, light, p, vertex.n, vertex.two_sided, u_point)
    density = np.float32(expected) * pdf
    if not density > ZERO:
        return dark, p, dark, dark
    value, pdf_scatter = scattered_share(vertex, lights.visible[light], wi, lobes)
    if max_abs(value) == ZERO:
        return dark, p, dark, dark
    weight, kind = ONE / density, lights.kind[light]
    to_light = scale(wi, distance if distance < FAR else world.geometry.diameter)
    if is_also_met(world, vertex, light):
        weight *= mis_weight(density, pdf_scatter, settings.balance_heuristic)
    radiance = light_radiance(lights, light, wi, distance)
    target = madd(p, ONE, to_light)
    if kind == TRIANGLE:
        if len(world.textures.kind) > 0:
            radiance = textured_light(world, radiance, light, target, wi)
        reach = max(max_abs(p), max_abs(target), max_abs(load3(lights.position, light)))
        target = offset_point(target, load3(lights.axis_w, light), reach)
    origin = p if dot(vertex.n_geo, wi) > ZERO else vertex.p_behind
    share = matt_share(vertex, wi, value, lobes) if tells_matt else dark
    return scale(mul(radiance, value), weight), origin, sub(target, origin), share


@kernel
def propose_lights(world, settings, wave, i, depth, vertex, shadow, num_shadow, samples, scratch):
    """Shadow rays from a vertex to lights picked there; the number of rows of `shadow` in use.

    Light that nothing can block is added to `samples` at once.
    """
    pixel, sample, bounce = wave.pixel[i], wave.sample[i], wave.bounce[i]
    num, picks = num_light_samples(settings, bounce), scratch.picks
    u_pick = uniform(settings.seed, pixel, sample, dim(depth, LIGHT_PICK))
    sampler, tells_matt = world.sampler, has_light_passes(samples) and bounce == 0
    for k in range(sample_lights(sampler, receiver_at(vertex), num, u_pick, picks)):
        # Consecutive numbers, so points on the lights of one vertex are stratified too.
        u_point = uniform_pair(settings.seed, pixel, sample * num + k, dim(depth, LIGHT_POINT))
        light = picks.light[k]
        if not shines_on(world, light, ALL_RAYS, bounce):
            continue
        arriving, origin, to_light, share = propose_light(
            world, settings, vertex, light, picks.expected[k], u_point, scratch.lobes, tells_matt
        )
        if max_abs(arriving) == ZERO:
            continue
        arriving = mul(load3(wave.throughput, i), arriving)
        if bounce > 0:
            share = load3(wave.matt_share, i)
        if not sampler.lights.casts_shadow[light]:
            add_light(samples, wave.slot[i], arriving, bounce + 1, share)
            continue
        shadow.slot[num_shadow] = wave.slot[i]
        shadow.passes[num_shadow] = settings.max_passes - wave.passes[i]
        store3(shadow.origin, num_shadow, origin)
        store3(shadow.to_light, num_shadow, to_light)
        store3(shadow.radiance, num_shadow, arriving)
        shadow.bounce[num_shadow] = bounce + 1
        store3(shadow.matt_share, num_shadow, share)
        num_shadow += 1
    return num_shadow
