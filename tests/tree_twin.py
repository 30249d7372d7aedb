"""The default light tree once more, in float64 and plain numpy, from the formulas alone.

Slow and simple: sets of lights are arrays of ids, every sum runs over all lights of a set, and no
kernel is called. Only the constants that were found by measuring are taken from the core.
"""

import numpy as np

from lighttree_core.light_tree.importance import (
    BEAM_FLOOR_SHARE,
    BEHIND,
    BEHIND_SLOPE,
    EDGE_ON,
    FLOOR_SHARE,
    MAX_MEAN_COS,
    VARIANCE_SHARE,
)
from lighttree_core.light_tree.options import TreeOptions

WIDTH, NUM_BUCKETS = 16, TreeOptions().buckets
# Wider than the core rounds a cone's angle outwards, which it does to the cosine: radians.
CONE_SLACK = 0.02
MIN_CONE = 1e-3
ORIGIN, ALL_ROUND = np.zeros(3), np.pi


def build(bounds):
    """The tree as nested sets: a node is the set of its lanes, a lane a light's id or a node."""
    ids = np.flatnonzero(bounds.flux > 0)
    local, distant = ids[~bounds.is_distant[ids]], ids[bounds.is_distant[ids]]
    lanes = [lights for lights in (local, distant) if len(lights)]
    if len(lanes) == 2 and 1 < len(distant) <= WIDTH // 2:
        lanes = [local, *distant[:, None]]
    return _node(bounds, lanes)


def _node(bounds, lanes):
    if len(lanes) == 1:
        lanes = _opened(bounds, lanes[0])
    while True:
        large = [lights for lights in lanes if len(lights) > WIDTH]
        room = WIDTH - len(lanes)
        small = [lights for lights in lanes if 1 < len(lights) <= room + 1]
        open_next = large if large and room else small
        if not open_next:
            break
        chosen = max(open_next, key=lambda lights: _power_spread(bounds, lights))
        k = next(k for k, lights in enumerate(lanes) if lights is chosen)
        lanes[k], *others = _opened(bounds, chosen)
        lanes += others
    return frozenset(
        int(lights[0]) if len(lights) == 1 else _node(bounds, [lights]) for lights in lanes
    )


def _opened(bounds, lights):
    """The two parts of a set, or if they fit into one node all its lights."""
    if len(lights) <= WIDTH:
        return list(lights[:, None])
    is_first = _split(bounds, lights)
    return [lights[is_first], lights[~is_first]]


def _power_spread(bounds, lights):
    flux, place = bounds.flux[lights], bounds.mean[lights]
    mean = flux @ place / flux.sum()
    return flux.sum() * np.sqrt(flux @ ((place - mean) ** 2).sum(1) / flux.sum())


def _split(bounds, lights):
    """Which lights of a set go to its first part, by the surface area orientation heuristic."""
    place = bounds.mean[lights]
    low, extent = place.min(0), np.ptp(place, axis=0)
    num = min(NUM_BUCKETS, max(4, len(lights)))
    best_cost, best = np.inf, None
    for side in np.flatnonzero(extent > 0):
        bucket = np.floor((place[:, side] - low[side]) / extent[side] * num)
        for last in range(num - 1):
            is_first = bucket <= last
            if is_first.all():
                continue
            parts = lights[is_first], lights[~is_first]
            # Cuts across a short side of the box are counted as costlier.
            cost = sum(_cost(bounds, part) for part in parts) * extent.max() / extent[side]
            if cost < best_cost:
                best_cost, best = cost, is_first
    return best


def _cost(bounds, lights):
    """Power x area of the box x solid angle of emission; the area of a line is a part of its
    squared length."""
    x, y, z = size = bounds.box_max[lights].max(0) - bounds.box_min[lights].min(0)
    flux = bounds.flux[lights]
    mean_axis = np.linalg.norm(flux @ bounds.axis[lights]) / flux.sum()
    # A cap of this angle has the mean axis (1 + cos) / 2.
    theta_o = np.arccos(np.clip(2 * mean_axis - 1, -1, 1))
    theta_e = min(bounds.theta_e[lights].max(), np.pi / 2)
    area = x * y + y * z + z * x + 1e-3 * (size**2).sum()
    return flux.sum() * area * orientation_measure(theta_o, theta_e)


