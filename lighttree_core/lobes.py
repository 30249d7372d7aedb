"""What the closures of one hit come to: lobes, whose sum is the surface's BSDF there.

`closures.setup_lobes` fills them, row by row, with the `set_` functions below. Directions are unit
and leave the surface; wo is where the path came from. Values are those of Cycles, and so are the
rules of sides: evaluation looks at the side of a lobe's normal alone, so that smooth normals leave
no dark seams where geometry turns away (a light behind the geometry is hidden by it), while a
sampled direction on the wrong side of the geometry ends the path.
"""

from typing import NamedTuple

import numpy as np

from .fresnel import BLACK, DIELECTRIC, F82, NO_FRESNEL, SCHLICK, WHITE, clamp01
from .jit import ONE, TWO, ZERO, called_kernel, f32, flag, i32, kernel, table
from .light_tree.importance import GLOSS_SHARE, Gloss, matt_gloss
from .microfacet import eval_microfacet, is_smooth, is_unbent, sample_microfacet, smith_root
from .oren_nayar import eval_oren_nayar, oren_nayar_multiscatter, oren_nayar_terms
from .sampling import pdf_cosine_hemisphere, sample_cosine_hemisphere
from .scene import ALL_RAYS, DIFFUSE_RAY, GLOSSY_RAY, NUM_VALUES, TRANSMISSION_RAY
from .vec import add, dot, frame, from_frame, load3, mean, mul, scale, store3

MAX_LOBES = 16
MIN_MATT = np.float32(1e-3)  # of a mirror, so that no light it reflects in its tails is forgotten
DIFFUSE_LOBE, TRANSLUCENT_LOBE, TRANSPARENT_LOBE, MICROFACET_LOBE = range(4)
STRAIGHT_RAY = 0  # the kind of a ray that goes straight on, beside scene.DIFFUSE_RAY and the like


@table
class Lobes(NamedTuple):
    """Scratch of one thread for one shading point; n = MAX_LOBES rows, as many as told in use.

    kind: (n,) int32. weight: (n, 3) multiplies the lobe's value. pick: (n,) how likely the lobe is
    sampled, in proportion. normal: (n, 3). n_shade: (1, 3) the surface's smooth normal, which those
    of lobes may differ from where they are mapped.
    DIFFUSE_LOBE: oren_nayar: (n, 2), a and b of Fujii's model, b = 0 is Lambert; multiscatter:
    (n, 3). MICROFACET_LOBE: alpha, ior (relative, as seen from wo): (n,); fresnel: (n,) int32;
    reflects, transmits: (n,) bool; f0, f82_b, reflection_tint, transmission_tint: (n, 3).
    inputs: (NUM_VALUES,) those of the closure that is being set up.
    """

    kind: i32[::1]
    weight: f32[:, ::1]
    pick: f32[::1]
    normal: f32[:, ::1]
    n_shade: f32[:, ::1]
    oren_nayar: f32[:, ::1]
    multiscatter: f32[:, ::1]
    alpha: f32[::1]
    ior: f32[::1]
    fresnel: i32[::1]
    reflects: flag[::1]
    transmits: flag[::1]
    f0: f32[:, ::1]
    f82_b: f32[:, ::1]
    reflection_tint: f32[:, ::1]
    transmission_tint: f32[:, ::1]
    inputs: f32[::1]


def allocate_lobes() -> Lobes:
    """Room for the lobes of one shading point."""

    def floats(*shape):
        return np.zeros((MAX_LOBES, *shape), np.float32)

    return Lobes(
        kind=np.zeros(MAX_LOBES, np.int32),
        weight=floats(3),
        pick=floats(),
        normal=floats(3),
        n_shade=np.zeros((1, 3), np.float32),
        oren_nayar=floats(2),
        multiscatter=floats(3),
        alpha=floats(),
        ior=floats(),
        fresnel=np.zeros(MAX_LOBES, np.int32),
        reflects=np.zeros(MAX_LOBES, bool),
        transmits=np.zeros(MAX_LOBES, bool),
        f0=floats(3),
        f82_b=floats(3),
        reflection_tint=floats(3),
        transmission_tint=floats(3),
        inputs=np.zeros(NUM_VALUES, np.float32),
    )


