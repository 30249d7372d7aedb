"""Lamps as rays meet them: exact intersections, and shapes around lamps for Embree to find.

Lamps hide nothing, not even each other, so a ray goes on behind every lamp. Around each lamp with
extent lies an octahedron, perhaps a flat one, a little larger than the lamp. A ray meets that lamp
where it enters the octahedron, or leaves it having started inside, and `intersect_lamp` tells
whether it truly does. Lamps at one place get octahedra of different sizes, or a ray that has gone
on behind one would miss the other. It still does where the surfaces of two cross, to within the
rounding of coordinates.
"""

import math
from typing import NamedTuple

import numpy as np

from .jit import HALF, ONE, ROUNDING_BOUND, ZERO, f32, i32, i64, kernel, table
from .lights import Lights
from .scene import ALL_RAYS, BACKGROUND, DIFFUSE_RAY, DISK, ELLIPSE, POINT, RECTANGLE, SUN, TRIANGLE
from .vec import cross, dot, length, load3, madd, max_abs, offset_point, scale, sub

NO_HIT = np.float32(-1)
SEEN_RAYS = ALL_RAYS & ~DIFFUSE_RAY
THICKNESS = 1 / 8  # of the octahedron of a flat lamp, over its shorter side
NUM_FACES = 8
# Steps by which octahedra of lamps at one place, and those of neighbours, differ.
STEP, NUM_STEPS = 4 * float(ROUNDING_BOUND), 5


@table
class LampShapes(NamedTuple):
    """Octahedra around S lamps; row s has the triangles NUM_FACES s and following.

    vertices: (6 S, 3). triangles: (8 S, 3) int32. lamp: (S,) int32 row of Lights. center: (S, 3).
    local_from_world: (S, 3, 3), the corners lie on the axes at 1 and -1, where the sum of absolute
    coordinates is 1, as on all of the surface. slack: how far beyond what stops a ray it is to be
    followed: an octahedron in which it starts may end there. rays: bits of those that look for
    lamps.
    """

    vertices: f32[:, ::1]
    triangles: i32[:, ::1]
    lamp: i32[::1]
    center: f32[:, ::1]
    local_from_world: f32[:, :, ::1]
    slack: f32
    rays: i64


def build_lamp_shapes(lights: Lights, rays: int = SEEN_RAYS) -> LampShapes:
    """Shapes of all lamps that rays of these kinds see; of suns none, as they are nowhere."""
    has_shape = ~np.isin(lights.kind, (POINT, SUN, TRIANGLE, BACKGROUND))
    lamp = np.flatnonzero(has_shape & (lights.area > 0) & (lights.visible & rays != 0))
    center = lights.position[lamp].astype(np.float64)
    axes = _axes(lights, lamp)
    local_from_world = np.linalg.inv(axes).transpose(0, 2, 1)

    # Grow each beyond the rounding of its corners, by a number of steps of its own.
    reach = np.abs(center).max(axis=1) + np.abs(axes).sum(axis=1).max(axis=1)
    steps = 1 + np.arange(len(lamp)) % NUM_STEPS + NUM_STEPS * _ranks(center)
    inradius = 1 / np.linalg.norm(np.abs(local_from_world).sum(axis=1), axis=1)
    growth = 1 + STEP * steps * reach / inradius
    axes, local_from_world = axes * growth[:, None, None], local_from_world / growth[:, None, None]

    vertices = center[:, None] + np.concatenate([axes, -axes], axis=1)
    # Face number bits say on which side of each axis the face lies.
    side = 3 * (np.arange(NUM_FACES)[:, None] >> np.arange(3) & 1) + np.arange(3)
    triangles = 6 * np.arange(len(lamp))[:, None, None] + side
    slack = 2 * np.linalg.norm(axes, axis=2).max(initial=0.0)
    return LampShapes(
        vertices=vertices.reshape(-1, 3),
        triangles=triangles.reshape(-1, 3),
        lamp=lamp,
        center=center,
        local_from_world=local_from_world,
        slack=slack,
        rays=rays,
    )


def _axes(lights: Lights, lamp: np.ndarray) -> np.ndarray:
    """(S, 3, 3) from each lamp's centre to three corners of an octahedron around it, as rows."""
    u, v, w = (a[lamp].astype(np.float64) for a in (lights.axis_u, lights.axis_v, lights.axis_w))
    is_flat = np.isin(lights.kind[lamp], (RECTANGLE, ELLIPSE))
    round_axes = math.sqrt(3) * lights.radius[lamp].astype(np.float64)[:, None, None] * np.eye(3)
    height = THICKNESS * np.minimum(np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1))
    flat_axes = np.stack([(u + v) / 2, (u - v) / 2, height[:, None] * w], axis=1)
    return np.where(is_flat[:, None, None], flat_axes, round_axes)


