"""Blender's light objects -> Lamps, watts -> radiance.

A light data-block is read once, into a `_Light`; each object that shows it adds a matrix; what
depends on both is computed for all objects at once. The formulas are those of Cycles'
src/scene/light.cpp; test_lamps.py compares each with a render by Cycles.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np

from lighttree_core.scene import (
    ALL_BOUNCES,
    ALL_RAYS,
    CAMERA_RAY,
    DIFFUSE_RAY,
    DISK,
    ELLIPSE,
    GLOSSY_RAY,
    NO_CONE,
    POINT,
    RECTANGLE,
    SHADOW_RAY,
    SPHERE,
    SUN,
    TRANSMISSION_RAY,
    Lamps,
    SceneError,
)

from .materials import cycles_setting, read_light_factor
from .nodes import Notes

MIN_SPREAD = 1e-3  # radians; at 0 an area light is a beam, of infinite radiance
RAY_BITS = {
    "camera": CAMERA_RAY,
    "diffuse": DIFFUSE_RAY,
    "glossy": GLOSSY_RAY,
    "transmission": TRANSMISSION_RAY,
    "shadow": SHADOW_RAY,
}

NOT_LINKED = "lights and darkens everything, without light linking."


class _Light(NamedTuple):
    """A light data-block; fields as in Lamps.

    radiance: of area lights for an object of scale 1. side_u, side_v: of area lights, metres.
    shrinks: whether a larger object makes an area light darker, so that its power is the same.
    """

    kind: int
    radiance: np.ndarray
    radius: float = 0.0
    cos_cone: float = NO_CONE
    blend: float = 0.0
    spread: float = math.pi
    side_u: float = 0.0
    side_v: float = 0.0
    shrinks: bool = False
    casts_shadow: bool = True
    max_bounces: int = ALL_BOUNCES


class LampTable:
    """Gathers light objects; each becomes one row of `Lamps`."""

    def __init__(self, notes: Notes):
        self.notes = notes
        # id_of: address of a data-block -> index in `lights`, None if it emits nothing.
        self.lights, self.id_of = [], {}
        self.light_ids, self.visible, self.names = [], [], []
        self.matrices = array("d")  # 12 numbers an object: a million tuples would take a GB

    def add(self, lamp, matrix):
        """Add an object of type LIGHT and its matrix in the world, if it shines."""
        key = lamp.data.as_pointer()
        if key not in self.id_of:
            light = _read_light(lamp.data, self.notes)
            self.id_of[key] = len(self.lights) if light.radiance.any() else None
            self.lights.append(light)
        light_id = self.id_of[key]
        visible = ray_visibility(lamp) & ALL_RAYS
        if light_id is None or not visible:
            return
        if self._shines(lamp, self.lights[light_id], matrix):
            self.light_ids.append(light_id)
            self.visible.append(visible)
            self.matrices.extend(matrix[0][:] + matrix[1][:] + matrix[2][:])
            self.names.append(lamp.name)

    def _shines(self, lamp, light, matrix):
        """Whether an object has extent, so that it shines in Cycles; notes what differs there."""
        if _extent(light, matrix) == 0:
            self.notes.add(lamp.name, "left out, as its size or scale is 0.")
            return False
        if is_linked(lamp):
            self.notes.add(lamp.name, NOT_LINKED)
        return True

    def lamps(self) -> Lamps:
        """All rows; raises SceneError where light is not a finite number."""
        lamps = Lamps.empty(len(self.names))
        if not self.names:
            return lamps
        columns = zip(*self.lights, strict=True)
        light = _Light(*(np.array(column)[self.light_ids] for column in columns))
        matrices = np.frombuffer(self.matrices).reshape(-1, 3, 4)
        lamps.names = self.names
        lamps.position[:] = matrices[:, :, 3]
        lamps.visible[:] = self.visible
        names = "kind", "radius", "cos_cone", "blend", "spread", "casts_shadow", "max_bounces"
        for name in names:
            getattr(lamps, name)[:] = getattr(light, name)
        self._place(lamps, light, matrices[:, :, :3])
        for lamp_id in np.flatnonzero(~np.isfinite(lamps.radiance).all(axis=1)):
            raise SceneError(
                f"Lamp {lamps.names[lamp_id]} emits {lamps.radiance[lamp_id]} W/(m^2 sr), which is "
                "not finite: check its power, exposure, colour and nodes."
            )
        return lamps

    def _place(self, lamps, light, axes):
        """Fill radiance and axes; axes: (L, 3, 3), whose columns are the objects' own."""
        is_area = np.isin(light.kind, (RECTANGLE, ELLIPSE))
        is_sun = light.kind == SUN
        is_spot = light.cos_cone != NO_CONE
        u, v, w = np.moveaxis(axes, 2, 0)
        normal = np.cross(u, v)
        area, det = np.linalg.norm(normal, axis=1), np.sum(normal * w, axis=1)

        with np.errstate(over="ignore"):
            lamps.radiance[:] = light.radiance / np.where(light.shrinks, area, 1.0)[:, None]
        lamps.axis_u[is_area] = (u * light.side_u[:, None])[is_area]
        lamps.axis_v[is_area] = (v * light.side_v[:, None])[is_area]
        # Area lights and suns shine along their local -Z.
        lamps.axis_w[is_area] = (-np.sign(det)[:, None] * normal)[is_area] / area[is_area, None]
        lamps.axis_w[is_sun] = -w[is_sun] / np.linalg.norm(w[is_sun], axis=1, keepdims=True)
        # The cone of a spot is round in the unscaled frame of its object.
        local_from_world = np.linalg.inv(axes[is_spot])
        lamps.axis_u[is_spot] = local_from_world[:, 0]
        lamps.axis_v[is_spot] = local_from_world[:, 1]
        lamps.axis_w[is_spot] = -local_from_world[:, 2]

        box = np.prod(np.linalg.norm(axes, axis=1), axis=1)
        for lamp_id in np.flatnonzero(is_area & (np.abs(det) < 0.999 * box)):
            self.notes.add(self.names[lamp_id], "sheared, for which Cycles has other formulas.")