@kernel
def set_shading_normal(lobes, n_shade):
    """Once for each hit: the smooth normal, before any normal map, on wo's side."""
    store3(lobes.n_shade, 0, n_shade)


@kernel
def set_lobe(lobes, i, kind, weight, normal):
    """What all kinds have; the lobe is picked in proportion to its mean weight."""
    lobes.kind[i] = kind
    store3(lobes.weight, i, weight)
    store3(lobes.normal, i, normal)
    set_pick(lobes, i, WHITE)


@kernel
def set_pick(lobes, i, albedo):
    """Pick lobe i in proportion to its weight x albedo, an estimate of what it scatters."""
    lobes.pick[i] = max(ZERO, mean(mul(load3(lobes.weight, i), albedo)))


@kernel
def set_diffuse(lobes, i, weight, normal, roughness, color, wo):
    """A matt lobe; color: albedo of its grains, between which rough ones scatter light again."""
    set_lobe(lobes, i, DIFFUSE_LOBE, weight, normal)
    a, b = oren_nayar_terms(roughness)
    lobes.oren_nayar[i, 0], lobes.oren_nayar[i, 1] = a, b
    store3(lobes.multiscatter, i, oren_nayar_multiscatter(b, dot(normal, wo), color))


@kernel
def set_translucent(lobes, i, weight, normal):
    """Lambert to the other side of normal."""
    set_lobe(lobes, i, TRANSLUCENT_LOBE, weight, normal)


@kernel
def set_transparent(lobes, i, weight):
    """Straight on."""
    set_lobe(lobes, i, TRANSPARENT_LOBE, weight, BLACK)


@kernel
def set_microfacet(lobes, i, weight, normal, alpha, ior, reflects, transmits):
    """GGX of some alpha = roughness^2, without Fresnel until one of the next three is called.

    reflects, transmits: bool. Without Fresnel just one of them may be True.
    """
    set_lobe(lobes, i, MICROFACET_LOBE, weight, normal)
    lobes.alpha[i], lobes.ior[i], lobes.fresnel[i] = clamp01(alpha), ior, NO_FRESNEL
    lobes.reflects[i], lobes.transmits[i] = reflects, transmits


@kernel
def set_fresnel_dielectric(lobes, i):
    """Reflect and let through as glass of the lobe's ior."""
    lobes.fresnel[i] = DIELECTRIC


@kernel
def set_fresnel_schlick(lobes, i, f0, reflection_tint, transmission_tint):
    """The curve of the lobe's ior remapped to f0..1, then tinted; f0 is clamped to 0..1."""
    lobes.fresnel[i] = SCHLICK
    store3(lobes.f0, i, (clamp01(f0[0]), clamp01(f0[1]), clamp01(f0[2])))
    store3(lobes.reflection_tint, i, reflection_tint)
    store3(lobes.transmission_tint, i, transmission_tint)


@kernel
def set_fresnel_f82(lobes, i, f0, f82_b):
    """A metal that reflects f0 at normal incidence; f82_b: see `fresnel.f82_b_from_tint`."""
    lobes.fresnel[i] = F82
    store3(lobes.f0, i, f0)
    store3(lobes.f82_b, i, f82_b)


@kernel
def mapped_shadowing(lobes, i, wi, is_soft):
    """What is left of lobe i under a normal map: nothing where the map sends light through the
    smooth surface, and where is_soft, which is for matt lobes, a soft edge where they turn dark.

    Conty Estevez et al. 2019, A Microfacet-Based Shadowing Function to Solve the Bump Terminator
    Problem.
    """
    n, n_shade = load3(lobes.normal, i), load3(lobes.n_shade, 0)
    if n == n_shade:
        return ONE
    cos_wi, cos_map = dot(n_shade, wi), dot(n_shade, n)
    if cos_wi * cos_map * dot(n, wi) < ZERO:
        return ZERO
    cos_wi, cos_map_sq = abs(cos_wi), cos_map * cos_map
    if not is_soft or cos_map_sq >= ONE or cos_wi >= ONE:
        return ONE
    alpha_sq = (ONE - cos_map_sq) / max(np.float32(8) * cos_map_sq, ONE - cos_map_sq)
    return TWO * cos_wi / (cos_wi + smith_root(cos_wi, alpha_sq))


