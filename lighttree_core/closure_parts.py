"""What several closures have in common: normals, light between microfacets, and glass.

Cycles 4.5 to 5.2 and its formulas, so materials look the same. Light that single scattering loses
between microfacets is made up for by scaling it (Turquin 2019, Practical Multiple Scattering
Compensation for Microfacet Models), darkened by the Fresnel factors on its way (Kulla & Conty 2017,
Revisiting Physically Based Shading at Imageworks).
"""

import math
from typing import NamedTuple

import numpy as np

from .albedo_tables import dielectric_blend, glass_albedo, reflected_albedo
from .fresnel import clamp01, f0_from_ior, mix_to_white
from .jit import ONE, TWO, ZERO, kernel
from .lobes import MAX_LOBES, set_diffuse, set_fresnel_schlick, set_microfacet, set_pick
from .scene import IOR, ROUGHNESS
from .vec import add, dot, madd, max_abs, mean, mul, normalize, scale, sub

MIN_WEIGHT = np.float32(1e-5)  # what weighs less is left out, as in Cycles
MIN_IOR = np.float32(1e-5)
MIN_ELEVATION = np.float32(0.01)
QUARTER = np.float32(0.25)


class View(NamedTuple):
    """What a closure is seen by: vec3, all unit, but for is_back: whether wo is on the back.

    normal: of the closure, bent where it has a normal or bump map. reflecting: the same, tilted so
    that its mirror image of wo lies above the surface.
    """

    wo: tuple
    n_geo: tuple
    n_shade: tuple
    normal: tuple
    reflecting: tuple
    is_back: bool


@kernel
def load_color(inputs, column):
    """The colour in three columns of the inputs, not below 0."""
    return (
        max(inputs[column], ZERO),
        max(inputs[column + 1], ZERO),
        max(inputs[column + 2], ZERO),
    )


@kernel
def can_add(weight, num):
    """Whether a lobe of this weight counts, and there is room for it."""
    return mean(weight) >= MIN_WEIGHT and num < MAX_LOBES


@kernel
def reflecting_normal(n_geo, wo, n):
    """n, or n tilted towards n_geo so far that a mirror sends wo above the surface.

    In the plane of n_geo (z) and n (x), a mirror whose normal has the height z sends wo to the
    height t where 2 (sqrt(1 - z^2) wo_x + z wo_z) z = t + wo_z; squared, that is quadratic in z^2.
    """
    wo_z = max(dot(wo, n_geo), ZERO)
    t = min(np.float32(0.9) * wo_z, MIN_ELEVATION)
    mirrored = madd(scale(wo, -ONE), TWO * dot(n, wo), n)
    if dot(mirrored, n_geo) >= t:
        return n
    axis = normalize(madd(n, -dot(n, n_geo), n_geo))
    if max_abs(axis) == ZERO:
        return n_geo
    wo_x = dot(wo, axis)
    a = wo_x * wo_x + wo_z * wo_z
    if a == ZERO:
        return n
    b = TWO * (a + wo_z * t)
    c = (t + wo_z) * (t + wo_z)
    root = math.sqrt(max(ZERO, b * b - np.float32(4) * a * c))
    # One root has the sign of wo_x, the other solves the equation mirrored at z.
    z_sq = min(QUARTER * (b + root if wo_x < ZERO else b - root) / a, ONE)
    return madd(scale(axis, math.sqrt(ONE - z_sq)), math.sqrt(max(z_sq, ZERO)), n_geo)


@kernel
def multiscatter_scale(albedo, albedo_mean, fresnel_mean):
    """What a colour of single scattering is multiplied by for all orders of scattering together.

    albedo: of single scattering without Fresnel, seen from wo; albedo_mean: over all views;
    fresnel_mean: colour that a bounce between microfacets keeps of light from everywhere.
    """
    r, g, b = fresnel_mean
    lost, lost_mean = (ONE - albedo) / albedo * albedo_mean, ONE - albedo_mean
    return (
        ONE + lost * r / (ONE - lost_mean * r),
        ONE + lost * g / (ONE - lost_mean * g),
        ONE + lost * b / (ONE - lost_mean * b),
    )


@kernel
def dielectric_mean(ior):
    """What a dielectric reflects of light from everywhere; Kulla & Conty 2017, a fit."""
    if ior < ONE:
        fit = np.float32(0.965241) + ior * np.float32(0.130607)
        return np.float32(0.997118) + ior * (np.float32(0.1014) - ior * fit)
    return (ior - ONE) / (np.float32(4.08567) + np.float32(1.00071) * ior)


@kernel
def schlick_mean(f0, ior):
    """The same of the curve of an ior remapped to f0..1."""
    f0_of_ior = f0_from_ior(ior)
    return mix_to_white(f0, clamp01((dielectric_mean(ior) - f0_of_ior) / (ONE - f0_of_ior)))


@kernel
def add_diffuse(lobes, num, weight, view, roughness, color):
    """A matt lobe; the number of lobes."""
    if not can_add(weight, num):
        return num
    set_diffuse(lobes, num, weight, view.normal, roughness, color, view.wo)
    return num + 1


@kernel
def reflection_scale(tables, view, roughness, fresnel_mean):
    """(`multiscatter_scale` of a reflecting surface, its albedo of single scattering)."""
    albedo, albedo_mean = reflected_albedo(tables, roughness, dot(view.wo, view.reflecting))
    return multiscatter_scale(albedo, albedo_mean, fresnel_mean), albedo


@kernel
def add_glass(lobes, num, weight, tables, view, multiscatter, tints):
    """A lobe that reflects and refracts, its roughness and ior among the inputs.

    tints: colours of f0, of all that is reflected, and of what is let through.
    """
    if not can_add(weight, num):
        return num
    roughness, ior = clamp01(lobes.inputs[ROUGHNESS]), max(lobes.inputs[IOR], MIN_IOR)
    f0, mu = scale(tints[0], f0_from_ior(ior)), dot(view.wo, view.reflecting)
    f0 = (clamp01(f0[0]), clamp01(f0[1]), clamp01(f0[2]))
    if view.is_back:
        ior = ONE / ior
    if multiscatter:
        # Most of the colour is that of transmission.
        fresnel_mean = tints[2]
        if max_abs(fresnel_mean) == ZERO:
            fresnel_mean = mul(tints[1], schlick_mean(f0, ior))
        albedo, albedo_mean = glass_albedo(tables, roughness, ior, mu)
        weight = mul(weight, multiscatter_scale(albedo, albedo_mean, fresnel_mean))
    set_microfacet(lobes, num, weight, view.reflecting, roughness * roughness, ior, True, True)
    set_fresnel_schlick(lobes, num, f0, tints[1], tints[2])
    reflected = mix_to_white(f0, dielectric_blend(tables, roughness, ior, mu))
    passed = mul(sub((ONE, ONE, ONE), reflected), tints[2])
    set_pick(lobes, num, add(mul(reflected, tints[1]), passed))
    return num + 1
