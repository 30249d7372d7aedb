"""The importance of a lane: an estimate of the irradiance its lights give a shading point.

Mean intensity towards the point, times the expected clamped cosine at the surface, over the mean
squared distance. The intensity is that of a lobe with the flux and the mean cosine of all emitted
light: what leaves a set of lights in all directions adds up to its flux, so a narrow beam that
points elsewhere counts for little. Seen from near by the directions to a set's lights differ,
which widens the lobe: mean cosines of independent deviations multiply. A single beam is no lobe:
its intensity is its peak up to where it fades, and falls to nothing at its edge. To the cosine a
glossy surface adds what it reflects of light from there. Bounds only cull: importance is zero where
the box lies behind the surface or the surface outside the cone, so a light that contributes never
has probability zero.

What was measured, and what did not pay, is told in ../light_tree.md.
"""

import math
from typing import NamedTuple

import numpy as np

from ..jit import HALF, ONE, TWO, ZERO, kernel
from ..vec import add, dot, scale, sub
from .nodes import NUM_LANES, load_lane, sum_lanes

# E[max(0, h + s z)] for a standard normal z is about (h + sqrt(h^2 + 2/pi s^2)) / 2: equal where
# h = 0, 5 % less where h = s, and much less below 0, which is the safe side to err on. Over a box
# that reaches r to either side, s^2 is about r^2 / 3.
BOX_SPREAD = np.float32(2 / np.pi / 3)
# Share of the variance in the squared distance. Among the lights 1/d^2 is large: its mean in the
# middle of a ball of variance s^2 is 1.8 / s^2, of a disk more.
VARIANCE_SHARE = np.float32(1 / 4)
# Variance over squared distance, at which the direction to a set's lights has lost 1 - 1/sqrt(3)
# of its mean: lights to all sides of the axis count double, those along it not at all.
DIRECTION_SPREAD = TWO
# The least intensity of a set, over the sum of the peaks of its lights.
FLOOR_SHARE = 0.005
BEAM_FLOOR_SHARE = 1e-4
# Factor of `lobe`, part of a lane's flux.
LOBE_SCALE = 3 / (4 * np.pi)
# Beams narrower than this mean cosine are taken as so narrow: the lobe's k stays finite.
MAX_MEAN_COS = 0.9999
# Rounding of the products below, relative to terms near 1.
CONE_SLACK = np.float32(1e-4)
QUARTER = np.float32(0.25)
THREE = np.float32(3)
TINY = np.float32(1e-30)
HUGE = np.float32(1e30)
# How much of a reflection counts: scattered rays find lights in it as well, and far ones are mostly
# hidden.
GLOSS_SHARE = np.float32(0.3)
# Deviations of a direction, variance s^2 along each of two axes, widen GGX about as if its alpha^2
# were 2 s^2 larger.
ALPHA_SQ_SPREAD = np.float32(2 / 3)
MIN_HALF_SQ = np.float32(1e-6)


class Gloss(NamedTuple):
    """What a point sends towards wo of the light that comes near the mirrored direction.

    wo: vec3, unit. alpha_sq: of a GGX lobe that reflects. scale: its albedo over that of all matt
    lobes, over 2 (cos + s) as in microfacet.py, times GLOSS_SHARE; 0 where nothing is glossy.
    """

    wo: tuple
    alpha_sq: np.float32
    scale: np.float32


@kernel
def matt_gloss(feature, wo):
    """No gloss at a point: None if nowhere in the scene."""
    return None if feature is None else Gloss(wo, ONE, ZERO)


class Receiver(NamedTuple):
    """A point that lights are chosen for.

    p, n: vec3 in world space, n unit. two_sided: whether light from behind counts as much. gloss: a
    Gloss, or None in a scene without any, to compile nothing for it.
    """

    p: tuple
    n: tuple
    two_sided: bool
    gloss: Gloss | None


@kernel
def matt_receiver(p, n):
    """A Receiver on a matt surface that light reaches from the front."""
    return Receiver(p, n, False, None)


@kernel
def expected_positive_part(mean, spread):
    """E[max(0, x)] for an x with this mean; spread as above, a multiple of its variance."""
    return HALF * (mean + math.sqrt(mean * mean + spread))


@kernel
def lobe(mean_cos, mean_cos_here):
    """Share of its flux that a source sends per steradian in a direction, times 4 pi / 3.

    mean_cos_here: mean_cos times the cosine of the direction's angle from the axis. The lobe is
    (1 + k/4 (1 - cos))^-4, normalized: close to the von Mises-Fisher distribution of this mean
    cosine, without its exponentials; k as approximated by Banerjee et al. 2005, r (3 - r^2) /
    (1 - r^2). All of it over one division.
    """
    rest = ONE - mean_cos * mean_cos
    slope = QUARTER * (TWO + rest)
    here = rest + slope * (mean_cos - mean_cos_here)
    side = rest + TWO * slope * mean_cos
    peak = rest * side
    here_sq = here * here
    return peak * peak * peak / (here_sq * here_sq * (side * side + peak + rest * rest))