def _ranks(center: np.ndarray) -> np.ndarray:
    """(S,) how many lamps before each one are at its very place."""
    if len(center) == 0:
        return np.zeros(0, int)
    _, place = np.unique(center, axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    places = place.ravel()[order]
    first = np.flatnonzero(np.append(True, places[1:] != places[:-1]))
    ranks = np.empty(len(center), int)
    ranks[order] = np.arange(len(center)) - np.repeat(first, np.diff(np.append(first, len(center))))
    return ranks


@kernel
def to_shape(shapes, shape, a):
    """A world vector in the frame of an octahedron."""
    m = shapes.local_from_world[shape]
    return dot(load3(m, 0), a), dot(load3(m, 1), a), dot(load3(m, 2), a)


@kernel
def enters_shape(triangle, direction_local):
    """Whether a ray that meets a triangle of an octahedron comes from outside."""
    x, y, z = direction_local
    x = -x if triangle & 1 else x
    y = -y if triangle & 2 else y
    z = -z if triangle & 4 else z
    return x + y + z < ZERO


@kernel
def is_inside_shape(shapes, shape, p):
    """Whether a point lies inside an octahedron."""
    x, y, z = to_shape(shapes, shape, sub(p, load3(shapes.center, shape)))
    return abs(x) + abs(y) + abs(z) < ONE


@kernel
def counts(shapes, triangle, origin, direction):
    """Whether a ray from `origin`, which meets a triangle, meets its lamp there: once on its way.

    origin: where the whole ray starts, not where it goes on behind another lamp.
    """
    shape = triangle // NUM_FACES
    if enters_shape(triangle, to_shape(shapes, shape, direction)):
        return True
    return is_inside_shape(shapes, shape, origin)


@kernel
def behind_shape(shapes, triangle, bary_u, bary_v, direction):
    """From where a ray that met a triangle goes on: a point safely behind it."""
    ids = shapes.triangles[triangle]
    v0, v1, v2 = (
        load3(shapes.vertices, ids[0]),
        load3(shapes.vertices, ids[1]),
        load3(shapes.vertices, ids[2]),
    )
    p = madd(madd(v0, bary_u, sub(v1, v0)), bary_v, sub(v2, v0))
    n = cross(sub(v1, v0), sub(v2, v0))
    size = length(n) if dot(n, direction) > ZERO else -length(n)
    reach = max(max_abs(v0), max_abs(v1), max_abs(v2))
    return offset_point(p, n, reach / size)


@kernel
def intersect_lamp(lights, i, origin, direction):
    """Distance along a unit direction at which a ray meets lamp i; negative if it does not.

    As `light_points.sample_light_point` has it: a disk faces the origin of the ray, flat lamps
    shine to one side, a sphere is met from outside, or from inside at its far side.
    """
    kind = lights.kind[i]
    to_center = sub(load3(lights.position, i), origin)
    if kind in (RECTANGLE, ELLIPSE):
        return intersect_flat(lights, i, to_center, direction, kind == ELLIPSE)
    radius_sq = lights.radius[i] * lights.radius[i]
    along, dist_sq = dot(to_center, direction), dot(to_center, to_center)
    if kind == DISK:
        # The plane through the centre, at right angles to the way there.
        if along <= ZERO:
            return NO_HIT
        distance = dist_sq / along
        off = madd(to_center, -distance, direction)
        return distance if dot(off, off) <= radius_sq else NO_HIT
    off = madd(to_center, -along, direction)
    half_chord_sq = radius_sq - dot(off, off)
    if half_chord_sq < ZERO:
        return NO_HIT
    half_chord = math.sqrt(half_chord_sq)
    return along - half_chord if dist_sq > radius_sq else along + half_chord


@kernel
def intersect_flat(lights, i, to_center, direction, is_ellipse):
    """`intersect_lamp` for a rectangle or ellipse; to_center: from the origin of the ray."""
    u, v, w = load3(lights.axis_u, i), load3(lights.axis_v, i), load3(lights.axis_w, i)
    cos_light = -dot(direction, w)
    if cos_light <= ZERO:
        return NO_HIT
    distance = -dot(to_center, w) / cos_light
    if distance <= ZERO:
        return NO_HIT
    off, normal = sub(scale(direction, distance), to_center), cross(u, v)
    # The place in units of the sides, which may be at any angle.
    normal_sq = dot(normal, normal)
    s, t = dot(cross(off, v), normal) / normal_sq, dot(cross(u, off), normal) / normal_sq
    if is_ellipse:
        return distance if s * s + t * t <= HALF * HALF else NO_HIT
    return distance if abs(s) <= HALF and abs(t) <= HALF else NO_HIT
