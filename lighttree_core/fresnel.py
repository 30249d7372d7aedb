"""How much light a microfacet of a lobe reflects, and how much it lets through.

cos_o: cosine between the microfacet's normal and wo. cos_t: the same between the opposite normal
and the refracted ray. ior is relative: beyond the surface by on wo's side. All curves are those of
Cycles, so that materials look the same.
"""

import math

import numpy as np

from .jit import HALF, ONE, ZERO, kernel
from .vec import load3, madd, mul, sub

# What `Lobes.fresnel` says. NO_FRESNEL: all is reflected, or all but what total reflection keeps
# back is let through. DIELECTRIC: glass. SCHLICK: its curve remapped to f0..1, and tints.
# F82: a metal.
NO_FRESNEL, DIELECTRIC, SCHLICK, F82 = range(4)

WHITE, BLACK = (ONE, ONE, ONE), (ZERO, ZERO, ZERO)
COS_82 = np.float32(1 / 7)
F82_PEAK = np.float32(1 / 7 * (6 / 7) ** 6)  # cos (1 - cos)^6 there


@kernel
def clamp01(x):
    return min(max(x, ZERO), ONE)


@kernel
def mix_to_white(rgb, s):
    """rgb at s = 0, white at s = 1."""
    return madd(rgb, s, sub(WHITE, rgb))


@kernel
def f0_from_ior(ior):
    """Reflectance at normal incidence."""
    root = (ior - ONE) / (ior + ONE)
    return root * root


@kernel
def fresnel_dielectric(cos_o, ior):
    """(reflectance of unpolarized light, cos_t); (1, 0) where all is reflected."""
    # (ior^2 - 1) + cos^2, so that an ior next to 1 loses no digits.
    squared = (ior - ONE) * (ior + ONE) + cos_o * cos_o
    if squared <= ZERO:
        return ONE, ZERO
    ior_cos_t = math.sqrt(squared)
    cos_t = ior_cos_t / ior
    r_s = (cos_o - ior_cos_t) / (cos_o + ior_cos_t)
    r_p = (ior * cos_o - cos_t) / (ior * cos_o + cos_t)
    return HALF * (r_s * r_s + r_p * r_p), cos_t


@kernel
def schlick_share(reflectance, ior):
    """Where a dielectric's reflectance lies between that at normal incidence, 0, and 1."""
    f0 = f0_from_ior(ior)
    return clamp01((reflectance - f0) / (ONE - f0))


@kernel
def schlick_weight(cos_o):
    """(1 - cos)^5."""
    s = clamp01(ONE - cos_o)
    return s * s * (s * s) * s


@kernel
def f82_b_from_tint(f0, tint):
    """What `fresnel_f82` takes off, so that at 82 degrees the metal is that much darker."""
    full = mix_to_white(f0, schlick_weight(COS_82))
    return madd((ZERO, ZERO, ZERO), ONE / F82_PEAK, mul(full, sub(WHITE, tint)))


@kernel
def fresnel_f82(cos_o, f0, b):
    """Reflectance of a metal. Kutz et al. 2021, Novel Aspects of the Adobe Standard Material."""
    s_5 = schlick_weight(cos_o)
    dip = cos_o * s_5 * clamp01(ONE - cos_o)
    red, green, blue = madd(mix_to_white(f0, s_5), -dip, b)
    return clamp01(red), clamp01(green), clamp01(blue)


@kernel
def facet_reflectance(lobes, i, cos_o):
    """(reflectance, transmittance, cos_t) of a microfacet of lobe i; both are colours."""
    kind = lobes.fresnel[i]
    if kind == F82:
        return fresnel_f82(cos_o, load3(lobes.f0, i), load3(lobes.f82_b, i)), BLACK, ZERO
    reflected, cos_t = fresnel_dielectric(cos_o, lobes.ior[i])
    passed = ONE - reflected
    if kind == SCHLICK:
        f = mix_to_white(load3(lobes.f0, i), schlick_share(reflected, lobes.ior[i]))
        reflectance = mul(f, load3(lobes.reflection_tint, i))
        transmittance = mul(sub(WHITE, f), load3(lobes.transmission_tint, i))
    elif kind == DIELECTRIC:
        reflectance, transmittance = (reflected, reflected, reflected), (passed, passed, passed)
    else:
        reflectance, transmittance = WHITE, WHITE if cos_t > ZERO else BLACK
    return (
        reflectance if lobes.reflects[i] else BLACK,
        transmittance if lobes.transmits[i] else BLACK,
        cos_t,
    )
