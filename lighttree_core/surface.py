"""The geometry of a hit: which side, from where to go on, and the normals to shade with."""

from .jit import ONE, ZERO, kernel
from .scene import BACK, FRONT
from .vec import cross, dot, load3, madd, max_abs, normalize, offset_point, scale, sub


@kernel
def load_corners(geometry, triangle):
    """The three vertices of a triangle."""
    vertices, ids = geometry.vertices, geometry.triangles[triangle]
    return load3(vertices, ids[0]), load3(vertices, ids[1]), load3(vertices, ids[2])


@kernel
def hit_side(geometry, triangle, direction):
    """The side of a triangle that a ray meets, FRONT or BACK."""
    v0, v1, v2 = load_corners(geometry, triangle)
    return BACK if dot(cross(sub(v1, v0), sub(v2, v0)), direction) > ZERO else FRONT


@kernel
def load_surface(geometry, triangle, bary_u, bary_v, direction):
    """Where a ray met a triangle: (p_front, p_back, n_geo, n_shade, side).

    p_front and p_back are safe to start the next ray from, on the side the ray came from and on
    the other one. n_geo faces the ray. n_shade is interpolated and lies on the side of n_geo as far
    as the normals at the corners lie on the front; it may face away from the ray.
    """
    v0, v1, v2 = load_corners(geometry, triangle)
    side = hit_side(geometry, triangle, direction)
    n_front = normalize(cross(sub(v1, v0), sub(v2, v0)))
    n_geo = n_front if side == FRONT else scale(n_front, -ONE)
    n_shade = shading_normal(geometry, triangle, bary_u, bary_v, n_geo, side)
    # Barycentric coordinates place p on the triangle; along the ray it would miss by more.
    p = madd(madd(scale(v0, ONE - bary_u - bary_v), bary_u, v1), bary_v, v2)
    reach = max(max_abs(v0), max_abs(v1), max_abs(v2))
    p_front, p_back = offset_point(p, n_geo, reach), offset_point(p, n_geo, -reach)
    return p_front, p_back, n_geo, n_shade, side


@kernel
def shading_normal(geometry, triangle, bary_u, bary_v, n_geo, side):
    """Unit normal to shade with at a point of a triangle, on the given side of it."""
    if len(geometry.corner_normals) == 0:
        return n_geo
    n = normalize(interpolate3(geometry.corner_normals[triangle], bary_u, bary_v))
    if max_abs(n) == ZERO:
        return n_geo
    return n if side == FRONT else scale(n, -ONE)


@kernel
def interpolate3(corners, bary_u, bary_v):
    """The vec3 at a point of a triangle whose corners have the three rows of `corners`."""
    first = scale(load3(corners, 0), ONE - bary_u - bary_v)
    return madd(madd(first, bary_u, load3(corners, 1)), bary_v, load3(corners, 2))


@kernel
def facing_cosine(geometry, triangle, bary_u, bary_v, direction):
    """Cosine between a unit direction and the normal to shade with, seen from either side."""
    v0, v1, v2 = load_corners(geometry, triangle)
    n_front = normalize(cross(sub(v1, v0), sub(v2, v0)))
    n = shading_normal(geometry, triangle, bary_u, bary_v, n_front, FRONT)
    return min(abs(dot(n, direction)), ONE)
