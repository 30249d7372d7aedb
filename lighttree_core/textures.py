"""Textures: the value of an image, a colour attribute or a cosine at a point of a triangle.

Images are looked up as Cycles does: texel centres lie at half numbers, colours stay encoded while
they are interpolated, and what lies beyond a border is decided for each texel on its own.
"""

import math

import numpy as np

from .jit import HALF, ONE, ZERO, called_kernel, kernel
from .scene import (
    BLUE,
    CLIP,
    COLOR_ATTRIBUTE,
    EXTEND,
    FACING,
    GREEN,
    LINEAR,
    LUMINANCE_OF_RGB,
    OPACITY,
    REPEAT,
    RGB,
    Textures,
)
from .surface import facing_cosine, interpolate3
from .tables import column_table
from .vec import add, load3, luminance, mul

ONE_BYTE = np.float32(1 / 255)

# `scene.Textures` for kernels.
TextureTable = column_table("TextureTable", Textures, __name__)


@called_kernel
def texture_value(geometry, textures, texture_id, triangle, bary_u, bary_v, direction):
    """bias + scale x what a texture has at a point of a triangle: (r, g, b).

    direction: of the ray that sees it, unit, either way round. Inputs that are numbers take r; of
    all outputs but RGB, r = g = b.
    """
    kind = textures.kind[texture_id]
    if kind == FACING:
        cosine = facing_cosine(geometry, triangle, bary_u, bary_v, direction)
        rgba = cosine, cosine, cosine, ONE
    elif kind == COLOR_ATTRIBUTE:
        color = interpolate3(geometry.colors[textures.source[texture_id], triangle], bary_u, bary_v)
        rgba = color[0], color[1], color[2], ONE
    else:
        u, v = uv_point(geometry, textures.uv_map[texture_id], triangle, bary_u, bary_v)
        x, y = image_point(textures, texture_id, u, v)
        rgba = image_value(textures, texture_id, x, y)
    taken = take(textures, texture_id, rgba)
    return add(load3(textures.bias, texture_id), mul(load3(textures.scale, texture_id), taken))


@kernel
def uv_point(geometry, uv_map, triangle, bary_u, bary_v):
    """Where in a UV map a point of a triangle lies: (u, v)."""
    uv = geometry.uvs[uv_map, triangle]
    rest = ONE - bary_u - bary_v
    u = rest * uv[0, 0] + bary_u * uv[1, 0] + bary_v * uv[2, 0]
    v = rest * uv[0, 1] + bary_u * uv[1, 1] + bary_v * uv[2, 1]
    return u, v


@kernel
def image_point(textures, texture_id, u, v):
    """Where in the image of a texture a point (u, v) lies; (0, 0) is its lower left corner, (1, 1)
    the upper right one."""
    m = textures.image_from_uv[texture_id]
    return m[0, 0] * u + m[0, 1] * v + m[0, 2], m[1, 0] * u + m[1, 1] * v + m[1, 2]


@kernel
def image_value(textures, texture_id, x, y):
    """RGBA, its colours linear, of the image of a texture at a point (x, y), see `image_point`."""
    cell, tx, ty = image_cell(textures, texture_id, x, y)
    return mix_cell(textures, texture_id, cell, tx, ty)


@kernel
def image_cell(textures, texture_id, x, y):
    """The texels around a point of an image and where it lies between them, as for `mix_cell`."""
    image, extension = textures.source[texture_id], textures.extension[texture_id]
    width, height = np.int64(textures.size[image, 0]), np.int64(textures.size[image, 1])
    x, y = x * np.float32(width), y * np.float32(height)
    is_linear = textures.interpolation[texture_id] == LINEAR
    if is_linear:
        x, y = x - HALF, y - HALF
    i, j = math.floor(x), math.floor(y)
    left, lower = wrap_texel(i, width, extension), wrap_texel(j, height, extension)
    below_left = load_texel(textures, image, left, lower)
    if not is_linear:
        return (below_left, below_left, below_left, below_left), ZERO, ZERO
    right, upper = wrap_texel(i + 1, width, extension), wrap_texel(j + 1, height, extension)
    below_right = load_texel(textures, image, right, lower)
    above_left = load_texel(textures, image, left, upper)
    above_right = load_texel(textures, image, right, upper)
    cell = below_left, below_right, above_left, above_right
    return cell, x - np.float32(i), y - np.float32(j)


