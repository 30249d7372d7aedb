"""The Principled BSDF: layers, from the coat down, that share the light out among lobes.

As in Cycles 4.5 to 5.2 (Blender's Principled BSDF v2, after OpenPBR): a coat over a mixture of
metal, glass and plastic, which is a specular layer over a diffuse one. A layer takes from what lies
below it the largest component of its estimated albedo. Sheen, subsurface scattering, anisotropy,
thin film and thin walls are not modelled.
"""

import math

import numpy as np

from .albedo_tables import dielectric_blend, schlick_blend
from .closure_parts import (
    MIN_IOR,
    MIN_WEIGHT,
    View,
    add_diffuse,
    add_glass,
    can_add,
    dielectric_mean,
    load_color,
    reflecting_normal,
    reflection_scale,
    schlick_mean,
)
from .fresnel import clamp01, f0_from_ior, f82_b_from_tint, mix_to_white
from .jit import HALF, ONE, TWO, ZERO, kernel
from .lobes import (
    set_fresnel_dielectric,
    set_fresnel_f82,
    set_fresnel_schlick,
    set_microfacet,
    set_pick,
    set_transparent,
)
from .scene import (
    ALPHA,
    COAT_IOR,
    COAT_ROUGHNESS,
    COAT_TINT,
    COAT_WEIGHT,
    COLOR,
    DIFFUSE_ROUGHNESS,
    IOR,
    METALLIC,
    ROUGHNESS,
    SPECULAR_LEVEL,
    SPECULAR_TINT,
    TRANSMISSION,
)
from .vec import dot, madd, mul, scale

MAX_F0 = np.float32(0.99)
WHITE = (ONE, ONE, ONE)


@kernel
def add_principled(lobes, num, weight, tables, view, multiscatter):
    """All lobes of a Principled BSDF, its inputs in `lobes.inputs`; the number of lobes."""
    inputs = lobes.inputs
    alpha, metallic = clamp01(inputs[ALPHA]), clamp01(inputs[METALLIC])
    transmission, base = clamp01(inputs[TRANSMISSION]), load_color(inputs, COLOR)
    below, num = add_coat(lobes, num, scale(weight, alpha), tables, view)
    if metallic > MIN_WEIGHT:
        num = add_metal(lobes, num, scale(below, metallic), tables, view, multiscatter)
        below = scale(below, ONE - metallic)
    if transmission > MIN_WEIGHT:
        r, g, b = base
        passed = math.sqrt(min(r, ONE)), math.sqrt(min(g, ONE)), math.sqrt(min(b, ONE))
        tints = load_color(inputs, SPECULAR_TINT), WHITE, passed
        weight_passed = scale(below, transmission)
        num = add_glass(lobes, num, weight_passed, tables, view, multiscatter, tints)
        below = scale(below, ONE - transmission)
    below, num = add_specular(lobes, num, below, tables, view, multiscatter)
    roughness = clamp01(inputs[DIFFUSE_ROUGHNESS])
    num = add_diffuse(lobes, num, mul(below, base), view, roughness, base)
    clear = scale(weight, ONE - alpha)
    if can_add(clear, num):
        set_transparent(lobes, num, clear)
        num += 1
    return num


