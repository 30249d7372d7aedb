"""Normals of closures: what normal maps and bump maps make of the normal to shade with."""

import math

import numpy as np

from .jit import ONE, TWO, ZERO, called_kernel, kernel
from .scene import COLOR_ATTRIBUTE, FRONT, IMAGE_TEXTURE
from .surface import interpolate3, load_corners
from .textures import image_cell, image_point, mix_cell, take, texture_value, uv_point
from .vec import add, cross, dot, from_frame, load3, madd, max_abs, normalize, scale, sub

EIGHTH = np.float32(0.125)
NO_TEXEL = ZERO, ZERO, ZERO, ZERO
NO_CELL = NO_TEXEL, NO_TEXEL, NO_TEXEL, NO_TEXEL


@called_kernel
def mapped_normal(
    geometry, textures, texture_id, strength, triangle, bary_u, bary_v, wo, n_geo, n_shade, side
):
    """n_shade tilted by a tangent-space normal map: a unit normal on the same side.

    Axes are the direction in which u of the texture's UV map grows, the one across it in which v
    grows, and the interpolated normal; a hit on the back gets the opposite of what the front gets.
    Departure: tangents are those of the triangle alone, in world space. Cycles has them from
    MikkTSpace, averaged with the triangles around each vertex, in the object's own space; both
    agree on flat faces of objects that are not stretched. Without a tangent n_shade stays.
    """
    tangent, sign = triangle_tangent(geometry, textures.uv_map[texture_id], triangle)
    if sign == ZERO:
        return n_shade
    normal = n_geo if side == FRONT else scale(n_geo, -ONE)
    if len(geometry.corner_normals) > 0:
        corners = geometry.corner_normals[triangle]
        normal = interpolate3(corners, bary_u, bary_v)
        t0, t1, t2 = (
            reject(tangent, load3(corners, 0)),
            reject(tangent, load3(corners, 1)),
            reject(tangent, load3(corners, 2)),
        )
        tangent = madd(madd(scale(t0, ONE - bary_u - bary_v), bary_u, t1), bary_v, t2)
    r, g, b = texture_value(geometry, textures, texture_id, triangle, bary_u, bary_v, wo)
    x, y = strength * (TWO * r - ONE), sign * strength * (TWO * g - ONE)
    z = ONE + max(ZERO, min(ONE, strength)) * (TWO * b - TWO)
    n = normalize(from_frame(tangent, cross(normal, tangent), normal, (x, y, z)))
    if not max_abs(n) > ZERO:
        return n_shade
    return n if side == FRONT else scale(n, -ONE)


@kernel
def triangle_tangent(geometry, uv_map, triangle):
    """(unit direction in which u of a UV map grows, sign); the sign is -1 where the map is mirrored
    seen from the front, 0 where it has no area."""
    if uv_map >= len(geometry.uvs):
        return (ZERO, ZERO, ZERO), ZERO
    v0, v1, v2 = load_corners(geometry, triangle)
    uv = geometry.uvs[uv_map, triangle]
    du1, dv1 = uv[1, 0] - uv[0, 0], uv[1, 1] - uv[0, 1]
    du2, dv2 = uv[2, 0] - uv[0, 0], uv[2, 1] - uv[0, 1]
    twice_area = du1 * dv2 - du2 * dv1
    sign = ZERO if twice_area == ZERO else math.copysign(ONE, twice_area)
    along = sub(scale(sub(v1, v0), sign * dv2), scale(sub(v2, v0), sign * dv1))
    return normalize(along), sign


@kernel
def reject(a, n):
    """The direction of the part of a that is perpendicular to the unit vector n."""
    return normalize(madd(a, -dot(a, n), n))


@called_kernel
def bumped_normal(geometry, textures, texture_id, strength, triangle, bary_u, bary_v, n):
    """A unit normal bent as if a bump map's heights rose towards it, whichever side it is on.

    Mikkelsen 2010, Bump Mapping Unparametrized Surfaces on the GPU, along two edges.
    Departure: slopes are those of the texture between its texels. Cycles takes them over a tenth of
    a pixel, which is the same unless that covers some texels.
    """
    v0, v1, v2 = load_corners(geometry, triangle)
    edge_u, edge_v = sub(v1, v0), sub(v2, v0)
    across_v, across_u = cross(edge_v, n), cross(n, edge_u)
    area = dot(edge_u, across_v)
    slope_u, slope_v = height_slopes(geometry, textures, texture_id, triangle, bary_u, bary_v)
    gradient = madd(scale(across_v, slope_u), slope_v, across_u)
    bent = normalize(madd(scale(n, abs(area)), -math.copysign(ONE, area), gradient))
    if max_abs(bent) == ZERO:
        return n
    bent = normalize(add(scale(bent, strength), scale(n, ONE - strength)))
    return bent if max_abs(bent) > ZERO else n


@kernel
def height_slopes(geometry, textures, texture_id, triangle, bary_u, bary_v):
    """How a texture's value grows along the first and the second edge of a triangle, an edge."""
    kind = textures.kind[texture_id]
    source, uv_map = textures.source[texture_id], textures.uv_map[texture_id]
    cell, x, y, width, height = NO_CELL, bary_u, bary_v, ONE, ONE
    if kind == IMAGE_TEXTURE:
        u, v = uv_point(geometry, uv_map, triangle, bary_u, bary_v)
        image_x, image_y = image_point(textures, texture_id, u, v)
        cell, x, y = image_cell(textures, texture_id, image_x, image_y)
        width = np.float32(textures.size[source, 0])
        height = np.float32(textures.size[source, 1])
    elif kind != COLOR_ATTRIBUTE:
        return ZERO, ZERO
    # Between the same texels, where the way is so short that no digits are lost.
    right, left = min(x + EIGHTH, ONE), max(x - EIGHTH, ZERO)
    high, low = min(y + EIGHTH, ONE), max(y - EIGHTH, ZERO)
    rise_x, rise_y = ZERO, ZERO
    for end in range(4):  # a loop, so that what it does is compiled in only once
        is_x, is_plus = end < 2, end % 2 == 0
        at_x = (right if is_plus else left) if is_x else x
        at_y = y if is_x else (high if is_plus else low)
        if kind == IMAGE_TEXTURE:
            rgba = mix_cell(textures, texture_id, cell, at_x, at_y)
        else:
            r, g, b = interpolate3(geometry.colors[source, triangle], at_x, at_y)
            rgba = r, g, b, ONE
        value = take(textures, texture_id, rgba)[0]
        value = value if is_plus else -value
        if is_x:
            rise_x += value
        else:
            rise_y += value
    factor = textures.scale[texture_id, 0]
    slope_x = factor * width * rise_x / (right - left)
    slope_y = factor * height * rise_y / (high - low)
    if kind == COLOR_ATTRIBUTE:
        return slope_x, slope_y
    m, uv = textures.image_from_uv[texture_id], geometry.uvs[uv_map, triangle]
    along_u = slope_x * m[0, 0] + slope_y * m[1, 0]
    along_v = slope_x * m[0, 1] + slope_y * m[1, 1]
    return (
        along_u * (uv[1, 0] - uv[0, 0]) + along_v * (uv[1, 1] - uv[0, 1]),
        along_u * (uv[2, 0] - uv[0, 0]) + along_v * (uv[2, 1] - uv[0, 1]),
    )
