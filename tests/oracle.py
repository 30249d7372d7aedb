"""Plain-numpy answers to compare with: irradiance by brute force, without occlusion.

Everything is float64 and deterministic: an emitter is cut into `num_samples` squared pieces, as
seen from the point that it lights. No kernels here; only the tables of scene and lights.
"""

import numpy as np

from lighttree_core.lights import build_lights
from lighttree_core.scene import DISK, ELLIPSE, NO_CONE, POINT, RECTANGLE, SPHERE, SUN

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709
LAMBERTIAN_SPREAD = np.pi - 1e-6  # an area light's spread of pi, in float32


def irradiance(scene, p, n, num_samples=256):
    """(3,) W/m^2 at p on a surface of unit normal n, from every light of a scene."""
    total = np.pi * scene.background.astype(np.float64)
    for lamp_id in range(len(scene.lamps.kind)):
        total += lamp_irradiance(scene.lamps, lamp_id, p, n, num_samples)
    emission = scene.materials.emission[scene.triangle_material]
    for triangle_id in np.flatnonzero(emission.any(axis=(1, 2))):
        corners = scene.vertices[scene.triangles[triangle_id]]
        total += triangle_irradiance(corners, emission[triangle_id], p, n, num_samples)
    return total


def lamp_irradiance(lamps, lamp_id, p, n, num_samples=256):
    """(3,) W/m^2 at p on a surface of unit normal n, from one row of Lamps."""
    lamp = _Row(lamps, lamp_id)
    wi, solid_angle, share = PIECES[lamp.kind](lamp, np.asarray(p, float), num_samples)
    cos = np.maximum(wi @ np.asarray(n, float), 0.0)
    return lamp.radiance * np.sum(cos * solid_angle * share * _spot_share(lamp, -wi))


def light_irradiances(scene, p, n, num_samples=16):
    """(num_lights, 3) W/m^2 from each row of `lights.build_lights`, in its order."""
    lights, triangle_light, background = build_lights(scene)
    irradiances = np.zeros((len(lights.kind), 3))
    for row, lamp_id in enumerate(np.flatnonzero(scene.lamps.radiance.any(axis=1))):
        irradiances[row] = lamp_irradiance(scene.lamps, lamp_id, p, n, num_samples)
    for triangle_id, side in np.argwhere(triangle_light >= 0):
        emission = scene.materials.emission[scene.triangle_material[triangle_id]].copy()
        emission[1 - side] = 0
        corners = scene.vertices[scene.triangles[triangle_id]]
        irradiances[triangle_light[triangle_id, side]] = triangle_irradiance(
            corners, emission, p, n, num_samples
        )
    if background >= 0:
        irradiances[background] = np.pi * scene.background
    return irradiances


def best_probabilities(scene, p, n, num_samples=16):
    """(num_lights,) of the exhaustive sampler: every light weighed exactly, without occlusion."""
    weights = np.abs(light_irradiances(scene, p, n, num_samples) @ LUMINANCE)
    return weights / max(weights.sum(), 1e-300)


def triangle_irradiance(corners, emission, p, n, num_samples=256):
    """(3,) W/m^2 at p; corners: (3, 3), counter-clockwise from the front; emission: (2, 3)."""
    a, b, c = np.asarray(corners, float)
    s, t = _unit_square(num_samples)
    # Uniform on a triangle: P. Shirley, Graphics Gems, 1990.
    points = a + (np.sqrt(s) * (1 - t))[:, None] * (b - a) + (np.sqrt(s) * t)[:, None] * (c - a)
    doubled = np.cross(b - a, c - a)
    area = np.linalg.norm(doubled) / 2
    wi, dist_sq = _unit(points - p)
    cos_light = -wi @ (doubled / (2 * area))
    cos = np.maximum(wi @ np.asarray(n, float), 0.0)
    radiance = np.where(cos_light[:, None] > 0, *np.asarray(emission, float))
    return np.mean((cos * np.abs(cos_light) / dist_sq)[:, None] * radiance, axis=0) * area


class _Row:
    """One row of Lamps, in float64."""

    def __init__(self, lamps, lamp_id):
        self.kind = int(lamps.kind[lamp_id])
        for name in ("position", "axis_u", "axis_v", "axis_w", "radiance"):
            setattr(self, name, getattr(lamps, name)[lamp_id].astype(np.float64))
        for name in ("radius", "cos_cone", "blend", "spread"):
            setattr(self, name, float(getattr(lamps, name)[lamp_id]))


# Pieces of an emitter as seen from p: unit directions to them (N, 3), the solid angles they cover
# (N,), and the share of the lamp's radiance that they send to p (N,). A lamp without extent is one
# piece, whose "solid angle" is what turns intensity or irradiance into irradiance.


def _point_pieces(lamp, p, num_samples):
    wi, dist_sq = _unit((lamp.position - p)[None])
    return wi, 1 / dist_sq, 1.0


