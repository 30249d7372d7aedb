"""The tables that kernels read, made from a scene."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .albedo_tables import AlbedoTables, load_albedo_tables
from .closures import ClosureTable, build_closures
from .features import Features, find_features, is_on, rays_that_meet_lamps
from .lamp_shapes import LampShapes, build_lamp_shapes
from .light_tree.sample import LightSampler, build_sampler
from .lights import NO_LIGHT, bound_lights, build_lights
from .scene import Scene
from .settings import Settings
from .textures import TextureTable, build_textures


class World(NamedTuple):
    """All that kernels read: geometry, materials, lights; rows as in `scene.Scene`.

    triangle_visible: (T,) bits of the rays that meet a triangle, (0,) where all meet all.
    triangle_light: (T, 2) lights of front and back; light_triangle: (L,) the way back. background:
    (1, 3). camera_background: (1, 3), or (0, 3) where the camera sees what other rays see.
    diameter: of all geometry.
    """

    features: Features
    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    uvs: np.ndarray
    colors: np.ndarray
    triangle_material: np.ndarray
    triangle_visible: np.ndarray
    triangle_light: np.ndarray
    light_triangle: np.ndarray
    albedo: np.ndarray
    first_closure: np.ndarray
    num_closures: np.ndarray
    closures: ClosureTable
    albedo_tables: AlbedoTables
    textures: TextureTable
    emission: np.ndarray
    emission_texture: np.ndarray
    background: np.ndarray
    camera_background: np.ndarray
    background_light: int
    diameter: np.float32
    lamp_shapes: LampShapes
    sampler: LightSampler


def build_world(scene: Scene, settings: Settings) -> World:
    """The tables of a scene, with its light tree."""
    lights, triangle_light, background_light = build_lights(scene)
    features, materials = find_features(scene, settings.light_passes), scene.materials
    extent = np.ptp(scene.vertices, axis=0) if len(scene.vertices) else np.zeros(3)

    def table(values, dtype):
        return np.ascontiguousarray(values, dtype)

    return World(
        features=features,
        vertices=table(scene.vertices, np.float32),
        triangles=table(scene.triangles, np.int32),
        corner_normals=table(scene.corner_normals, np.float32),
        uvs=table(scene.uvs, np.float32),
        colors=table(scene.colors, np.float32),
        triangle_material=table(scene.triangle_material, np.int32),
        triangle_visible=table(scene.triangle_visible(), np.int32),
        triangle_light=triangle_light,
        light_triangle=_light_triangle(triangle_light, len(lights.kind)),
        albedo=table(materials.albedo, np.float32),
        first_closure=table(materials.first_closure, np.int32),
        num_closures=table(materials.num_closures, np.int32),
        closures=build_closures(scene),
        albedo_tables=load_albedo_tables(),
        textures=build_textures(scene),
        emission=table(materials.emission, np.float32),
        emission_texture=table(materials.emission_texture, np.int32),
        background=table(scene.background[None], np.float32),
        camera_background=table(scene.environment.camera_color, np.float32),
        background_light=background_light,
        diameter=np.float32(2 * np.linalg.norm(extent) + 1e-20),
        lamp_shapes=build_lamp_shapes(
            lights, rays_that_meet_lamps(scene) if is_on(features.met_lamps) else 0
        ),
        sampler=build_sampler(
            lights, bound_lights(lights), settings.sampler, settings.tree, settings.num_threads
        ),
    )


def _light_triangle(triangle_light: np.ndarray, num_lights: int) -> np.ndarray:
    """(L,) int32, the triangle that a light is a side of, 0 for any other light."""
    light_triangle = np.zeros(num_lights, np.int32)
    triangle, side = np.nonzero(triangle_light != NO_LIGHT)
    light_triangle[triangle_light[triangle, side]] = triangle
    return light_triangle