def ray_visibility(thing) -> int:
    """Bits of the rays that meet an object."""
    return sum(bit for ray, bit in RAY_BITS.items() if getattr(thing, f"visible_{ray}"))


def is_linked(thing) -> bool:
    """Whether an object lights, or darkens, only some others."""
    linking = thing.light_linking
    return bool(linking.receiver_collection or linking.blocker_collection)


def _extent(light, matrix):
    """What must not be 0 if a lamp is to shine in Cycles."""
    if light.kind == SUN:
        return matrix.col[2].length
    if light.kind in (RECTANGLE, ELLIPSE):
        return matrix.determinant() * light.side_u * light.side_v
    return matrix.determinant() if light.cos_cone != NO_CONE else 1.0


def _read_light(light, notes):
    """A light data-block as a `_Light`."""
    name = f"Light {light.name}"
    if light.type == "AREA" and cycles_setting(light, "is_portal", False):
        return _Light(RECTANGLE, np.zeros(3))  # guides sampling, emits nothing
    if light.type == "AREA" and light.spread < MIN_SPREAD:
        notes.add(name, f"its spread is widened to {math.degrees(MIN_SPREAD):.2f} degrees.")
    read = READERS[light.type](light, _power(light, notes))
    has_extent = read.radius > 0 or read.side_u > 0
    if has_extent and not cycles_setting(light, "use_multiple_importance_sampling", True):
        notes.add(name, "is seen in mirrors though its Multiple Importance is off.")
    return read._replace(
        casts_shadow=light.use_shadow,
        max_bounces=cycles_setting(light, "max_bounces", ALL_BOUNCES),
    )


def _power(light, notes):
    """(3,) watts, of a sun W/m^2: energy * colour * 2^exposure, times its nodes' colour."""
    temperature = light.temperature_color if light.use_temperature else (1.0, 1.0, 1.0)
    color = np.array(light.color) * temperature * read_light_factor(light, notes)
    return light.energy * 2.0**light.exposure * color


def _area(light, square_metres):
    """What power is divided by, besides pi: the area, or 1 if power is not normalized."""
    return square_metres if light.normalize and square_metres > 0 else 1.0


def _point(light, power):
    """A sphere, L = P / (4 pi^2 r^2), or of the same L a disk that faces what it lights.

    Of radius 0 a point of intensity P / (4 pi).
    """
    radius = light.shadow_soft_size
    if radius == 0:
        return _Light(POINT, power / (math.pi * _area(light, 4.0)))
    radiance = power / (math.pi * _area(light, 4 * math.pi * radius**2))
    return _Light(DISK if light.use_soft_falloff else SPHERE, radiance, radius)


def _spot(light, power):
    """A point light of the same power, seen only within a cone."""
    cone = {"cos_cone": math.cos(light.spot_size / 2), "blend": light.spot_blend}
    return _point(light, power)._replace(**cone)


def _area_light(light, power):
    """L = P / (pi A) along the axis, and brighter as the spread is narrower.

    Towards theta off the axis Cycles lets through 1 - tan(theta) / tan(spread / 2); the integral
    of that and the cosine over the hemisphere is pi (1 - (spread / 2) / tan(spread / 2)).
    """
    is_round = light.shape in ("DISK", "ELLIPSE")
    side_u = light.size
    side_v = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    area = side_u * side_v * (math.pi / 4 if is_round else 1.0)
    spread = max(light.spread, MIN_SPREAD)
    let_through = 1.0 - spread / 2 / math.tan(spread / 2)
    return _Light(
        kind=ELLIPSE if is_round else RECTANGLE,
        radiance=power / (math.pi * _area(light, area) * let_through),
        spread=spread,
        side_u=side_u,
        side_v=side_v,
        shrinks=light.normalize,
    )


def _sun(light, power):
    """Irradiance S on a plane that faces it: L = S / (pi sin^2(angle / 2)); of angle 0, S."""
    radius = light.angle / 2
    return _Light(SUN, power / _area(light, math.pi * math.sin(radius) ** 2), radius)


READERS = {"POINT": _point, "SPOT": _spot, "AREA": _area_light, "SUN": _sun}
