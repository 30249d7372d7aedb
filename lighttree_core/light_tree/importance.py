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

A node takes as long as the longest chain of operations here that wait for each other: so roots and
divisions are few and early, and a quotient is kept as its two numbers until the end.
What was measured, and what did not pay, is told in ../light_tree.md.
"""

import math
from typing import NamedTuple

import numpy as np

from ..jit import HALF, ONE, TWO, ZERO, called_kernel, kernel
from ..vec import add, dot, scale, sub
from .nodes import NUM_LANES, load_lane, sum_lanes

# Three lines below E[max(0, x)] for a normal x with mean h and the variance of a box that reaches r
# to either side, s^2 = r^2 / 3, which is about (h + sqrt(h^2 + 2/pi s^2)) / 2: h itself, the
# tangent at h = 0, and one for means behind the surface.
EDGE_ON = np.float32(0.23)
BEHIND, BEHIND_SLOPE = np.float32(0.13), np.float32(0.08)
# Share of the variance in the squared distance. Among the lights 1/d^2 is large: its mean in the
# middle of a ball of variance s^2 is 1.8 / s^2, of a disk more.
VARIANCE_SHARE = np.float32(1 / 4)
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
THREE_QUARTERS = np.float32(0.75)
THREE_HALVES = np.float32(1.5)
THREE = np.float32(3)
TINY = np.float32(1e-30)
HUGE = np.float32(1e30)
# How much of a reflection counts: scattered rays find lights in it as well, and far ones are mostly
# hidden.
GLOSS_SHARE = np.float32(0.3)
# Deviations of a direction, variance s^2 along each of two axes, widen GGX about as if its alpha^2
# were 2 s^2 larger.
ALPHA_SQ_SPREAD = np.float32(2 / 3)


class Gloss(NamedTuple):
    """What a point sends towards wo of the light that comes near the mirrored direction.

    wo: vec3, unit. alpha_sq: of a GGX lobe that reflects. scale: its albedo over that of all matt
    lobes, over 2 (cos + s) as in microfacet.py, times GLOSS_SHARE; 0 where nothing is glossy.
    """

    wo: tuple
    alpha_sq: np.float32
    scale: np.float32


@kernel
def matt_gloss(wo):
    """No gloss at a point."""
    return Gloss(wo, ONE, ZERO)


class Receiver(NamedTuple):
    """A point that lights are chosen for.

    p, n: vec3 in world space, n unit. two_sided: whether light from behind counts as much.
    """

    p: tuple
    n: tuple
    two_sided: bool
    gloss: Gloss


@kernel
def matt_receiver(p, n):
    """A Receiver on a matt surface that light reaches from the front."""
    return Receiver(p, n, False, matt_gloss(n))


@kernel
def expected_positive_part(mean, reach):
    """E[max(0, x)] for an x around this mean, `reach` to either side; within 20 %, mostly below."""
    behind = BEHIND * reach + BEHIND_SLOPE * mean
    return max(mean, max(EDGE_ON * reach + HALF * mean, behind))


@kernel
def lobe(mean_cos, mean_cos_here):
    """Share of its flux that a source sends per steradian in a direction, times 4 pi / 3: the two
    numbers of a quotient.

    mean_cos_here: mean_cos times the cosine of the direction's angle from the axis. The lobe is
    (1 + k/4 (1 - cos))^-4, normalized: close to the von Mises-Fisher distribution of this mean
    cosine, without its exponentials; k as approximated by Banerjee et al. 2005, r (3 - r^2) /
    (1 - r^2).
    """
    mean_cos_sq = mean_cos * mean_cos
    rest = ONE - mean_cos_sq
    slope = THREE_QUARTERS - QUARTER * mean_cos_sq
    here = rest + slope * (mean_cos - mean_cos_here)
    side = (ONE + THREE_HALVES * mean_cos) - mean_cos_sq * (ONE + HALF * mean_cos)
    peak = rest * side
    here_sq = here * here
    return peak * peak * peak, here_sq * here_sq * (side * side + (peak + rest * rest))


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
def apex_cos(lane, above, dist_sq):
    """Cosine of the angle from the axis under which the apex of a lane's cone sees a point.

    above: the point's height over the mean. Cones of one angle with their apexes in a ball lie in
    one cone of that angle, tangent to it.
    """
    height = above + lane.apex_shift
    return height / math.sqrt(max(TINY, dist_sq + (above + height) * lane.apex_shift))


@kernel
def beam(lane, cos_axis):
    """Intensity of a single beam over its peak: a smoothstep from its edge to where it is one."""
    t = min(ONE, max(ZERO, (lane.cos_cone - cos_axis) * lane.mean_cos))
    return t * t * (THREE - TWO * t)


@kernel
def glossy_part(gloss, n, lane, to_mean, dist):
    """What gloss adds to the cosine at the surface, for the light of a lane: the two numbers of a
    quotient.

    BSDF x cosine of GGX over that of the matt lobes, without Fresnel's and Smith's slow changes.
    The half vector is as sensitive to a direction as it is short before it is normalized, which
    draws reflections out at grazing angles.
    """
    if gloss is None:
        return ZERO, ONE
    # For local lights, the half vector times the distance: there are no unit vectors to wait for.
    half, variance = add(scale(gloss.wo, dist), to_mean), lane.variance
    if lane.variance == np.inf:
        half, variance = add(gloss.wo, lane.mean), lane.half_extent[0] * lane.half_extent[0]
    inv_half_sq = ONE / max(TINY, dot(half, half))
    cos = dot(n, half)
    alpha_sq = min(ONE, gloss.alpha_sq + ALPHA_SQ_SPREAD * variance * inv_half_sq)
    rest = max(ZERO, ONE - cos * cos * inv_half_sq)
    spread = rest + alpha_sq * (ONE - rest)
    return gloss.scale * alpha_sq, spread * spread


@kernel
def lane_importance(lane, receiver, gloss):
    """Importance of a lane for a Receiver, in W/m^2; never NaN.

    gloss: the receiver's, or None for one that has none, to compile nothing for it. No branches:
    compilers make one vector loop of it for all lanes of a node, whatever is around it.
    """
    n, two_sided = receiver.n, receiver.two_sided
    to_mean = sub(lane.mean, receiver.p)
    dist_sq = dot(to_mean, to_mean)
    mean_sq = dist_sq + VARIANCE_SHARE * lane.variance
    dist = math.sqrt(mean_sq)
    inv_dist = ONE / dist
    height, reach = dot(n, to_mean), box_reach(lane.half_extent, n)
    back, lowest = (ONE, -HUGE) if two_sided else (ZERO, ZERO)
    received = expected_positive_part(height, reach) + back * expected_positive_part(-height, reach)
    above = -dot(lane.axis, to_mean)
    # Directions to lights around a mean at this distance have about this mean cosine themselves.
    mean_cos = lane.mean_cos * (dist_sq / max(TINY, dist_sq + lane.variance))
    share, share_over = lobe(mean_cos, mean_cos * (above * inv_dist))
    cos_axis = apex_cos(lane, above, dist_sq)
    if lane.mean_cos < ZERO:
        share, share_over = beam(lane, cos_axis), ONE
    intensity = lane.flux * share + lane.floor * share_over
    shine, shine_over = glossy_part(gloss, n, lane, to_mean, dist)
    received = (received * inv_dist * shine_over + shine) * (inv_dist * inv_dist)
    local = min(HUGE, intensity * received / (share_over * shine_over))
    is_lit = height + reach > lowest and cos_axis >= lane.cos_cone - CONE_SLACK
    if lane.variance == np.inf:
        return distant_importance(lane, receiver, shine / shine_over)
    return local if is_lit and mean_sq > TINY else ZERO


@kernel
def lane_importances(tree, node, receiver, weights):
    """Fill weights, (NUM_LANES,) float32, with the importances of a node's lanes; their sum."""
    if receiver.gloss.scale > ZERO:
        return glossy_importances(tree, node, receiver, weights)
    for k in range(NUM_LANES):
        weights[k] = lane_importance(load_lane(tree.columns, node, k), receiver, None)
    return sum_lanes(weights)


@called_kernel
def glossy_importances(tree, node, receiver, weights):
    """The same for a glossy receiver, called: beside another loop either is slower."""
    for k in range(NUM_LANES):
        lane = load_lane(tree.columns, node, k)
        weights[k] = lane_importance(lane, receiver, receiver.gloss)
    return sum_lanes(weights)