def orientation_measure(theta_o, theta_e):
    """Conty and Kulla 2018: the integral over directions of the cosine of the angle beyond
    theta_o, up to theta_e and to the whole sphere."""
    theta_w = min(theta_o + theta_e, np.pi)
    # The antiderivative of cos(x - theta_o) sin x.
    low, high = (-np.cos(2 * x - theta_o) / 4 + x * np.sin(theta_o) / 2 for x in (theta_o, theta_w))
    return 2 * np.pi * (1 - np.cos(theta_o) + high - low)


class Lane:
    """Moments and bounds of a set of local lights, over all of them."""

    def __init__(self, bounds, lights):
        flux, place = bounds.flux[lights], bounds.mean[lights]
        self.flux, self.peak = flux.sum(), bounds.peak[lights].sum()
        share = flux / self.flux
        self.mean = share @ place
        self.variance = share @ (bounds.variance[lights] + ((place - self.mean) ** 2).sum(1))
        emission = (share * bounds.mean_cos[lights]) @ bounds.axis[lights]
        self.mean_cos = np.linalg.norm(emission)
        self.axis = emission / self.mean_cos if self.mean_cos > 0 else ORIGIN
        low, high = bounds.box_min[lights].min(0), bounds.box_max[lights].max(0)
        self.half_extent = np.maximum(high - self.mean, self.mean - low)
        between = np.arccos(np.clip(bounds.axis[lights] @ self.axis, -1, 1))
        self.cone = min(ALL_ROUND, (between + bounds.theta_e[lights]).max())
        fade = bounds.fade[lights[0]] if len(lights) == 1 else np.inf
        self.fade = max(fade, 1 - np.cos(MIN_CONE))

    def importance(self, p, n, cone_slack=0.0):
        """W/m^2 to expect at p on a surface of normal n; 0 only where none can arrive."""
        height, reach = n @ (self.mean - p), np.abs(n) @ self.half_extent
        if height + reach <= 0 or not self._is_within_cone(p, self.cone + cone_slack):
            return 0.0
        return self.intensity(p) * self.received(p, n)

    def received(self, p, n):
        """Irradiance for one W/sr, 1/m^2."""
        height, reach = n @ (self.mean - p), np.abs(n) @ self.half_extent
        mean_sq = ((self.mean - p) ** 2).sum() + VARIANCE_SHARE * self.variance
        lines = height, EDGE_ON * reach + height / 2, BEHIND * reach + BEHIND_SLOPE * height
        return max(lines) / mean_sq**1.5

    def intensity(self, p):
        """W/sr towards p; of a single beam that of its smoothstep, else of a lobe."""
        if self.fade < np.inf:
            t = (self._cos_from_apex(p) - np.cos(max(self.cone, MIN_CONE))) / self.fade
            t = min(max(t, 0.0), 1.0)
            return self.peak * (t * t * (3 - 2 * t) + BEAM_FLOOR_SHARE)
        to_mean = self.mean - p
        dist_sq = to_mean @ to_mean
        mean_cos = min(self.mean_cos, MAX_MEAN_COS) * dist_sq / (dist_sq + self.variance)
        cos_axis = -(self.axis @ to_mean) / np.sqrt(dist_sq + VARIANCE_SHARE * self.variance)
        return self.flux * lobe(mean_cos, cos_axis) + FLOOR_SHARE * self.peak

    def _cos_from_apex(self, p, cone=None):
        """Cosine from the axis under which p is seen from where the cone around all emitters
        starts: behind the ball around the box, which it touches from inside."""
        cone = max(self.cone if cone is None else cone, MIN_CONE)
        from_apex = p - (self.mean - self.axis * np.linalg.norm(self.half_extent) / np.sin(cone))
        return from_apex @ self.axis / np.linalg.norm(from_apex)

    def _is_within_cone(self, p, cone):
        """Whether p sees light of a cone of this angle from anywhere in a ball around the box."""
        return cone >= 3.0 or self._cos_from_apex(p, cone) >= np.cos(max(cone, MIN_CONE))


def lobe(mean_cos, cos_axis):
    """Intensity over flux, 1/sr, of (1 + k/4 (1 - cos))^-4 with integral one over directions."""
    k = mean_cos * (3 - mean_cos**2) / (1 - mean_cos**2)
    # 2 pi times the integral over the cosine from -1 to 1; without k the sphere.
    integral = 8 * np.pi / (3 * k) * (1 - (1 + k / 2) ** -3) if k > 1e-5 else 4 * np.pi
    return (1 + k / 4 * (1 - cos_axis)) ** -4 / integral