@kernel
def eval_lobe(lobes, i, wo, wi):
    """(BSDF x |cos|, density over solid angle of sampling wi) of lobe i but for its weight."""
    kind = lobes.kind[i]
    value, pdf = BLACK, ZERO
    if kind == MICROFACET_LOBE:
        value, pdf = eval_microfacet(lobes, i, wo, wi)
    elif kind == DIFFUSE_LOBE:
        pdf = pdf_cosine_hemisphere(dot(load3(lobes.normal, i), wi))
        if pdf > ZERO:
            a, b = lobes.oren_nayar[i, 0], lobes.oren_nayar[i, 1]
            n, multiscatter = load3(lobes.normal, i), load3(lobes.multiscatter, i)
            value = eval_oren_nayar(a, b, multiscatter, n, wo, wi)
    elif kind == TRANSLUCENT_LOBE:
        pdf = pdf_cosine_hemisphere(-dot(load3(lobes.normal, i), wi))
        value = pdf, pdf, pdf
    if pdf > ZERO:
        value = scale(value, mapped_shadowing(lobes, i, wi, kind != MICROFACET_LOBE))
    return value, pdf


@kernel
def is_seen(lobes, i, rays):
    """Whether a light that only some kinds of ray see shines on lobe i, as in Cycles."""
    if lobes.kind[i] != MICROFACET_LOBE:
        return rays & DIFFUSE_RAY != 0
    by_reflection = lobes.reflects[i] and rays & GLOSSY_RAY != 0
    return by_reflection or (lobes.transmits[i] and rays & TRANSMISSION_RAY != 0)


@called_kernel
def eval_lobes(lobes, num, n_geo, wo, wi, rays):
    """(BSDF x |cos|, density over solid angle with which `sample_lobes` returns wi).

    rays: bits of the rays that see the light there; other lobes add to the density alone.
    """
    value, pdf, picks = BLACK, ZERO, ZERO
    for i in range(num):
        picks += lobes.pick[i]
        value_i, pdf_i = eval_lobe(lobes, i, wo, wi)
        if pdf_i > ZERO:
            pdf += lobes.pick[i] * pdf_i
            if is_seen(lobes, i, rays):
                value = add(value, mul(load3(lobes.weight, i), value_i))
    return value, pdf / picks if picks > ZERO else ZERO


@kernel
def is_matt(lobes, i):
    """Whether lobe i counts as diffuse, as in Cycles."""
    return lobes.kind[i] == DIFFUSE_LOBE or lobes.kind[i] == TRANSLUCENT_LOBE


@kernel
def eval_matt_lobes(lobes, num, wo, wi):
    """BSDF x |cos| of the matt lobes alone."""
    value = BLACK
    for i in range(num):
        if is_matt(lobes, i):
            value_i, _ = eval_lobe(lobes, i, wo, wi)
            value = add(value, mul(load3(lobes.weight, i), value_i))
    return value


@kernel
def lobes_albedo(lobes, num, only_matt):
    """An estimate of how much light all lobes scatter, or the matt ones, as a colour; what goes
    straight on does not count."""
    albedo = BLACK
    for i in range(num):
        if lobes.kind[i] != TRANSPARENT_LOBE and (is_matt(lobes, i) or not only_matt):
            weight = load3(lobes.weight, i)
            mean_weight = mean(weight)
            if mean_weight > ZERO:
                albedo = add(albedo, scale(weight, lobes.pick[i] / mean_weight))
    return albedo


@kernel
def pick_lobe(lobes, num, u):
    """(lobe, its probability, u stretched to what is left of it); (-1, 0, u) if all are black."""
    total = ZERO
    for i in range(num):
        total += lobes.pick[i]
    lobe, left = -1, u * total
    for i in range(num):
        pick = lobes.pick[i]
        if pick > ZERO:
            lobe = i
            if left < pick:
                break
            left -= pick
    if lobe < 0:
        return lobe, ZERO, u
    return lobe, lobes.pick[lobe] / total, left / lobes.pick[lobe]


