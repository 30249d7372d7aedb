"""The geometry of a hit: which side, from where to go on, and the normals to shade with."""

import math

from .features import is_on
from .jit import ONE, TWO, ZERO, kernel
from .scene import BACK, FRONT
from .textures import interpolate3, texture_value
from .vec import cross, dot, from_frame, load3, madd, max_abs, normalize, offset_point, scale, sub


@kernel
def load_corners(world, triangle):
    """The three vertices of a triangle."""
    vertices, ids = world.vertices, world.triangles[triangle]
    return load3(vertices, ids[0]), load3(vertices, ids[1]), load3(vertices, ids[2])


@kernel
def hit_side(world, triangle, direction):
    """The side of a triangle that a ray meets, FRONT or BACK."""
    v0, v1, v2 = load_corners(world, triangle)
    return BACK if dot(cross(sub(v1, v0), sub(v2, v0)), direction) > ZERO else FRONT


@kernel
def load_surface(world, triangle, bary_u, bary_v, direction):
    """Where a ray met a triangle: (p_front, p_back, n_geo, n_shade, side).

    p_front and p_back are safe to start the next ray from, on the side the ray came from and on
    the other one. n_geo faces the ray. n_shade is interpolated and lies on the side of n_geo as far
    as the normals at the corners lie on the front; it may face away from the ray.
    """
    v0, v1, v2 = load_corners(world, triangle)
    side = hit_side(world, triangle, direction)
    n_front = normalize(cross(sub(v1, v0), sub(v2, v0)))
    n_geo = n_front if side == FRONT else scale(n_front, -ONE)
    n_shade = shading_normal(world, triangle, bary_u, bary_v, n_geo, side)
    # Barycentric coordinates place p on the triangle; along the ray it would miss by more.
    p = madd(madd(scale(v0, ONE - bary_u - bary_v), bary_u, v1), bary_v, v2)
    reach = max(max_abs(v0), max_abs(v1), max_abs(v2))
    p_front, p_back = offset_point(p, n_geo, reach), offset_point(p, n_geo, -reach)
    return p_front, p_back, n_geo, n_shade, side


@kernel
def shading_normal(world, triangle, bary_u, bary_v, n_geo, side):
    """Unit normal to shade with at a point of a triangle, on the given side of it."""
    if not is_on(world.features.smooth_normals):
        return n_geo
    n = normalize(interpolate3(world.corner_normals[triangle], bary_u, bary_v))
    if max_abs(n) == ZERO:
        return n_geo
    return n if side == FRONT else scale(n, -ONE)


@kernel
def mapped_normal(world, texture_id, strength, triangle, bary_u, bary_v, n_geo, n_shade, side):
    """n_shade tilted by a tangent-space normal map: a unit normal on the same side.

    Axes are the direction in which u of the texture's UV map grows, the one across it in which v
    grows, and the interpolated normal; a hit on the back gets the opposite of what the front gets.
    Departure: tangents are those of the triangle alone, in world space. Cycles has them from
    MikkTSpace, averaged with the triangles around each vertex, in the object's own space; both
    agree on flat faces of objects that are not stretched. Without a tangent n_shade stays.
    """
    tangent, sign = triangle_tangent(world, world.textures.uv_map[texture_id], triangle)
    if sign == ZERO:
        return n_shade
    normal = n_geo if side == FRONT else scale(n_geo, -ONE)
    if is_on(world.features.smooth_normals):
        corners = world.corner_normals[triangle]
        normal = interpolate3(corners, bary_u, bary_v)
        t0, t1, t2 = (
            reject(tangent, load3(corners, 0)),
            reject(tangent, load3(corners, 1)),
            reject(tangent, load3(corners, 2)),
        )
        tangent = madd(madd(scale(t0, ONE - bary_u - bary_v), bary_u, t1), bary_v, t2)
    r, g, b = texture_value(world, texture_id, triangle, bary_u, bary_v)
    x, y = strength * (TWO * r - ONE), sign * strength * (TWO * g - ONE)
    z = ONE + max(ZERO, min(ONE, strength)) * (TWO * b - TWO)
    n = normalize(from_frame(tangent, cross(normal, tangent), normal, (x, y, z)))
    if not max_abs(n) > ZERO:
        return n_shade
    return n if side == FRONT else scale(n, -ONE)


@kernel
def triangle_tangent(world, uv_map, triangle):
    """(unit direction in which u of a UV map grows, sign); the sign is -1 where the map is mirrored
    seen from the front, 0 where it has no area."""
    if uv_map >= len(world.uvs):
        return (ZERO, ZERO, ZERO), ZERO
    v0, v1, v2 = load_corners(world, triangle)
    uv = world.uvs[uv_map, triangle]
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
