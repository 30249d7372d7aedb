"""The tables that kernels read, made from a scene."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .albedo_tables import AlbedoTables, load_albedo_tables
from .closures import ClosureTable
from .geometry import Geometry, build_geometry
from .jit import f32, flag, i32, i64, table
from .lamp_shapes import LampShapes, build_lamp_shapes
from .light_tree.sample import LightSampler, build_sampler
from .lights import NO_LIGHT, bound_lights, build_lights
from .scene import (
    ALL_RAYS,
    ALPHA,
    CAMERA_RAY,
    DIFFUSE,
    DIFFUSE_RAY,
    NO_TEXTURE,
    PRINCIPLED,
    TRANSLUCENT,
    TRANSPARENT,
    Closures,
    Scene,
)
from .settings import Settings
from .textures import TextureTable


@table
class World(NamedTuple):
    """All that kernels read: geometry, materials, lights; rows as in `scene.Scene`.

    triangle_light: (T, 2) lights of front and back; light_triangle: (L,) the way back.
    camera_background: (1, 3), or (0, 3) where the camera sees what other rays see. is_see_through:
    whether light goes straight through some surface. film_transparent: as of a Scene.
    """

    geometry: Geometry
    triangle_light: i32[:, ::1]
    light_triangle: i32[::1]
    albedo: f32[:, :, ::1]
    first_closure: i32[:, ::1]
    num_closures: i32[:, ::1]
    closures: ClosureTable
    albedo_tables: AlbedoTables
    textures: TextureTable
    emission: f32[:, :, ::1]
    emission_texture: i32[:, ::1]
    camera_background: f32[:, ::1]
    background_light: i64
    is_see_through: flag
    film_transparent: flag
    lamp_shapes: LampShapes
    sampler: LightSampler


def build_world(scene: Scene, settings: Settings) -> World:
    """The tables of a scene, with its light tree."""
    lights, triangle_light, background_light = build_lights(scene)
    materials = scene.materials
    return World(
        geometry=build_geometry(scene),
        triangle_light=triangle_light,
        light_triangle=_light_triangle(triangle_light, len(lights.kind)),
        albedo=materials.albedo,
        first_closure=materials.first_closure,
        num_closures=materials.num_closures,
        closures=ClosureTable(**vars(scene.closures)),
        albedo_tables=load_albedo_tables(),
        textures=TextureTable(**vars(scene.textures)),
        emission=materials.emission,
        emission_texture=materials.emission_texture,
        camera_background=scene.environment.camera_color,
        background_light=background_light,
        is_see_through=is_see_through(scene.closures),
        film_transparent=scene.film_transparent,
        lamp_shapes=build_lamp_shapes(lights, rays_that_meet_lamps(scene.closures)),
        sampler=build_sampler(
            lights, bound_lights(lights), settings.sampler, settings.tree, settings.num_threads
        ),
    )


def is_see_through(closures: Closures) -> bool:
    """Whether light goes, or may go, straight through some surface."""
    is_principled = closures.kind == PRINCIPLED
    may_differ = (closures.values[:, ALPHA] != 1) | (closures.value_texture[:, ALPHA] != NO_TEXTURE)
    return bool(np.any(closures.kind == TRANSPARENT) or np.any(is_principled & may_differ))


def rays_that_meet_lamps(closures: Closures) -> int:
    """Bits of the rays that look for lamps: those of the camera, and where something is glossy."""
    is_glossy = ~np.isin(closures.kind, (DIFFUSE, TRANSLUCENT, TRANSPARENT))
    return ALL_RAYS & ~DIFFUSE_RAY if is_glossy.any() else CAMERA_RAY


def _light_triangle(triangle_light: np.ndarray, num_lights: int) -> np.ndarray:
    """(L,) int32, the triangle that a light is a side of, 0 for any other light."""
    light_triangle = np.zeros(num_lights, np.int32)
    triangle, side = np.nonzero(triangle_light != NO_LIGHT)
    light_triangle[triangle_light[triangle, side]] = triangle
    return light_triangle
