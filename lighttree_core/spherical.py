"""Uniform sampling of the solid angle of a triangle and of a rectangle, in float64.

Used where a light looks large, so the cost is small and precision is worth more. Both take their
corners relative to the shading point. A solid angle too small to be told from rounding is
returned as 0: callers then sample the area instead.
Triangle: Arvo 1995, Stratified Sampling of Spherical Triangles; solid angle by Van Oosterom and
Strackee 1983. Rectangle: Urena et al. 2013, An Area-Preserving Parametrization for Spherical
Rectangles.
"""

import math

import numpy as np

from .jit import kernel
from .vec import add, cross, dot, from_frame, madd, scale

MIN_SOLID_ANGLE = 1e-5


@kernel
def _unit64(a):
    """a / |a| in float64, zero if a is. Not float(): compiled, that leaves a float32 as it is."""
    a = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    len_sq = dot(a, a)
    return scale(a, np.float64(1.0) / math.sqrt(len_sq)) if len_sq > 0.0 else a


@kernel
def _reject(a, b):
    """The unit vector along a's part orthogonal to the unit vector b."""
    return _unit64(madd(a, -dot(a, b), b))


@kernel
def solid_angle_triangle(v0, v1, v2):
    """Solid angle of a triangle, its corners relative to the shading point; 0 if too small."""
    a, b, c = _unit64(v0), _unit64(v1), _unit64(v2)
    volume = abs(dot(a, cross(b, c)))
    omega = 2.0 * math.atan2(volume, 1.0 + dot(a, b) + dot(b, c) + dot(c, a))
    return omega if omega > MIN_SOLID_ANGLE else 0.0


@kernel
def sample_spherical_triangle(v0, v1, v2, omega, u0, u1):
    """A uniform unit direction (float64) within a triangle of the solid angle omega > 0."""
    a, b, c = _unit64(v0), _unit64(v1), _unit64(v2)
    cos_c = dot(a, b)
    # The angle at a, between the planes of its two sides.
    n_ab, n_ac = _unit64(cross(a, b)), _unit64(cross(a, c))
    cos_alpha = min(1.0, max(-1.0, dot(n_ab, n_ac)))
    sin_alpha = math.sqrt(1.0 - cos_alpha * cos_alpha)
    # Cut off a triangle a, b, c_hat of area u0 omega: find c_hat on the side from a to c.
    phi = np.float64(u0) * omega
    sin_phi, cos_phi = math.sin(phi), math.cos(phi)
    s = sin_phi * cos_alpha - cos_phi * sin_alpha
    t = cos_phi * cos_alpha + sin_phi * sin_alpha
    u = t - cos_alpha
    v = s + sin_alpha * cos_c
    denominator = (v * s + u * t) * sin_alpha
    q = ((v * t - u * s) * cos_alpha - v) / denominator if denominator != 0.0 else 1.0
    q = min(1.0, max(-1.0, q))
    side = _reject(c, a)
    r = math.sqrt(1.0 - q * q)
    c_hat = add(scale(a, q), scale(side, r))
    # Then a point on the arc from b to c_hat.
    z = 1.0 - u1 * (1.0 - dot(c_hat, b))
    side = _reject(c_hat, b)
    r = math.sqrt(max(0.0, 1.0 - z * z))
    return add(scale(b, z), scale(side, r))


@kernel
def _rectangle_frame(corner, axis_u, axis_v):
    """The rectangle in a frame with its sides along x and y: (x, y, z, x0, y0, x1, y1, z0)."""
    x, y = _unit64(axis_u), _unit64(axis_v)
    z = cross(x, y)
    z0 = dot(corner, z)
    if z0 > 0.0:
        z, z0 = scale(z, -1.0), -z0
    x0, y0 = dot(corner, x), dot(corner, y)
    return x, y, z, x0, y0, x0 + dot(axis_u, x), y0 + dot(axis_v, y), z0


@kernel
def _rectangle_angles(x0, y0, x1, y1, z0):
    """(solid angle, b0, b1, k) of Urena's parametrization."""
    # z of the unit normals of the planes through the shading point and each side.
    z_n0 = -y0 / math.hypot(z0, y0)
    z_n1 = x1 / math.hypot(z0, x1)
    z_n2 = y1 / math.hypot(z0, y1)
    z_n3 = -x0 / math.hypot(z0, x0)
    g0 = math.acos(min(1.0, max(-1.0, -z_n0 * z_n1)))
    g1 = math.acos(min(1.0, max(-1.0, -z_n1 * z_n2)))
    g2 = math.acos(min(1.0, max(-1.0, -z_n2 * z_n3)))
    g3 = math.acos(min(1.0, max(-1.0, -z_n3 * z_n0)))
    k = 2.0 * math.pi - g2 - g3
    return g0 + g1 - k, z_n0, z_n2, k


@kernel
def solid_angle_rectangle(corner, axis_u, axis_v):
    """Solid angle of a rectangle, its corner relative to the shading point; 0 if too small."""
    _, _, _, x0, y0, x1, y1, z0 = _rectangle_frame(corner, axis_u, axis_v)
    if z0 == 0.0:
        return 0.0
    omega = _rectangle_angles(x0, y0, x1, y1, z0)[0]
    return omega if omega > MIN_SOLID_ANGLE else 0.0


@kernel
def sample_spherical_rectangle(corner, axis_u, axis_v, u0, u1):
    """A uniform unit direction (float64) within a rectangle whose solid angle is not 0."""
    x, y, z, x0, y0, x1, y1, z0 = _rectangle_frame(corner, axis_u, axis_v)
    omega, b0, b1, k = _rectangle_angles(x0, y0, x1, y1, z0)
    au = np.float64(u0) * omega + k
    sin_au = math.sin(au)
    fu = (math.cos(au) * b0 - b1) / sin_au if sin_au != 0.0 else 1e300
    cu = math.copysign(1.0, fu) / math.sqrt(fu * fu + b0 * b0)
    cu = min(1.0, max(-1.0, cu))
    xu = -(cu * z0) / max(1e-300, math.sqrt(1.0 - cu * cu))
    xu = min(x1, max(x0, xu))
    d = math.sqrt(xu * xu + z0 * z0)
    h0, h1 = y0 / math.hypot(d, y0), y1 / math.hypot(d, y1)
    hv = h0 + u1 * (h1 - h0)
    yv = hv * d / math.sqrt(1.0 - hv * hv) if hv * hv < 1.0 else y1
    yv = min(y1, max(y0, yv))
    return _unit64(from_frame(x, y, z, (xu, yv, z0)))
