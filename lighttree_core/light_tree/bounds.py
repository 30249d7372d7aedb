"""The importances of Conty Estevez and Kulla 2018 and of Ma's thesis (2018), from bounds alone.

Both bound the angles at the surface and at the emitters by the sphere around a set's box: power x
cosine over squared distance, zero where no light of the set can emit. Conty and Kulla keep the
distance at least the sphere's radius and multiply by the cosine at the surface; the thesis does
neither, and cuts off what lies behind the surface. Kept to compare with.

Lanes hold other things in the columns of nodes.py: the box's centre as MEAN, and these.
"""

import math

import numpy as np

from ..jit import ONE, PI, ZERO, allocating_kernel, kernel
from ..vec import dot, sub
from .importance import HUGE, box_reach, distant_importance
from .nodes import (
    APEX_SHIFT,
    AXIS,
    COS_CONE,
    FLUX,
    MEAN,
    MEAN_COS,
    NUM_LANES,
    VARIANCE,
    load_lane,
    store_box,
    sum_lanes,
)
from .split import (
    NUM_SUM_COLUMNS,
    ROW_AXIS,
    ROW_FLUX,
    ROW_MAX,
    ROW_MIN,
    ROW_THETA_E,
    SUM_AXIS,
    THETA_O,
    clear_sum,
    merge_cone,
)

# Cosines do not round below this where light may still arrive.
MIN_COS = np.float32(1e-6)
# Angle between the axis of a set and any of its lights' axes; largest angle of emission from
# those; radius of the sphere around the box.
LANE_THETA_O, LANE_THETA_E, LANE_RADIUS = MEAN_COS, COS_CONE, APEX_SHIFT


@allocating_kernel
def summarize_bounds(column, rows, union):
    """Power and bounds of a set of lights."""
    flux, axis, total = 0.0, np.zeros(3), np.zeros(NUM_SUM_COLUMNS)
    box_min, box_max = np.full(3, np.inf), np.full(3, -np.inf)
    theta_o, theta_e = 0.0, 0.0
    clear_sum(total)
    for row in rows:
        flux += row[ROW_FLUX]
        axis += row[ROW_AXIS : ROW_AXIS + 3]
        theta_e = max(theta_e, min(row[ROW_THETA_E], np.float32(math.pi / 2)))
        if union:
            merge_cone(total, row[ROW_AXIS : ROW_AXIS + 3], 0.0)
        for k in range(3):
            box_min[k] = min(box_min[k], row[ROW_MIN + k])
            box_max[k] = max(box_max[k], row[ROW_MAX + k])
    if union:
        axis[:], theta_o = total[SUM_AXIS : SUM_AXIS + 3], total[THETA_O]
    else:
        axis /= max(math.sqrt((axis**2).sum()), 1e-300)
        for row in rows:
            own = row[ROW_AXIS : ROW_AXIS + 3]
            has_axis = (own**2).sum() > 0.5
            between = math.acos(min(1.0, max(-1.0, (axis * own).sum())))
            theta_o = max(theta_o, between if has_axis else math.pi)
    column[FLUX] = flux
    column[AXIS : AXIS + 3] = axis
    # Rounded up, so that what is culled is dark.
    column[LANE_THETA_O] = theta_o + 1e-3
    column[LANE_THETA_E] = theta_e
    column[MEAN : MEAN + 3] = (box_min + box_max) / 2
    radius_sq = store_box(column, box_min, box_max)
    column[LANE_RADIUS] = math.sqrt(radius_sq) * (1 + 2.0**-20)
    column[VARIANCE] = radius_sq / 3  # of lights anywhere in the box


@kernel
def bounds_importance(lane, receiver, cut_off):
    """Importance of a lane for a Receiver, taken as matt; never NaN."""
    if lane.variance == np.inf:
        return distant_importance(lane, receiver, ZERO)
    n = receiver.n
    theta_o, theta_e, radius = lane.mean_cos, lane.cos_cone, lane.apex_shift
    to_center = sub(lane.mean, receiver.p)
    height = dot(n, to_center)
    height = max(height, -height) if receiver.two_sided else height
    if lane.flux == ZERO or height + box_reach(lane.half_extent, n) <= ZERO:
        return ZERO
    dist_sq = dot(to_center, to_center)
    if dist_sq <= radius * radius:
        theta_u = PI
        cos_axis = cos_surface = ONE
    else:
        dist = math.sqrt(dist_sq)
        theta_u = math.asin(radius / dist)
        cos_axis = min(ONE, max(-ONE, -dot(lane.axis, to_center) / dist))
        cos_surface = min(ONE, max(-ONE, height / dist))
    theta = max(ZERO, math.acos(cos_axis) - theta_o - theta_u)
    if theta >= theta_e:
        return ZERO
    value = lane.flux * max(MIN_COS, math.cos(theta))
    if not cut_off:
        dist_sq = max(dist_sq, radius * radius)
        value *= max(MIN_COS, math.cos(max(ZERO, math.acos(cos_surface) - theta_u)))
    return min(HUGE, value / dist_sq) if dist_sq > ZERO else HUGE


@kernel
def bounds_importances(tree, node, receiver, cut_off, weights):
    """Fill weights, (NUM_LANES,) float32, with the importances of a node's lanes; their sum."""
    for k in range(NUM_LANES):
        lane = load_lane(tree.columns, node, k)
        weights[k] = bounds_importance(lane, receiver, cut_off)
    return sum_lanes(weights)