@kernel
def sample_matt(lobes, i, n_geo, u):
    """(wi, whether it lies on the right side of the surface) of a diffuse or translucent lobe."""
    n, sign = load3(lobes.normal, i), ONE if lobes.kind[i] == DIFFUSE_LOBE else -ONE
    n = scale(n, sign)
    fu, fv = frame(n)
    wi = from_frame(fu, fv, n, sample_cosine_hemisphere(u))
    return wi, sign * dot(n_geo, wi) > ZERO


@called_kernel
def sample_lobes(lobes, num, n_geo, wo, u_lobe, u):
    """A direction to scatter to: (wi, weight, pdf, kind of the ray).

    weight: BSDF x |cos| / pdf, black to end the path. pdf: over solid angle, of all lobes; 0 for a
    direction without a density, which the lobe picked has to itself.
    """
    i, probability, u_side = pick_lobe(lobes, num, u_lobe)
    wi, value, is_delta, ray_kind = scale(wo, -ONE), WHITE, True, STRAIGHT_RAY
    if probability > ZERO and lobes.kind[i] == MICROFACET_LOBE:
        wi, is_delta, value, share, is_refracted = sample_microfacet(lobes, i, n_geo, wo, u_side, u)
        probability *= share
        ray_kind = TRANSMISSION_RAY if is_refracted else GLOSSY_RAY
    elif probability > ZERO and lobes.kind[i] != TRANSPARENT_LOBE:
        wi, is_valid = sample_matt(lobes, i, n_geo, u)
        probability *= ONE if is_valid else ZERO
        is_delta, ray_kind = False, DIFFUSE_RAY
    if probability > ZERO and is_delta:
        value = mul(load3(lobes.weight, i), value)
        return wi, scale(value, ONE / probability), ZERO, ray_kind
    if probability > ZERO:
        value, pdf = eval_lobes(lobes, num, n_geo, wo, wi, ALL_RAYS)
        if pdf > ZERO:
            return wi, scale(value, ONE / pdf), pdf, ray_kind
    return wi, BLACK, ZERO, ray_kind


@kernel
def transmits(lobes, num):
    """Whether any lobe spreads light to the other side of the surface."""
    found = False
    for i in range(num):
        if lobes.kind[i] == MICROFACET_LOBE:
            found = found or (lobes.transmits[i] and not is_unbent(lobes, i))
        else:
            found = found or lobes.kind[i] == TRANSLUCENT_LOBE
    return found


@kernel
def find_gloss(lobes, num, n, wo):
    """The Gloss of the highest reflection; all else that spreads light counts as matt."""
    gloss, highest, total, albedo = matt_gloss(wo), ZERO, ZERO, ZERO
    for i in range(num):
        is_microfacet = lobes.kind[i] == MICROFACET_LOBE
        if lobes.kind[i] == TRANSPARENT_LOBE or (is_microfacet and is_smooth(lobes, i)):
            continue
        total += lobes.pick[i]
        alpha_sq = lobes.alpha[i] * lobes.alpha[i]
        if is_microfacet and not lobes.transmits[i] and lobes.pick[i] > highest * alpha_sq:
            highest, albedo = lobes.pick[i] / alpha_sq, lobes.pick[i]
            gloss = Gloss(wo, alpha_sq, ZERO)
    if albedo == ZERO:
        return gloss
    matt, cos = max(total - albedo, MIN_MATT * albedo), max(ZERO, dot(n, wo))
    smith = TWO * (cos + smith_root(cos, gloss.alpha_sq))
    return Gloss(wo, gloss.alpha_sq, GLOSS_SHARE * albedo / (matt * smith))


@kernel
def transparency(lobes, num):
    """How much light goes straight through, as a colour."""
    passed = BLACK
    for i in range(num):
        if lobes.kind[i] == TRANSPARENT_LOBE:
            passed = add(passed, load3(lobes.weight, i))
    return passed


@kernel
def is_glossy(lobes, num):
    """Whether any lobe is made of microfacets."""
    found = False
    for i in range(num):
        found = found or lobes.kind[i] == MICROFACET_LOBE
    return found