@kernel
def mix_cell(textures, texture_id, cell, tx, ty):
    """Linear RGBA between four encoded texels: tx of the way to the right, ty of that upwards."""
    below_left, below_right, above_left, above_right = cell
    rgba = mix4(mix4(below_left, below_right, tx), mix4(above_left, above_right, tx), ty)
    if textures.divides_alpha[texture_id] and rgba[3] != ZERO:
        rgba = rgba[0] / rgba[3], rgba[1] / rgba[3], rgba[2] / rgba[3], rgba[3]
    if textures.is_srgb[textures.source[texture_id]]:
        return decode_srgb(rgba[0]), decode_srgb(rgba[1]), decode_srgb(rgba[2]), rgba[3]
    return rgba


@kernel
def wrap_texel(i, num, extension):
    """Which of `num` columns or rows of an image stands for the i-th, any integer; -1 for none."""
    if extension == REPEAT:
        return i % num
    if extension == EXTEND:
        return min(max(i, 0), num - 1)
    if extension == CLIP:
        return i if 0 <= i < num else -1
    i = i % (2 * num)
    return min(i, 2 * num - 1 - i)


@kernel
def load_texel(textures, image, column, row):
    """RGBA of a texel, as it is encoded, bytes from 0 to 1; 0 if column or row is -1."""
    if column < 0 or row < 0:
        return ZERO, ZERO, ZERO, ZERO
    i = textures.first_texel[image] + row * np.int64(textures.size[image, 0]) + column
    if textures.is_float[image]:
        t = textures.float_texels
        return t[i, 0], t[i, 1], t[i, 2], t[i, 3]
    t = textures.texels
    return (
        np.float32(t[i, 0]) * ONE_BYTE,
        np.float32(t[i, 1]) * ONE_BYTE,
        np.float32(t[i, 2]) * ONE_BYTE,
        np.float32(t[i, 3]) * ONE_BYTE,
    )


@kernel
def mix4(a, b, t):
    """(1 - t) a + t b of two RGBA."""
    s = ONE - t
    return (
        s * a[0] + t * b[0],
        s * a[1] + t * b[1],
        s * a[2] + t * b[2],
        s * a[3] + t * b[3],
    )


@kernel
def decode_srgb(x):
    """The linear value of a number encoded by the sRGB curve, IEC 61966-2-1."""
    if x < np.float32(0.04045):
        return max(x, ZERO) * np.float32(1 / 12.92)
    return ((x + np.float32(0.055)) * np.float32(1 / 1.055)) ** np.float32(2.4)


@kernel
def take(textures, texture_id, rgba):
    """What is taken of a colour for a texture, as (r, g, b)."""
    r, g, b, opacity = rgba
    output = textures.output[texture_id]
    if output != RGB:
        x = r
        if output == OPACITY:
            x = opacity
        elif output == LUMINANCE_OF_RGB:
            x = luminance((r, g, b))
        elif output == GREEN:
            x = g
        elif output == BLUE:
            x = b
        r, g, b = x, x, x
    return through_curve(textures, texture_id, (r, g, b))


@kernel
def through_curve(textures, texture_id, taken):
    """What a texture's curve, if it has one, makes of each of three numbers."""
    image = textures.curve[texture_id]
    if image < 0:
        return taken
    first, last = textures.first_texel[image], np.int64(textures.size[image, 0]) - 1
    return (
        curve_value(textures.float_texels, first, last, taken[0], 0),
        curve_value(textures.float_texels, first, last, taken[1], 1),
        curve_value(textures.float_texels, first, last, taken[2], 2),
    )


@kernel
def curve_value(texels, first, last, x, channel):
    """A channel of the row of texels first to first + last, at x of its length, 0 to 1."""
    place = min(max(x, ZERO), ONE) * np.float32(last)
    i = min(np.int64(place), last - 1)
    t = place - np.float32(i)
    return (ONE - t) * texels[first + i, channel] + t * texels[first + i + 1, channel]
