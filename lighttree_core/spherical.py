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
ROUNDING = 1e-12  # of an angle in a rectangle's corner, at most


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
def _side_plane(x, z0):
    """The plane through the shading point and a side of the rectangle: (z of its unit normal, the
    square of the normal's other part)."""
    inv_sq = 1.0 / (x * x + z0 * z0)
    return x * math.sqrt(inv_sq), z0 * z0 * inv_sq


@kernel
def _corner_angle(a, b):
    """(cosine, sine) of the angle inside the corner between two sides; nothing is subtracted."""
    return -a[0] * b[0], math.sqrt(a[1] + a[0] * a[0] * b[1])


@kernel
def _add_angles(a, b):
    """(cosine, sine) of the sum of two angles given so."""
    return a[0] * b[0] - a[1] * b[1], a[1] * b[0] + a[0] * b[1]


@kernel
def _rectangle_angles(x0, y0, x1, y1, z0):
    """(solid angle, b0, b1, (cosine, sine) of g2 + g3) of Urena's parametrization."""
    n0, n1 = _side_plane(-y0, z0), _side_plane(x1, z0)
    n2, n3 = _side_plane(y1, z0), _side_plane(-x0, z0)
    behind = _add_angles(_corner_angle(n2, n3), _corner_angle(n3, n0))
    ahead = _add_angles(_corner_angle(n0, n1), _corner_angle(n1, n2))
    # The sum of all four, which exceeds a whole turn by the solid angle.
    cosine, sine = _add_angles(ahead, behind)
    omega = math.atan2(sine, cosine)
    return omega + 2.0 * math.pi if omega < -ROUNDING else omega, n0[0], n2[0], behind


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
    """(uniform unit direction, float64, within a rectangle, its solid angle); no direction where
    that is 0."""
    x, y, z, x0, y0, x1, y1, z0 = _rectangle_frame(corner, axis_u, axis_v)
    if z0 == 0.0:
        return z, 0.0
    omega, b0, b1, behind = _rectangle_angles(x0, y0, x1, y1, z0)
    if not omega > MIN_SOLID_ANGLE:
        return z, 0.0
    phi = np.float64(u0) * omega
    cos_au, sin_au = _add_angles((math.cos(phi), math.sin(phi)), (behind[0], -behind[1]))
    fu = (cos_au * b0 - b1) / sin_au if sin_au != 0.0 else 1e300
    cu = math.copysign(1.0, fu) / math.sqrt(fu * fu + b0 * b0)
    cu = min(1.0, max(-1.0, cu))
    xu = -(cu * z0) / max(1e-300, math.sqrt(1.0 - cu * cu))
    xu = min(x1, max(x0, xu))
    d = math.sqrt(xu * xu + z0 * z0)
    h0, h1 = y0 / math.sqrt(d * d + y0 * y0), y1 / math.sqrt(d * d + y1 * y1)
    hv = h0 + u1 * (h1 - h0)
    yv = hv * d / math.sqrt(1.0 - hv * hv) if hv * hv < 1.0 else y1
    yv = min(y1, max(y0, yv))
    return _unit64(from_frame(x, y, z, (xu, yv, z0))), omega