@kernel
def box_reach(half_extent, a):
    """How far a box reaches from its centre along a."""
    return abs(a[0]) * half_extent[0] + abs(a[1]) * half_extent[1] + abs(a[2]) * half_extent[2]


@kernel
def distant_importance(lane, receiver, shine):
    """Irradiance that sun or background can give a Receiver, and what a glossy one adds."""
    cos_surface = dot(receiver.n, lane.mean)
    cos_surface = max(cos_surface, -cos_surface) if receiver.two_sided else cos_surface
    received = max(ZERO, min(ONE, cos_surface + lane.half_extent[0]))
    return lane.flux * (received + shine if received > ZERO else ZERO)


@kernel
def apex_place(lane, above, dist_sq):
    """A point as seen from the apex of a lane's cone: (its height, its squared distance).

    above: its height over the mean. Cones of one angle with their apexes in a ball lie in one cone
    of that angle, tangent to it.
    """
    height = above + lane.apex_shift
    return height, max(TINY, dist_sq + (above + height) * lane.apex_shift)


@kernel
def is_within_cone(lane, height, apex_dist_sq):
    """Whether a light of a lane may emit towards a point."""
    cos_cone = lane.cos_cone - CONE_SLACK
    # Squares with their signs compare like the numbers.
    return height * abs(height) >= cos_cone * abs(cos_cone) * apex_dist_sq


@kernel
def beam(lane, height, apex_dist_sq):
    """Intensity of a single beam, W/sr: a smoothstep from its edge to its peak."""
    cos_axis = height / math.sqrt(apex_dist_sq)
    t = min(ONE, max(ZERO, (lane.cos_cone - cos_axis) * lane.mean_cos))
    return lane.flux * t * t * (THREE - TWO * t)


@kernel
def glossy_part(gloss, n, lane, to_mean, inv_dist):
    """What gloss adds to the cosine at the surface, for the light of a lane.

    BSDF x cosine of GGX over that of the matt lobes, without Fresnel's and Smith's slow changes.
    The half vector is as sensitive to a direction as it is short before it is normalized, which
    draws reflections out at grazing angles.
    """
    if gloss is None:
        return ZERO
    is_distant = lane.variance == np.inf
    wi = lane.mean if is_distant else scale(to_mean, inv_dist)
    width = lane.half_extent[0]
    variance = width * width if is_distant else lane.variance * inv_dist * inv_dist
    half = add(gloss.wo, wi)
    half_sq, cos = max(MIN_HALF_SQ, dot(half, half)), dot(n, half)
    alpha_sq = min(ONE, gloss.alpha_sq + ALPHA_SQ_SPREAD * variance / half_sq)
    rest = max(ZERO, ONE - cos * cos / half_sq)
    spread = rest + alpha_sq * (ONE - rest)
    return gloss.scale * alpha_sq / (spread * spread)


@kernel
def lane_importance(lane, receiver):
    """Importance of a lane for a Receiver, in W/m^2; never NaN.

    No branches on the lane: compilers make one vector loop of it for all lanes of a node.
    """
    n, two_sided = receiver.n, receiver.two_sided
    to_mean = sub(lane.mean, receiver.p)
    dist_sq = dot(to_mean, to_mean)
    height, reach = dot(n, to_mean), box_reach(lane.half_extent, n)
    above = -dot(lane.axis, to_mean)
    mean_sq = dist_sq + VARIANCE_SHARE * lane.variance
    inv_dist = ONE / math.sqrt(mean_sq)
    spread = BOX_SPREAD * reach * reach
    received = expected_positive_part(height, spread)
    if two_sided:
        received += expected_positive_part(-height, spread)
    shrink = lane.mean_cos / math.sqrt(max(TINY, dist_sq + DIRECTION_SPREAD * lane.variance))
    apex_height, apex_dist_sq = apex_place(lane, above, dist_sq)
    of_set = lane.flux * lobe(shrink * math.sqrt(dist_sq), shrink * above)
    of_beam = beam(lane, apex_height, apex_dist_sq)
    intensity = (of_beam if lane.mean_cos < ZERO else of_set) + lane.floor
    shine = glossy_part(receiver.gloss, n, lane, to_mean, inv_dist)
    local = min(HUGE, intensity * (received * inv_dist + shine) * inv_dist * inv_dist)
    faces = two_sided or height + reach > ZERO
    is_lit = faces and is_within_cone(lane, apex_height, apex_dist_sq)
    if lane.variance == np.inf:
        return distant_importance(lane, receiver, shine)
    return local if is_lit and mean_sq > TINY else ZERO


@kernel
def lane_importances(tree, node, receiver, weights):
    """Fill weights, (NUM_LANES,) float32, with the importances of a node's lanes; their sum."""
    for k in range(NUM_LANES):
        weights[k] = lane_importance(load_lane(tree.columns, node, k), receiver)
    return sum_lanes(weights)