def _sphere_pieces(lamp, p, num_samples):
    axis, dist_sq = _unit((lamp.position - p)[None])
    sin_sq = lamp.radius**2 / dist_sq[0]
    # Inside, the sphere is all around.
    return _cone_pieces(axis[0], np.sqrt(1 - sin_sq) if sin_sq < 1 else -1.0, num_samples)


def _disk_pieces(lamp, p, num_samples):
    axis, _ = _unit((p - lamp.position)[None])
    u, v = tangents(axis[0])
    offsets = _unit_disk(num_samples) * lamp.radius
    area = np.pi * lamp.radius**2
    return _flat_pieces(lamp.position + offsets @ [u, v], area, axis[0], p)


def _rectangle_pieces(lamp, p, num_samples):
    offsets = np.stack(_unit_square(num_samples), axis=-1) - 0.5
    return _area_pieces(lamp, offsets, 1.0, p)


def _ellipse_pieces(lamp, p, num_samples):
    return _area_pieces(lamp, _unit_disk(num_samples) / 2, np.pi / 4, p)


def _area_pieces(lamp, offsets, area_share, p):
    """offsets: (N, 2) in units of the sides; area_share: of the parallelogram they span."""
    area = area_share * np.linalg.norm(np.cross(lamp.axis_u, lamp.axis_v))
    points = lamp.position + offsets @ [lamp.axis_u, lamp.axis_v]
    wi, solid_angle, _ = _flat_pieces(points, area, lamp.axis_w, p)
    if lamp.spread >= LAMBERTIAN_SPREAD:
        return wi, solid_angle, 1.0
    cos = np.clip(-wi @ lamp.axis_w, 1e-12, 1.0)
    tan = np.sqrt(1 - cos**2) / cos
    return wi, solid_angle, np.maximum(1 - tan / np.tan(lamp.spread / 2), 0.0)


def _sun_pieces(lamp, p, num_samples):
    if lamp.radius == 0:
        return -lamp.axis_w[None], 1.0, 1.0
    return _cone_pieces(-lamp.axis_w, np.cos(lamp.radius), num_samples)


PIECES = {
    POINT: _point_pieces,
    SPHERE: _sphere_pieces,
    DISK: _disk_pieces,
    RECTANGLE: _rectangle_pieces,
    ELLIPSE: _ellipse_pieces,
    SUN: _sun_pieces,
}


def _flat_pieces(points, area, normal, p):
    """Equal pieces of a flat emitter that shines towards its unit normal."""
    wi, dist_sq = _unit(points - p)
    return wi, np.maximum(-wi @ normal, 0.0) * (area / len(points)) / dist_sq, 1.0


def _cone_pieces(axis, cos_min, num_samples):
    """Equal pieces of the directions within a cone around a unit axis."""
    s, t = _unit_square(num_samples)
    # cos = 1 - (1 - cos_min) s; exact for narrow cones as well.
    drop = (1 - cos_min) * s
    sin, phi = np.sqrt(drop * (2 - drop)), 2 * np.pi * t
    local = np.stack([sin * np.cos(phi), sin * np.sin(phi), 1 - drop], axis=-1)
    return local @ [*tangents(axis), axis], 2 * np.pi * (1 - cos_min) / len(s), 1.0


def _spot_share(lamp, wo):
    """(N,) how much of a spot's light gets through its cone in the directions wo, (N, 3)."""
    if lamp.cos_cone == NO_CONE:
        return 1.0
    local, _ = _unit(wo @ np.stack([lamp.axis_u, lamp.axis_v, lamp.axis_w], axis=-1))
    inside = local[:, 2] - lamp.cos_cone
    if lamp.blend == 0:
        return (inside > 0).astype(float)
    x = np.clip(inside / ((1 - lamp.cos_cone) * lamp.blend), 0.0, 1.0)
    return x * x * (3 - 2 * x)


def _unit_square(num_samples):
    """s, t: the centres of num_samples^2 equal cells."""
    s, t = np.meshgrid(*[(np.arange(num_samples) + 0.5) / num_samples] * 2)
    return s.ravel(), t.ravel()


def _unit_disk(num_samples):
    """(N, 2) equal-area pieces of the disk of radius 1."""
    s, t = _unit_square(num_samples)
    return np.sqrt(s)[:, None] * np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], axis=-1)


def _unit(vectors):
    """Unit vectors, and the squares of the lengths they had."""
    length_sq = np.sum(vectors**2, axis=-1)
    return vectors / np.sqrt(length_sq)[:, None], length_sq


def tangents(axis):
    """Two unit vectors, at right angles to each other and to a unit axis."""
    least = np.eye(3)[np.argmin(np.abs(axis))]
    u, _ = _unit(np.cross(axis, least)[None])
    return u[0], np.cross(axis, u[0])
