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

# E[max(0, h + s z)] for a standard normal z is within 3 % of (h + sqrt(h^2 + 2/pi s^2)) / 2, and
# equal at h = 0. Over a box that reaches r to either side, s^2 is about r^2 / 3.
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
def distant_importance(tree, node, n):
    """Irradiance that sun or background can give a surface with the normal n."""
    reach = dot(n, load3(tree.mean, node)) + tree.half_extent[node, 0]
    return tree.energy[node] * max(ZERO, min(ONE, reach))


@kernel
def is_outside_cone(cos_cone, axis, to_node, dist_sq, size_sq):
    """Whether no light of a node can emit towards the point; to_node leads from there to its mean.

    size_sq: squared half diagonal of the node's box, bounded here by a sphere.
    """
    if cos_cone <= -ONE or dist_sq <= size_sq:
        return False
    sin_sq = size_sq / dist_sq
    cos_size = math.sqrt(ONE - sin_sq)
    if cos_size <= -cos_cone:  # the two angles make up pi
        return False
    sin_cone = math.sqrt(max(ZERO, ONE - cos_cone * cos_cone))
    cos_limit = cos_cone * cos_size - sin_cone * math.sqrt(sin_sq)
    return -dot(axis, to_node) < (cos_limit - CONE_SLACK) * math.sqrt(dot(axis, axis) * dist_sq)


@kernel
def emitted_share(tree, node, to_node, half_extent, mean_sq):
    """Expected share of peak intensity that a node sends towards the point; mean_sq: m^2."""
    axis = load3(tree.axis, node)
    reach = box_reach(half_extent, axis)
    spread = AXIS_SPREAD * max(MIN_AXIS_SPREAD, ONE - dot(axis, axis)) * mean_sq
    spread += BOX_SPREAD * reach * reach
    cosine = expected_positive_part(-dot(axis, to_node), spread) / math.sqrt(mean_sq)
    return ONE + tree.cosine_share[node] * (cosine - ONE)


@kernel
def node_importance(tree, node, p, n):
    """Importance of a node for a surface point p with the unit normal n, in W/m^2; never NaN."""
    variance = tree.variance[node]
    if variance == np.inf:
        return distant_importance(tree, node, n)
    to_node = sub(load3(tree.mean, node), p)
    half_extent = load3(tree.half_extent, node)
    height = dot(n, to_node)
    reach = box_reach(half_extent, n)
    if height + reach <= ZERO:
        return ZERO
    dist_sq = dot(to_node, to_node)
    mean_sq = dist_sq + VARIANCE_SHARE * variance
    size_sq = dot(half_extent, half_extent)
    axis = load3(tree.axis, node)
    if mean_sq <= ZERO or is_outside_cone(tree.cos_cone[node], axis, to_node, dist_sq, size_sq):
        return ZERO
    emitted = emitted_share(tree, node, to_node, half_extent, mean_sq)
    received = expected_positive_part(height, BOX_SPREAD * reach * reach)
    return tree.energy[node] * emitted * received / (mean_sq * math.sqrt(mean_sq))


@kernel
def flat_light_importance(tree, lights, node, light, p, n):
    """Irradiance of one triangle, rectangle or ellipse at p, nearly: exact far away and close by.

    From afar it is that of a point; on the light's axis, that of a disk of the same area.
    """
    to_center = sub(load3(tree.mean, node), p)
    height_light = -dot(to_center, load3(lights.axis_w, light))
    height = dot(n, to_center)
    reach = box_reach(load3(tree.half_extent, node), n)
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
    return tree.energy[node] * emitted * received / (dist_sq + INV_PI * lights.area[light])


@kernel
def light_importance(tree, lights, node, light, p, n):
    """Importance of the node of a single light, with that light's own shape and falloff."""
    kind = lights.kind[light]
    if kind in (TRIANGLE, RECTANGLE, ELLIPSE):
        return flat_light_importance(tree, lights, node, light, p, n)
    value = node_importance(tree, node, p, n)
    if value > ZERO and lights.cos_cone[light] != NO_CONE:
        direction = normalize(sub(p, load3(lights.position, light)))
        value *= max(MIN_FALLOFF, emission_falloff(lights, light, direction))
    return value
