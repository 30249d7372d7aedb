"""Random numbers as a pure function of (seed, pixel, sample, dimension), and the warps.

The numbers are Owen-scrambled Sobol points, shuffled for every pixel and dimension, so samples of
a pixel are stratified among each other and any sample can be computed alone. Burley 2020,
Practical Hash-based Owen Scrambling; hash and permutation constants by Vegdahl.
Each `sample_` warp has a `pdf_` twin, a density over solid angle.
"""

import math

import numpy as np

from .jit import HALF, INV_PI, ONE, PI, TWO, TWO_PI, ZERO, kernel

# Dimensions of one path vertex. PIXEL, LIGHT_POINT, BSDF and LENS are pairs.
PIXEL, LIGHT_PICK, LIGHT_POINT, BSDF, ROULETTE, LOBE, LENS = range(7)
DIMS_PER_VERTEX = 8

MASK = np.uint64(0xFFFFFFFF)


@kernel
def dim(depth, kind):
    """Number of a dimension; depth counts the vertices of the path from the camera's hit."""
    return depth * DIMS_PER_VERTEX + kind


@kernel
def hash32(x):
    """Mix the low 32 bits of x; uint64 in and out. Wellons' lowbias32."""
    x = (x ^ (x >> np.uint64(16))) * np.uint64(0x7FEB352D) & MASK
    x = (x ^ (x >> np.uint64(15))) * np.uint64(0x846CA68B) & MASK
    return x ^ (x >> np.uint64(16))


@kernel
def sampler_key(seed, pixel, dimension):
    """The 32 bits that tell one random sequence from all others."""
    key = hash32(np.uint64(seed) + np.uint64(0x9E3779B9) & MASK)
    key = hash32(key ^ np.uint64(pixel))
    return hash32(key ^ np.uint64(dimension) << np.uint64(16))


@kernel
def reverse_bits(x):
    """The low 32 bits in opposite order."""
    x = (x >> np.uint64(1)) & np.uint64(0x55555555) | (x & np.uint64(0x55555555)) << np.uint64(1)
    x = (x >> np.uint64(2)) & np.uint64(0x33333333) | (x & np.uint64(0x33333333)) << np.uint64(2)
    x = (x >> np.uint64(4)) & np.uint64(0x0F0F0F0F) | (x & np.uint64(0x0F0F0F0F)) << np.uint64(4)
    x = (x >> np.uint64(8)) & np.uint64(0x00FF00FF) | (x & np.uint64(0x00FF00FF)) << np.uint64(8)
    return (x >> np.uint64(16)) | (x & np.uint64(0xFFFF)) << np.uint64(16)


@kernel
def owen_permute(x, key):
    """A permutation in which each bit depends on lower bits alone (Laine-Karras, by Vegdahl)."""
    x ^= x * np.uint64(0x3D20ADEA) & MASK
    x = x + key & MASK
    x = x * (key >> np.uint64(16) | np.uint64(1)) & MASK
    x ^= x * np.uint64(0x05526C56) & MASK
    return x ^ (x * np.uint64(0x53A22864) & MASK)


@kernel
def sobol_index(sample, key):
    """The sample's place in a shuffled sequence; aligned runs of 2^k samples stay together."""
    return reverse_bits(owen_permute(reverse_bits(np.uint64(sample)), key))


@kernel
def pascal(x):
    """The second coordinate of the Sobol point with index x, its bits in reverse order."""
    x ^= x >> np.uint64(16)
    x ^= (x & np.uint64(0xFF00FF00)) >> np.uint64(8)
    x ^= (x & np.uint64(0xF0F0F0F0)) >> np.uint64(4)
    x ^= (x & np.uint64(0xCCCCCCCC)) >> np.uint64(2)
    return x ^ (x & np.uint64(0xAAAAAAAA)) >> np.uint64(1)


@kernel
def to_unit(bits):
    """32 bits as a float32 in [0, 1)."""
    return np.float32(bits >> np.uint64(8)) * np.float32(2**-24)


@kernel
def uniform(seed, pixel, sample, dimension):
    """A float64 in [0, 1) with 53 random bits, so that it lasts for a descent of many levels."""
    key = sampler_key(seed, pixel, dimension)
    index = sobol_index(sample, key)
    high = reverse_bits(owen_permute(index, hash32(key ^ np.uint64(0x1B873593))))
    low = hash32(key ^ hash32(index + np.uint64(0x632BE5AB) & MASK))
    return (np.float64(high) + np.float64(low >> np.uint64(11)) * 2.0**-21) * 2.0**-32


@kernel
def uniform_pair(seed, pixel, sample, dimension):
    """Two float32 in [0, 1): a point of a (0, 2)-sequence."""
    key = sampler_key(seed, pixel, dimension)
    index = sobol_index(sample, key)
    x = reverse_bits(owen_permute(index, hash32(key ^ np.uint64(0x1B873593))))
    y = reverse_bits(owen_permute(pascal(index), hash32(key ^ np.uint64(0xCC9E2D51))))
    return to_unit(x), to_unit(y)


@kernel
def sample_disk(u):
    """A uniform point of the unit disk, (x, y), by Shirley and Chiu's concentric map."""
    a, b = TWO * u[0] - ONE, TWO * u[1] - ONE
    if a == ZERO and b == ZERO:
        return ZERO, ZERO
    if abs(a) > abs(b):
        r, phi = a, PI / np.float32(4) * (b / a)
    else:
        r, phi = b, PI / TWO - PI / np.float32(4) * (a / b)
    return r * math.cos(phi), r * math.sin(phi)


@kernel
def sample_cosine_hemisphere(u):
    """A unit vector about +Z with density cos / pi."""
    x, y = sample_disk(u)
    return x, y, math.sqrt(max(ZERO, ONE - x * x - y * y))


@kernel
def pdf_cosine_hemisphere(cos_theta):
    return max(ZERO, cos_theta) * INV_PI


@kernel
def sample_cone(u, one_minus_cos):
    """A uniform direction in a cone about +Z; also 1 - cos of its angle, exact near the axis.

    one_minus_cos: 1 - cos of half the cone's angle; 2 is the whole sphere.
    """
    height = u[0] * one_minus_cos
    sin_theta = math.sqrt(max(ZERO, height * (TWO - height)))
    phi = TWO_PI * u[1]
    return (sin_theta * math.cos(phi), sin_theta * math.sin(phi), ONE - height), height


@kernel
def pdf_cone(one_minus_cos):
    return ONE / (TWO_PI * one_minus_cos)


@kernel
def sample_triangle(u):
    """Barycentric coordinates (b1, b2) of a uniform point, by Heitz' low-distortion map."""
    if u[1] > u[0]:
        b1 = u[0] * HALF
        return b1, u[1] - b1
    b2 = u[1] * HALF
    return u[0] - b2, b2
