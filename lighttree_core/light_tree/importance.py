"""The importance of a node: an estimate of the irradiance its lights give a shading point.

Energy, times the expected clamped cosine at the surface, times that at the emitters, over the mean
squared distance. A node's lights are taken as spread over its box, their axes about the mean axis.
A single light knows its own shape, and its estimate is nearly exact. Bounds only cull: importance
is zero where the box lies behind the surface or the surface outside the cone, so a light that
contributes never has probability zero.
"""

import math

import numpy as np

from ..jit import HALF, INV_PI, ONE, ZERO, kernel
from ..light_points import emission_falloff
from ..scene import ELLIPSE, NO_CONE, RECTANGLE, TRIANGLE
from ..vec import dot, load3, normalize, sub

# E[max(0, h + s z)] for a standard normal z is about (h + sqrt(h^2 + 2/pi s^2)) / 2: equal where
# h = 0, 5 % less where h = s, and much less below 0, which is the safe side to err on. Over a box
# that reaches r to either side, s^2 is about r^2 / 3.
BOX_SPREAD = np.float32(2 / np.pi / 3)
# The same form for the cosines of axes with a mean of length m, whose spread grows with 1 - m^2;
# evenly over the sphere it must give E[max(0, cos)] = 1/4.
AXIS_SPREAD = np.float32(1 / 4)
# Axes that differ by less than float32 can tell keep a chance.
MIN_AXIS_SPREAD = np.float32(1e-6)
# Share of the variance in the squared distance. Among the lights 1/d^2 is large: its mean in the
# middle of a ball of variance s^2 is 1.8 / s^2, of a disk more. Measured in city-small, 4 bounces,
# relative MSE x time: 1: 21.6, 1/4: 19.6 seen from the street; 115, 45 from the roof.
VARIANCE_SHARE = np.float32(1 / 4)
# A spot with a radius keeps this share of its importance at the edge of its cone and beyond.
MIN_FALLOFF = np.float32(0.02)
HALF_DIAGONAL = np.float32(0.5**0.5)  # of a square, over its side
# Rounding of the products below, relative to terms near 1.
CONE_SLACK = np.float32(1e-4)


@kernel
def expected_positive_part(mean, spread):
    """E[max(0, x)] for an x with this mean; spread as above, a multiple of its variance."""
    return HALF * (mean + math.sqrt(mean * mean + spread))


@kernel
def box_reach(half_extent, a):
    """How far a box reaches from its centre along a."""
    return abs(a[0]) * half_extent[0] + abs(a[1]) * half_extent[1] + abs(a[2]) * half_extent[2]


@kernel
def distant_importance(node, n):
    """Irradiance that sun or background can give a surface with the normal n."""
    reach = dot(n, node.mean) + node.half_extent[0]
    return node.energy * max(ZERO, min(ONE, reach))


@kernel
def is_outside_cone(node, above, dist_sq):
    """Whether no light of a node can emit towards a point; above: its height over the mean.

    Cones of one angle with their apexes in a ball lie in one cone of that angle, tangent to it.
    """
    shift = node.apex_shift
    apex_dist_sq = max(ZERO, dist_sq + (above + above + shift) * shift)
    return above + shift < (node.cos_cone - CONE_SLACK) * math.sqrt(apex_dist_sq)


@kernel
def node_importance(node, p, n):
    """Importance of a node for a surface point p with the unit normal n, in W/m^2; never NaN."""
    if node.variance == np.inf:
        return distant_importance(node, n)
    to_node = sub(node.mean, p)
    height = dot(n, to_node)
    reach = box_reach(node.half_extent, n)
    if height + reach <= ZERO:
        return ZERO
    dist_sq = dot(to_node, to_node)
    above = -dot(node.axis, to_node)
    mean_sq = dist_sq + VARIANCE_SHARE * node.variance
    if mean_sq <= ZERO or (node.cos_cone > -ONE and is_outside_cone(node, above, dist_sq)):
        return ZERO
    inv_dist = ONE / math.sqrt(mean_sq)
    received = expected_positive_part(height, BOX_SPREAD * reach * reach) * inv_dist
    # What reaches p of lights that emit by the cosine; of all others the peak does.
    length = node.axis_length
    reach_axis = length * box_reach(node.half_extent, node.axis)
    spread = BOX_SPREAD * reach_axis * reach_axis
    spread += AXIS_SPREAD * max(MIN_AXIS_SPREAD, ONE - length * length) * mean_sq
    cosine = expected_positive_part(length * above, spread) * inv_dist
    emitted = ONE + node.cosine_share * (cosine - ONE)
    return node.energy * emitted * received * inv_dist * inv_dist


@kernel
def flat_light_importance(node, lights, light, p, n):
    """Irradiance of one triangle, rectangle or ellipse at p, nearly: exact far away and close by.

    From afar it is that of a point; on the light's axis, that of a disk of the same area.
    """
    to_center = sub(node.mean, p)
    height_light = -dot(to_center, load3(lights.axis_w, light))
    height = dot(n, to_center)
    reach = box_reach(node.half_extent, n)
    if height_light <= ZERO or height + reach <= ZERO:
        return ZERO
    dist_sq = dot(to_center, to_center)
    lateral = math.sqrt(max(ZERO, dist_sq - height_light * height_light))
    # Beside the light its nearest points send most; above it they are straight below.
    beside = max(ZERO, lateral - HALF_DIAGONAL * math.sqrt(lights.size_sq[light]))
    nearest = math.sqrt(height_light * height_light + beside * beside)
    falloff = ONE - beside / (height_light * lights.tan_spread[light])
    if falloff <= ZERO:
        return ZERO
    emitted = height_light / nearest * falloff
    received = min(ONE, expected_positive_part(height, BOX_SPREAD * reach * reach) / nearest)
    return node.energy * emitted * received / (dist_sq + INV_PI * lights.area[light])


@kernel
def light_importance(node, lights, light, p, n):
    """Importance of the node of a single light, with that light's own shape and falloff."""
    kind = lights.kind[light]
    if kind in (TRIANGLE, RECTANGLE, ELLIPSE):
        return flat_light_importance(node, lights, light, p, n)
    value = node_importance(node, p, n)
    if value > ZERO and lights.cos_cone[light] != NO_CONE:
        direction = normalize(sub(p, load3(lights.position, light)))
        value *= max(MIN_FALLOFF, emission_falloff(lights, light, direction))
    return value
