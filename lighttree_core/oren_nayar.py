"""Rough matt surfaces: Fujii's improved Oren-Nayar model, f = a + b t, and what it loses to light
that is scattered several times made up for as in OpenPBR 1.1. Values are those of Cycles.

Of light at an angle the model keeps pi a + b G, so it loses b (G(90 degrees) - G): written so,
small roughnesses lose no digits.
"""

import math

import numpy as np

from .fresnel import clamp01
from .jit import INV_PI, ONE, PI, ZERO, kernel
from .vec import add, dot, scale

MATT_ROUGHNESS = np.float32(1e-5)  # below, a surface is Lambertian, as in Cycles
G_GRAZING = np.float32(np.pi / 2 - 2 / 3)
AVERAGE_LOSS = np.float32(np.pi / 2 - 2 / 3 - (2 * np.pi - 5.6) / 3)  # of b = 1, over all angles
TWO_THIRDS = np.float32(2 / 3)


@kernel
def oren_nayar_terms(roughness):
    """(a, b); b = 0 is Lambert."""
    roughness = clamp01(roughness)
    a = ONE / (PI + roughness * G_GRAZING)
    return a, roughness * a if roughness >= MATT_ROUGHNESS else ZERO


@kernel
def oren_nayar_loss(b, cos_theta):
    """Share of the light at an angle that single scattering loses."""
    c = clamp01(cos_theta)
    s = math.sqrt(ONE - c * c)
    # The last term is 2/3 s (1 - s^3) / c, multiplied out to divide by no small cosine.
    g = s * (math.acos(c) - TWO_THIRDS - s * c)
    g += TWO_THIRDS * s * c * (ONE + s + s * s) / (ONE + s)
    return max(ZERO, b * (G_GRAZING - g))


@kernel
def oren_nayar_multiscatter(b, cos_o, color):
    """What comes on top for each share of light lost on the way in; color: albedo of the grains."""
    if b == ZERO:
        return ZERO, ZERO, ZERO
    lost = b * AVERAGE_LOSS
    kept = INV_PI * (ONE - lost) / lost * oren_nayar_loss(b, cos_o)
    red, green, blue = clamp01(color[0]), clamp01(color[1]), clamp01(color[2])
    return (
        kept * red * red / (ONE - red * lost),
        kept * green * green / (ONE - green * lost),
        kept * blue * blue / (ONE - blue * lost),
    )


@kernel
def eval_oren_nayar(a, b, multiscatter, n, wo, wi):
    """BSDF x cosine, white, for wi in front of n."""
    cos_i = dot(n, wi)
    if b == ZERO:
        value = cos_i * INV_PI
        return value, value, value
    cos_o = max(ZERO, dot(n, wo))
    t = dot(wi, wo) - cos_i * cos_o
    if t > ZERO:
        t /= max(cos_i, cos_o)
    single = max(ZERO, a + b * t)  # t is -1 less a rounding at worst
    multiple = scale(multiscatter, oren_nayar_loss(b, cos_i))
    return scale(add((single, single, single), multiple), cos_i)
