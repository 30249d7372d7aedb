"""Vectors in kernels: tuples of three float32, and the few operations on them."""

import math

import numpy as np

from .jit import ONE, ROUNDING_BOUND, ZERO, kernel

THIRD = np.float32(1 / 3)
LUMINANCE = (np.float32(0.2126), np.float32(0.7152), np.float32(0.0722))


@kernel
def load3(table, i):
    """Row i of an (n, 3) array as a vec3."""
    return table[i, 0], table[i, 1], table[i, 2]


@kernel
def store3(table, i, a):
    """Write a vec3 to row i of an (n, 3) array."""
    table[i, 0], table[i, 1], table[i, 2] = a


@kernel
def add3(table, i, a):
    """Add a vec3 to row i of an (n, 3) array."""
    table[i, 0] += a[0]
    table[i, 1] += a[1]
    table[i, 2] += a[2]


@kernel
def add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def sub(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def mul(a, b):
    """Component by component, as colours multiply."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@kernel
def scale(a, s):
    return a[0] * s, a[1] * s, a[2] * s


@kernel
def madd(a, s, b):
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@kernel
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def length(a):
    return math.sqrt(dot(a, a))


@kernel
def normalize(a):
    """a / |a|; the zero vector, and one too short to tell, comes back as (0, 0, 0)."""
    len_sq = dot(a, a)
    if len_sq <= ZERO:
        return ZERO, ZERO, ZERO
    return scale(a, ONE / math.sqrt(len_sq))


@kernel
def max_abs(a):
    """The largest absolute component."""
    return max(abs(a[0]), abs(a[1]), abs(a[2]))


@kernel
def mean(a):
    """The mean of the components."""
    return (a[0] + a[1] + a[2]) * THIRD


@kernel
def luminance(rgb):
    """Relative luminance of linear Rec.709."""
    return dot(rgb, LUMINANCE)


@kernel
def frame(w):
    """Two unit vectors that make a right-handed orthonormal basis with the unit vector w.

    Duff et al. 2017, Building an Orthonormal Basis, Revisited.
    """
    sign = math.copysign(ONE, w[2])
    a = -ONE / (sign + w[2])
    b = w[0] * w[1] * a
    return (
        (ONE + sign * w[0] * w[0] * a, sign * b, -sign * w[0]),
        (b, sign + w[1] * w[1] * a, -w[1]),
    )


@kernel
def from_frame(u, v, w, a):
    """The world vector with the coordinates a in the basis u, v, w."""
    return madd(madd(scale(u, a[0]), a[1], v), a[2], w)


@kernel
def offset_point(p, n, reach):
    """p moved along n far enough that a ray leaving there cannot meet p's own surface again.

    reach: the largest absolute coordinate among the triangle's vertices and of whatever point the
    ray comes from or goes to: float32 evaluates the plane of the triangle no better than that
    times `ROUNDING_BOUND`.
    """
    return madd(p, reach * ROUNDING_BOUND, n)
