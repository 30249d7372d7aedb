"""Microfacet lobes: isotropic GGX that reflects, refracts, or both.

Walter et al. 2007, Microfacet Models for Refraction through Rough Surfaces; the height-correlated
Smith term of Heitz 2014, Understanding the Masking-Shadowing Function. A microfacet is chosen among
those visible from wo (Heitz 2018), then one of reflection and refraction by its Fresnel terms.
Cosines are to the lobe's normal, which must face wo: otherwise the lobe is black.

With c the cosine, Smith's 1 + lambda is (c + s) / 2c, where s = sqrt(c^2 + alpha^2 (1 - c^2)).
Below it is multiplied out, so that grazing angles divide nothing by zero.
"""

import math

import numpy as np

from .fresnel import BLACK, facet_reflectance
from .jit import INV_PI, ONE, TWO, TWO_PI, ZERO, kernel
from .vec import add, cross, dot, frame, from_frame, load3, madd, mean, normalize, scale

QUARTER = np.float32(0.25)
SMOOTH_ALPHA_SQ = np.float32(2e-10)  # up to here a lobe is a mirror or clear glass, as in Cycles
UNBENT_IOR = np.float32(1e-4)  # so close to 1, refraction goes straight on, as in Cycles


@kernel
def is_smooth(lobes, i):
    """Whether microfacet lobe i has but single directions."""
    return lobes.alpha[i] * lobes.alpha[i] <= SMOOTH_ALPHA_SQ


@kernel
def is_unbent(lobes, i):
    """Whether what microfacet lobe i lets through is not spread."""
    return is_smooth(lobes, i) or abs(lobes.ior[i] - ONE) < UNBENT_IOR


@kernel
def smith_root(cos_theta, alpha_sq):
    """s of the file's head."""
    return math.sqrt(cos_theta * cos_theta + alpha_sq * max(ZERO, ONE - cos_theta * cos_theta))


@kernel
def ggx_density(n, h, alpha_sq):
    """Microfacets of normal h, by their area, over that of the surface."""
    # The sine comes from a cross product: 1 - cos^2 has no digits left for small alpha.
    across = cross(n, h)
    sin_sq = min(dot(across, across), ONE)
    spread = sin_sq + alpha_sq * (ONE - sin_sq)
    return alpha_sq * INV_PI / (spread * spread)


@kernel
def sample_visible_normal(wo, alpha, u):
    """A microfacet's normal seen from wo, about +Z. Dupuy and Benyoub 2023, Sampling Visible GGX
    Normals with Spherical Caps.
    """
    w = normalize((alpha * wo[0], alpha * wo[1], wo[2]))
    # z = height - w_z is uniform in (-w_z, 1], and sin^2 = (1 - z) (1 + z).
    height = (ONE - u[0]) * (ONE + w[2])
    sin_theta = math.sqrt(max(ZERO, u[0] * (ONE + w[2]) * (height + ONE - w[2])))
    phi = TWO_PI * u[1]
    x, y = sin_theta * math.cos(phi) + w[0], sin_theta * math.sin(phi) + w[1]
    return normalize((alpha * x, alpha * y, height))


@kernel
def side_shares(reflectance, transmittance):
    """Probabilities of reflecting and of refracting at a microfacet; both 0 where it is black."""
    reflected, passed = mean(reflectance), mean(transmittance)
    if reflected + passed <= ZERO:
        return ZERO, ZERO
    total = ONE / (reflected + passed)
    return reflected * total, passed * total


@kernel
def half_vector(lobes, i, wo, wi, is_refracted):
    """Normal of the microfacets that send light from wi to wo: (unit, on n's side; its squared
    length before that).
    """
    h = add(wo, wi)
    if is_refracted:
        # wo + ior wi, so that an ior next to 1 loses no digits.
        h = madd(h, lobes.ior[i] - ONE, wi)
    len_sq = dot(h, h)
    h = normalize(h)
    return scale(h, -ONE) if dot(h, load3(lobes.normal, i)) < ZERO else h, len_sq


@kernel
def eval_microfacet(lobes, i, wo, wi):
    """(BSDF x |cos|, density over solid angle of sampling wi) of lobe i but for its weight."""
    n, alpha_sq, ior = load3(lobes.normal, i), lobes.alpha[i] * lobes.alpha[i], lobes.ior[i]
    cos_o, cos_i = dot(n, wo), abs(dot(n, wi))
    is_refracted = dot(n, wi) < ZERO
    sends_there = (
        lobes.transmits[i] and not is_unbent(lobes, i)
        if is_refracted
        else lobes.reflects[i] and not is_smooth(lobes, i)
    )
    if not (sends_there and cos_o > ZERO and cos_i > ZERO):
        return BLACK, ZERO
    h, len_sq = half_vector(lobes, i, wo, wi, is_refracted)
    cos_ho, cos_hi = dot(h, wo), dot(h, wi)
    # A microfacet is seen from its front, and refracts to its back. Cycles lets lamps shine through
    # rough glass beyond that, where its own paths never go: glass of alpha 0.25 and ior 1.5 passes
    # 2 to 15 % more there.
    if not (cos_ho > ZERO and (cos_hi < ZERO) == is_refracted):
        return BLACK, ZERO
    reflectance, transmittance, _ = facet_reflectance(lobes, i, cos_ho)
    share, share_refracted = side_shares(reflectance, transmittance)
    spread = QUARTER
    if is_refracted:
        reflectance, share = transmittance, share_refracted
        spread = ior * ior / len_sq * abs(cos_ho * cos_hi)
    root_o, root_i = smith_root(cos_o, alpha_sq), smith_root(cos_i, alpha_sq)
    common = TWO * spread * ggx_density(n, h, alpha_sq)
    value = common / (root_o + root_i * (cos_o / cos_i))
    return scale(reflectance, value), share * common / (cos_o + root_o)


@kernel
def sample_microfacet(lobes, i, n_geo, wo, u_side, u):
    """A direction lobe i scatters to: (wi, is_delta, Fresnel term, probability of reflecting or
    refracting as it does, is_refracted).

    Probability 0: none. As in Cycles, wi must lie on the right side of the surface too, beside
    that of the lobe's normal.
    """
    n, alpha = load3(lobes.normal, i), lobes.alpha[i]
    cos_o = dot(n, wo)
    if cos_o <= ZERO:
        return wo, False, BLACK, ZERO, False
    h = n
    if not is_smooth(lobes, i):
        fu, fv = frame(n)
        h = sample_visible_normal((dot(fu, wo), dot(fv, wo), cos_o), alpha, u)
        h = from_frame(fu, fv, n, h)
    cos_ho = dot(h, wo)
    reflectance, transmittance, cos_t = facet_reflectance(lobes, i, cos_ho)
    share, share_refracted = side_shares(reflectance, transmittance)
    is_refracted = u_side >= share and share_refracted > ZERO
    if is_refracted:
        inv_ior = ONE / lobes.ior[i]
        wi = madd(scale(wo, -inv_ior), cos_ho * inv_ior - cos_t, h)
        value, share, is_delta = transmittance, share_refracted, is_unbent(lobes, i)
    else:
        wi = madd(scale(wo, -ONE), TWO * cos_ho, h)
        value, is_delta = reflectance, is_smooth(lobes, i)
    if (dot(n, wi) < ZERO) != is_refracted or (dot(n_geo, wi) < ZERO) != is_refracted:
        share = ZERO
    return wi, is_delta, value, share, is_refracted