@kernel
def add_coat(lobes, num, weight, tables, view):
    """A clear layer with the surface's own normal: (weight of what lies below, number of lobes)."""
    inputs = lobes.inputs
    coat = max(inputs[COAT_WEIGHT], ZERO)
    if coat <= MIN_WEIGHT:
        return weight, num
    ior = max(inputs[COAT_IOR], ONE)
    normal = reflecting_normal(view.n_geo, view.wo, view.n_shade)
    view = View(view.wo, view.n_geo, view.n_shade, normal, normal, view.is_back)
    mu, below = dot(view.wo, normal), weight
    if ior > ONE and can_add(scale(weight, coat), num):
        roughness, fresnel_mean = clamp01(inputs[COAT_ROUGHNESS]), dielectric_mean(ior)
        scales, albedo = reflection_scale(
            tables, view, roughness, (fresnel_mean, fresnel_mean, fresnel_mean)
        )
        lobe_weight = scale(weight, coat * scales[0])
        set_microfacet(lobes, num, lobe_weight, normal, roughness * roughness, ior, True, False)
        set_fresnel_dielectric(lobes, num)
        f0 = f0_from_ior(ior)
        reflected = f0 + (ONE - f0) * dielectric_blend(tables, roughness, ior, mu)
        set_pick(lobes, num, (reflected, reflected, reflected))
        num += 1
        below = scale(weight, clamp01(ONE - coat * scales[0] * albedo * reflected))
    # Beer's law along the way of the refracted view through a layer of thickness 1.
    depth = ONE / math.sqrt(ONE - (ONE - mu * mu) / (ior * ior))
    tint = load_color(inputs, COAT_TINT)
    tint = tint[0] ** depth, tint[1] ** depth, tint[2] ** depth
    return mul(below, madd(scale(WHITE, ONE - coat), coat, tint)), num


@kernel
def add_metal(lobes, num, weight, tables, view, multiscatter):
    """A metal that reflects the base colour, tinted towards its edges; the number of lobes."""
    if not can_add(weight, num):
        return num
    inputs, mu = lobes.inputs, dot(view.wo, view.reflecting)
    roughness, tint = clamp01(inputs[ROUGHNESS]), load_color(inputs, SPECULAR_TINT)
    r, g, b = load_color(inputs, COLOR)
    f0 = min(r, ONE), min(g, ONE), min(b, ONE)
    f82_b = f82_b_from_tint(f0, (min(tint[0], ONE), min(tint[1], ONE), min(tint[2], ONE)))
    if multiscatter:
        # Integral of twice the cosine times the F82 curve.
        fresnel_mean = madd(mix_to_white(f0, np.float32(1 / 21)), np.float32(-1 / 126), f82_b)
        scales, _ = reflection_scale(tables, view, roughness, fresnel_mean)
        weight = mul(weight, scales)
    set_microfacet(lobes, num, weight, view.reflecting, roughness * roughness, ONE, True, False)
    set_fresnel_f82(lobes, num, f0, f82_b)
    set_pick(lobes, num, mix_to_white(f0, schlick_blend(tables, roughness, mu)))
    return num + 1


@kernel
def specular_ior(inputs):
    """(ior, reflectance at normal incidence) after the specular level, 0.5 of which leaves both."""
    ior, level = max(inputs[IOR], MIN_IOR), max(inputs[SPECULAR_LEVEL], ZERO)
    f0 = f0_from_ior(ior)
    if level == HALF:
        return ior, f0
    f0 *= TWO * level
    root = math.sqrt(min(f0, MAX_F0))
    adjusted = (ONE + root) / (ONE - root)
    return (ONE / adjusted if ior < ONE else adjusted), f0


@kernel
def add_specular(lobes, num, weight, tables, view, multiscatter):
    """The glossy layer of plastic: (weight of what lies below, number of lobes)."""
    inputs = lobes.inputs
    ior, f0 = specular_ior(inputs)
    if ior == ONE or not can_add(weight, num):
        return weight, num
    roughness, tint = clamp01(inputs[ROUGHNESS]), load_color(inputs, SPECULAR_TINT)
    f0 = clamp01(f0 * tint[0]), clamp01(f0 * tint[1]), clamp01(f0 * tint[2])
    scales, albedo = WHITE, ONE
    if multiscatter:
        scales, albedo = reflection_scale(tables, view, roughness, schlick_mean(f0, ior))
    normal, alpha = view.reflecting, roughness * roughness
    set_microfacet(lobes, num, mul(weight, scales), normal, alpha, ior, True, False)
    set_fresnel_schlick(lobes, num, f0, WHITE, (ZERO, ZERO, ZERO))
    blend = dielectric_blend(tables, roughness, ior, dot(view.wo, normal))
    reflected = mix_to_white(f0, blend)
    set_pick(lobes, num, reflected)
    r, g, b = mul(scales, reflected)
    return scale(weight, clamp01(ONE - max(r, g, b) * albedo)), num + 1
