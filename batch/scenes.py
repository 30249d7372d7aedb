"""Procedural scenes, seeded, saved as ordinary .blend files.

A recipe fills the empty file that is open in Blender with geometry, lights and cameras. What all
scenes share, the render settings and the saving, is here. To add a scene, add a line to `SCENES`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from . import thesis_scenes as thesis
from .city import build_city


@dataclass(frozen=True)
class SceneRecipe:
    """How to make a scene.

    fill: adds about `num_lights` lights, what they shine on, and at least the active camera to the
        empty file that is open, drawing all chance from the generator it is given.
    num_lights: how many lights, unless somebody asks for another number.
    min_lights: the fewest lights it makes sense with.
    """

    fill: Callable[[int, np.random.Generator], None]
    num_lights: int
    description: str
    min_lights: int = 1


MAX_LIGHTS = 10_000_000

SCENES = {
    "city-small": SceneRecipe(build_city, 1_000, "nine blocks of a city at night", 200),
    "city": SceneRecipe(build_city, 10_000, "a city at night, 600 m across", 200),
    "city-large": SceneRecipe(build_city, 100_000, "a city at night, 1.7 km across", 200),
    "city-million": SceneRecipe(build_city, 1_000_000, "a city at night, 5.5 km across", 200),
    "thesis-spots-20": SceneRecipe(thesis.build_spots, 20, "a room lit by 20 spots"),
    "thesis-ceiling-points": SceneRecipe(
        thesis.build_ceiling_points, 1_600_000, "1.6 million points below the ceiling"
    ),
    "thesis-raster-points": SceneRecipe(
        thesis.build_raster_points, 12_000, "points in a 3D grid throughout the room"
    ),
    "thesis-random-points": SceneRecipe(
        thesis.build_random_points, 12_000, "points anywhere in the room"
    ),
    "thesis-random-spots": SceneRecipe(
        thesis.build_random_spots, 12_000, "spots of random place, axis and aperture"
    ),
    "thesis-ceiling-triangles": SceneRecipe(
        thesis.build_ceiling_triangles, 2_000, "a ceiling of emitting triangles", 2
    ),
    "thesis-three-spheres": SceneRecipe(
        thesis.build_three_spheres,
        6_000,
        "three spheres of emitting triangles, a ball of glass",
        36,
    ),
    "thesis-mixed": SceneRecipe(
        thesis.build_mixed, 14_000, "three spheres of triangles, spots and points", 84
    ),
}


def check_recipe(name: str, num_lights: int | None) -> None:
    """Raise ValueError, with what there is, for a scene that cannot be built."""
    if name not in SCENES:
        raise ValueError(f"There is no scene called {name!r}; there are {', '.join(SCENES)}.")
    least = SCENES[name].min_lights
    if num_lights is not None and not least <= num_lights <= MAX_LIGHTS:
        raise ValueError(
            f"Scene {name!r} needs {least:,} to {MAX_LIGHTS:,} lights, not {num_lights}."
        )


def build_scene(name: str, path: str | Path, num_lights: int | None = None, seed: int = 0) -> None:
    """Build the scene `name` of `SCENES` in an empty file and save it as `path`.

    Closes what is open in Blender. Equal name, lights and seed give an equal scene.
    """
    check_recipe(name, num_lights)
    recipe = SCENES[name]
    if num_lights is None:
        num_lights = recipe.num_lights
    bpy.ops.wm.read_factory_settings(use_empty=True)
    _set_render_settings(bpy.context.scene)
    recipe.fill(num_lights, np.random.default_rng(seed))
    _save(Path(path))


def _set_render_settings(scene: bpy.types.Scene) -> None:
    """Make Cycles unbiased, and its images comparable pixel by pixel."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = 640, 360
    scene.view_settings.view_transform = "Standard"

    cycles.samples = 64
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = cycles.diffuse_bounces = 4
    cycles.glossy_bounces = cycles.transmission_bounces = 4

    # Blender's defaults trade light for less noise; a comparison must not.
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.light_sampling_threshold = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.blur_glossy = 0.0


def _save(path: Path) -> None:
    """Save the open file as `path`, which never holds half a scene."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.stem}-{os.getpid()}.blend")
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(unfinished.absolute()), compress=True, copy=True)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
