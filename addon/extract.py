"""Blender's evaluated depsgraph -> Scene. Here Blender ends.

Every object arrives as an instance of some data, lights and meshes alike. What LightTree renders
otherwise than Cycles is told in `Scene.not_modelled`.
"""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from lighttree_core.scene import Camera, Scene, SceneError

from .camera import extract_camera
from .lamps import LampTable
from .meshes import MeshTable
from .nodes import Notes
from .world import read_world

# Of bpy.data, what may be linked from another file and is seen.
LINKED = ("collections", "objects", "meshes", "lights", "materials", "node_groups", "worlds")
COARSE_STEP = 0.01  # metres
LEFT_OUT = {
    "CURVES": "hair curves are left out.",
    "POINTCLOUD": "point clouds are left out.",
    "VOLUME": "volumes are left out.",
    "GREASEPENCIL": "Grease Pencil is left out.",
}


def extract_scene(
    depsgraph,
    camera: Camera | None = None,
    notes: Notes | None = None,
    known: Scene | None = None,
) -> Scene:
    """One frame of an evaluated depsgraph.

    camera: None for that of the scene. notes: gets what is not modelled, which is also told by the
    scene. known: one whose meshes and materials are still as they were: they are taken from it.
    Raises SceneError for what cannot be rendered at all.
    """
    notes = notes or Notes()
    scene, view_layer = depsgraph.scene_eval, depsgraph.view_layer_eval
    _check_working_space()
    camera = camera or extract_camera(depsgraph)
    background, environment = read_world(view_layer.world_override or scene.world, notes)
    _note_settings(scene, notes)
    _note_missing(notes)
    _note_distance(camera, notes)

    lamps, meshes = LampTable(notes), MeshTable(view_layer, notes)
    for instance in depsgraph.object_instances:
        thing = instance.object
        if not instance.show_self:
            continue
        # Text, curves and metaballs come a second time, as the mesh they make.
        if thing.type == "MESH":
            if known is None:
                meshes.add(thing, instance.matrix_world, instance.parent or thing)
        elif thing.type == "LIGHT":
            lamps.add(thing, instance.matrix_world)
        elif thing.type in LEFT_OUT:
            notes.add(thing.name, LEFT_OUT[thing.type])
    geometry = {} if known else meshes.geometry() | meshes.materials.tables()
    read = {
        "camera": camera,
        "lamps": lamps.lamps(),
        "background": background.astype(np.float32),
        "environment": environment,
        "film_transparent": scene.render.film_transparent,
        "not_modelled": notes.sentences(),
    }
    if known:
        return replace(known, **read)
    return Scene(**read, **geometry)


def _check_working_space():
    # Up to 4.5 there is no choice.
    space = getattr(getattr(bpy.data, "colorspace", None), "working_space", "Linear Rec.709")
    if space != "Linear Rec.709":
        raise SceneError(
            f"The working space of the file is {space}: LightTree renders in Linear Rec.709, set "
            "it under Scene properties > Color Management."
        )


def _note_distance(camera, notes):
    """Places are 32-bit floats, far from the origin coarser than what is seen."""
    farthest = np.abs(camera.world_from_camera[:, 3]).max()
    step = float(np.spacing(np.float32(farthest)))
    if step > COARSE_STEP:
        notes.add("Scene", f"{farthest:.0e} m from the origin, places are rounded to {step:.2g} m.")


def _note_missing(notes):
    """What is linked from other files and is not there: Blender goes on without it."""
    for library in bpy.data.libraries:
        if library.is_missing:
            notes.add(f"Library {library.filepath}", "missing, and what is linked from it.")
    for name in LINKED if bpy.data.libraries else ():
        for item in getattr(bpy.data, name):
            if item.library and item.is_missing and not item.library.is_missing:
                notes.add(f"{item.id_type.title()} {item.name}", f"not in {item.library.filepath}.")


def _note_settings(scene, notes):
    if scene.render.use_multiview:
        raise SceneError(
            "Stereoscopy is on, which LightTree does not render: switch it off under Output "
            "properties."
        )
    if scene.render.use_motion_blur:
        notes.add("Scene", "without motion blur.")
    glass_is_clear = getattr(getattr(scene, "cycles", None), "film_transparent_glass", False)
    if scene.render.film_transparent and glass_is_clear:
        notes.add("Scene", "the film is not transparent behind glass.")
