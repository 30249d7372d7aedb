"""The table of lights, built from a scene, and what a light tree knows of each light.

A row is a lamp, one emitting side of one triangle, or the background. An emitter that shines from
both sides is two rows, so each row has an axis, and bounds can cull all that lies behind it.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np

from .environment import EnvironmentTable, build_environment
from .jit import f32, f64, flag, i32, table
from .scene import (
    ALL_BOUNCES,
    ALL_RAYS,
    BACKGROUND,
    CAMERA_RAY,
    DISK,
    ELLIPSE,
    NO_CONE,
    NO_TEXTURE,
    POINT,
    RECTANGLE,
    SPHERE,
    SUN,
    TRIANGLE,
    Scene,
)
from .texture_means import texture_means
from .vec import LUMINANCE

NO_LIGHT = -1
# Lights that emit into less than this, in radians, are weighed as if they emitted into this.
MIN_EMISSION_ANGLE = 1e-3
# Area lights that emit into less than this, in radians, are beams: the more so the narrower.
MAX_BEAM_ANGLE = 1.0
# What a user calls lights without a cone; with one they are spots.
KIND_NAMES = {
    POINT: "point",
    SPHERE: "point",
    DISK: "point",
    RECTANGLE: "area",
    ELLIPSE: "area",
    SUN: "sun",
    TRIANGLE: "mesh triangle",
    BACKGROUND: "background",
}


@table
class Lights(NamedTuple):
    """One row a light; columns as in `scene.Lamps` unless told here.

    position: of a triangle its first vertex, of a rectangle or ellipse its centre.
    axis_u, axis_v, axis_w: of a triangle the two edges from there and the unit normal of the side
    that emits. size_sq: squared length of its longest side. area: m^2.
    tan_spread: tangent of half the spread of an area light. texture_mean: luminance of a triangle
    with a texture over that without it.
    max_bounces: at a vertex after b bounces, 0 for what the camera sees, the light counts if b is
    at most this, be it sampled there or met by a ray from there; going straight through a surface
    is no bounce. Cycles compares so where it samples lights, but lets rays meet them ever after.

    Of all lights: suns, (S,) int32 rows of those with extent; environment.
    """

    kind: i32[::1]
    position: f32[:, ::1]
    axis_u: f32[:, ::1]
    axis_v: f32[:, ::1]
    axis_w: f32[:, ::1]
    radiance: f32[:, ::1]
    radius: f32[::1]
    cos_cone: f32[::1]
    blend: f32[::1]
    tan_spread: f32[::1]
    texture_mean: f32[::1]
    area: f32[::1]
    size_sq: f32[::1]
    visible: i32[::1]
    casts_shadow: flag[::1]
    max_bounces: i32[::1]
    suns: i32[::1]
    environment: EnvironmentTable


# Columns that are not float32, and those of a light that is no lamp.
DTYPES = {"kind": np.int32, "visible": np.int32, "casts_shadow": bool, "max_bounces": np.int32}
DEFAULTS = {
    "cos_cone": NO_CONE,
    "tan_spread": np.inf,
    "texture_mean": 1.0,
    "visible": ALL_RAYS,
    "casts_shadow": True,
    "max_bounces": ALL_BOUNCES,
}
VECTORS = ("position", "axis_u", "axis_v", "axis_w", "radiance")
SCALARS = ("kind", "radius", "cos_cone", "blend", "visible", "casts_shadow", "max_bounces")


@table
class LightBounds(NamedTuple):
    """What a light tree knows of each light; n rows.

    flux: emitted power, W; of a distant light its irradiance, W/m^2. peak: largest radiant
    intensity, W/sr. Both are luminances. mean_cos: mean cosine of the angle from the axis, over
    all emitted light. box_min, box_max: (n, 3) of the emitter. mean: (n, 3) its centre; variance:
    mean squared distance of its points from there, m^2. axis: (n, 3) unit direction of emission,
    zero if there is none. theta_e: largest angle from the axis at which it emits. fade: of a beam,
    with a round edge at theta_e, the part of 1 - cos from there to where it is at its peak;
    infinite for a light that is none. is_distant: sun and background; box, mean, variance, peak and
    fade are unused.
    """

    flux: f64[::1]
    peak: f64[::1]
    mean_cos: f64[::1]
    box_min: f64[:, ::1]
    box_max: f64[:, ::1]
    mean: f64[:, ::1]
    variance: f64[::1]
    axis: f64[:, ::1]
    theta_e: f64[::1]
    fade: f64[::1]
    is_distant: flag[::1]


def build_lights(scene: Scene) -> tuple[Lights, np.ndarray, int]:
    """The scene's lights; (T, 2) row of each triangle's front and back or NO_LIGHT; background's.

    Emitters without light or without size are left out.
    """
    lamps = scene.lamps
    is_lit = np.any(lamps.radiance != 0, axis=1)
    columns = {name: getattr(lamps, name)[is_lit] for name in VECTORS + SCALARS}
    # Half of pi in float32 lies beyond pi / 2, where the tangent turns negative.
    half_spread = np.minimum(lamps.spread[is_lit].astype(np.float64) / 2, np.pi / 2 - 1e-9)
    columns["tan_spread"] = np.tan(half_spread)

    triangle_light = np.full((len(scene.triangles), 2), NO_LIGHT, np.int32)
    tables = [columns]
    num_lights = int(is_lit.sum())
    for side in (0, 1):
        rows, triangle_ids = _triangle_lights(scene, side)
        triangle_light[triangle_ids, side] = num_lights + np.arange(len(triangle_ids))
        num_lights += len(triangle_ids)
        tables.append(rows)
    background_light, environment = NO_LIGHT, build_environment(scene)
    if environment.color.any():
        background_light = num_lights
        row = {"kind": BACKGROUND, "visible": scene.environment.visible}
        row["max_bounces"] = scene.environment.max_bounces
        row = {name: np.array([value]) for name, value in row.items()}
        tables.append({**row, "radiance": environment.color})

    return _concatenate(tables, environment), triangle_light, background_light


def _triangle_lights(scene: Scene, side: int) -> tuple[dict, np.ndarray]:
    """Rows for the triangles that emit from one side, and their ids."""
    materials = scene.materials
    is_light = np.any(materials.emission[:, side] != 0, axis=1) & materials.light_sampled[:, side]
    triangle_ids = np.flatnonzero(is_light[scene.triangle_material])
    visible = scene.triangle_visible() & ALL_RAYS
    visible = visible[triangle_ids] if len(visible) else np.full(len(triangle_ids), ALL_RAYS)
    is_seen = visible & ~CAMERA_RAY != 0  # what only the camera sees lights nothing
    triangle_ids, visible = triangle_ids[is_seen], visible[is_seen]
    corners = scene.vertices[scene.triangles[triangle_ids]].astype(np.float64)
    edge_u, edge_v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if side == 1:
        edge_u, edge_v = edge_v, edge_u
    normal = np.cross(edge_u, edge_v)
    twice_area = np.linalg.norm(normal, axis=1)
    has_area = twice_area > 0
    triangle_ids = triangle_ids[has_area]
    rows = {
        "kind": np.full(len(triangle_ids), TRIANGLE),
        "position": corners[has_area, 0],
        "axis_u": edge_u[has_area],
        "axis_v": edge_v[has_area],
        "axis_w": normal[has_area] / twice_area[has_area, None],
        "radiance": materials.emission[scene.triangle_material[triangle_ids], side],
        "visible": visible[has_area],
    }
    rows["texture_mean"] = _texture_mean(scene, triangle_ids, side, rows["radiance"])
    return rows, triangle_ids


def _texture_mean(scene: Scene, triangle_ids, side: int, radiance) -> np.ndarray:
    """(n,) share of their luminance that the textures of emitting triangles leave them."""
    texture = scene.materials.emission_texture[scene.triangle_material[triangle_ids], side]
    luminance, share = radiance @ np.array(LUMINANCE, np.float64), np.ones(len(triangle_ids))
    for texture_id in np.unique(texture[texture != NO_TEXTURE]):
        rows = texture == texture_id
        shown = radiance[rows] * texture_means(scene, int(texture_id), triangle_ids[rows])
        share[rows] = np.abs(shown) @ np.array(LUMINANCE, np.float64) / luminance[rows]
    return share


def _concatenate(tables: list[dict], environment: EnvironmentTable) -> Lights:
    """One table of exact types from several that may lack columns."""
    lengths = [len(table["kind"]) for table in tables]

    def column(name):
        width = (3,) if name in VECTORS else ()
        parts = [
            table[name] if name in table else np.full((n, *width), DEFAULTS.get(name, 0.0))
            for table, n in zip(tables, lengths, strict=True)
        ]
        return np.ascontiguousarray(np.concatenate(parts), DTYPES.get(name, np.float32))

    columns = {name: column(name) for name in (*VECTORS, *SCALARS, "tan_spread", "texture_mean")}
    area, size_sq = _sizes(**{k: columns[k] for k in ("kind", "axis_u", "axis_v", "radius")})
    suns = np.flatnonzero((columns["kind"] == SUN) & (columns["radius"] > 0)).astype(np.int32)
    return Lights(**columns, area=area, size_sq=size_sq, suns=suns, environment=environment)


def _sizes(kind, axis_u, axis_v, radius) -> tuple[np.ndarray, np.ndarray]:
    """Area (m^2) and squared length of the longest side of each light with a surface."""
    u, v = axis_u.astype(np.float64), axis_v.astype(np.float64)
    parallelogram = np.linalg.norm(np.cross(u, v), axis=1)
    factor = np.select([kind == TRIANGLE, kind == RECTANGLE, kind == ELLIPSE], [0.5, 1, np.pi / 4])
    is_round = (kind == SPHERE) | (kind == DISK)
    area = np.where(is_round, np.pi * radius.astype(np.float64) ** 2, factor * parallelogram)
    sides = [(u**2).sum(1), (v**2).sum(1), np.where(kind == TRIANGLE, ((u - v) ** 2).sum(1), 0)]
    return area.astype(np.float32), np.max(sides, axis=0).astype(np.float32)


def bound_lights(lights: Lights) -> LightBounds:
    """Bounds, moments and energies of all lights."""
    kind = lights.kind
    position, u, v = (a.astype(np.float64) for a in (lights.position, lights.axis_u, lights.axis_v))
    radius = lights.radius.astype(np.float64)[:, None]
    is_triangle, is_distant = kind == TRIANGLE, (kind == SUN) | (kind == BACKGROUND)
    is_flat = is_triangle | (kind == RECTANGLE) | (kind == ELLIPSE)
    is_spot = lights.cos_cone != NO_CONE

    first = np.where(is_triangle[:, None], position, position - (u + v) / 2)
    corners = np.stack([first, first + u, first + v, first + u + v])
    corners[3, is_triangle] = first[is_triangle]
    box_min = np.where(is_flat[:, None], corners.min(0), position - radius)
    box_max = np.where(is_flat[:, None], corners.max(0), position + radius)
    mean = np.where(is_triangle[:, None], position + (u + v) / 3, position)
    u_sq, v_sq, uv = (u**2).sum(1), (v**2).sum(1), (u * v).sum(1)
    variance = np.select(
        [is_triangle, kind == RECTANGLE, kind == ELLIPSE],
        [(u_sq + v_sq - uv) / 18, (u_sq + v_sq) / 12, (u_sq + v_sq) / 16],
        radius[:, 0] ** 2,
    )

    luminance = np.abs(lights.radiance.astype(np.float64) @ np.array(LUMINANCE, np.float64))
    luminance *= lights.texture_mean
    luminance[kind == BACKGROUND] = lights.environment.mean_luminance
    sin_radius = np.sin(np.minimum(radius[:, 0], np.pi / 2))
    sun_measure = np.where(radius[:, 0] > 0, np.pi * sin_radius**2, 1)
    factor = np.select(
        [kind == POINT, kind == SUN, kind == BACKGROUND], [1, sun_measure, np.pi], lights.area
    )
    theta_e = np.select(
        [is_flat, kind == SUN],
        [np.arctan(lights.tan_spread.astype(np.float64)), radius[:, 0]],
        np.pi,
    )
    axis = lights.axis_w.astype(np.float64) * (is_flat | (kind == SUN))[:, None]
    axis[is_spot], theta_e[is_spot], is_round = _spot_cones(lights, is_spot)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-300)[:, None]
    peak = luminance * factor
    fade = np.where(is_flat & (theta_e < MAX_BEAM_ANGLE), 1 - np.cos(theta_e), np.inf)
    fade[is_spot] = ((1 - np.cos(theta_e)) * lights.blend)[is_spot]
    fade[np.flatnonzero(is_spot)[~is_round]] = np.inf
    solid_angle, mean_cos = _emission_moments(lights, is_spot, is_flat, theta_e)
    return LightBounds(
        flux=np.where(is_distant, peak, peak * solid_angle),
        peak=peak,
        mean_cos=mean_cos,
        box_min=box_min,
        box_max=box_max,
        mean=mean,
        variance=variance,
        axis=axis,
        theta_e=theta_e,
        fade=fade,
        is_distant=is_distant,
    )


def _emission_moments(lights: Lights, is_spot, is_flat, theta_e) -> tuple[np.ndarray, np.ndarray]:
    """Integral over all directions of a light's intensity over its peak, sr; its mean cosine.

    Closed forms of the falloffs in `light_points.emission_falloff`, times the cosine for flat ones.
    """
    theta_e = np.maximum(theta_e, MIN_EMISSION_ANGLE)
    cos_e = np.cos(theta_e)
    # A smoothstep rises over `fade` to one; its integral is half of that, its first moment 0.35.
    fade = (1 - cos_e) * lights.blend.astype(np.float64)
    spot = 1 - cos_e - fade / 2
    spot_cos = cos_e * fade / 2 + 0.35 * fade**2 + (1 - (cos_e + fade) ** 2) / 2
    # The integrals of cos (1 - tan / tan_e) and of cos^2 (1 - tan / tan_e) over the cosine.
    inv_tan = np.where(is_flat, 1 / np.tan(theta_e), 0)
    flat = np.sin(theta_e) ** 2 / 2 - (theta_e / 2 - np.sin(2 * theta_e) / 4) * inv_tan
    flat_cos = (1 - cos_e**3) / 3 - np.sin(theta_e) ** 3 / 3 * inv_tan
    integral = np.select([is_spot, is_flat], [spot, flat], 2)
    moment = np.select([is_spot, is_flat], [spot_cos, flat_cos], 0)
    return 2 * np.pi * integral, moment / np.maximum(integral, 1e-300)


def _spot_cones(lights: Lights, is_spot: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, 3) middle of each spot's light in the world, the largest angle from there, is it round.

    A spot's cone is round in its own frame, which may be scaled and sheared. Bounded from above.
    """
    frame = np.stack([lights.axis_u, lights.axis_v, lights.axis_w], axis=1)[is_spot]
    # Columns: where the axes of a spot's own frame point in the world.
    world = np.linalg.pinv(frame.astype(np.float64))
    middle = world[:, :, 2]
    length = np.maximum(np.linalg.norm(middle, axis=1), 1e-300)
    along = np.einsum("nk,nkj->nj", middle / length[:, None], world[:, :, :2])
    across = world[:, :, :2] - (middle / length[:, None])[:, :, None] * along[:, None, :]
    cos_cone = np.clip(lights.cos_cone[is_spot].astype(np.float64), 0, 1)
    sin_cone = np.sqrt(1 - cos_cone**2)
    nearest = cos_cone * length - sin_cone * np.linalg.norm(along, axis=1)
    widths = np.linalg.svd(across, compute_uv=False)[:, :2]
    farthest = np.arctan2(sin_cone * widths[:, 0], nearest)
    is_round = np.isclose(widths, length[:, None], rtol=1e-4).all(axis=1)
    is_round &= np.linalg.norm(along, axis=1) < 1e-4 * length
    return middle, np.where(nearest > 0, farthest, np.pi), is_round


def count_lights(lights: Lights) -> dict[str, int]:
    """How many lights of each kind there are, by what a user calls the kind."""
    is_spot = lights.cos_cone != NO_CONE
    kind_names = zip(lights.kind.tolist(), is_spot.tolist(), strict=True)
    return dict(Counter("spot" if spot else KIND_NAMES[kind] for kind, spot in kind_names))
