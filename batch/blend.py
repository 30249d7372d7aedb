"""Open .blend files safely, and take from them what a comparison must know beforehand."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from lighttree_addon.extract import extract_scene
from lighttree_core import Scene

from .methods import InputError


def open_blend(file: str, camera: str | None = None, frame: int | None = None) -> bpy.types.Scene:
    """The active scene of a .blend at a frame, looking through a camera; scripts do not run.

    camera, frame: None for those it was saved with.
    """
    try:
        bpy.ops.wm.open_mainfile(filepath=file, load_ui=False, use_scripts=False)
    except RuntimeError as error:
        reason = str(error).strip().removeprefix("Error: ").replace(f' in file "{file}"', "")
        raise InputError(f"{file}: Blender cannot open it ({reason}).") from error
    _check_versions_and_libraries(file)
    scene = bpy.context.scene
    if frame not in (None, scene.frame_current):
        scene.frame_set(frame)  # before the camera: a marker may be bound to another one
    cameras = {thing.name: thing for thing in scene.objects if thing.type == "CAMERA"}
    if camera is not None and camera not in cameras:
        names = ", ".join(cameras) or "none"
        raise InputError(f"{file}: there is no camera called '{camera}'; there is {names}.")
    if camera is not None:
        scene.camera = cameras[camera]
    if scene.camera is None:
        raise InputError(f"{file}: the scene has no active camera; set one in Blender.")
    return scene


def keep_shown(file: str, scene: str, view_layer: str) -> None:
    """Save a .blend anew with another scene active, and only one view layer in it to render."""
    open_blend(file)
    kept = bpy.data.scenes[scene]
    bpy.context.window.scene = kept
    for layer in list(kept.view_layers):
        if layer.name != view_layer:
            kept.view_layers.remove(layer)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_factory_settings(use_empty=True)  # or all of it would stay in memory


def _check_versions_and_libraries(file: str) -> None:
    """Refuse what Blender opens without a word, although it would render something else."""
    written, running = bpy.data.version[:2], bpy.app.version[:2]
    if written > running:
        raise InputError(
            f"{file}: written by Blender {written[0]}.{written[1]}, newer than this Blender "
            f"{running[0]}.{running[1]}; use a newer one, or save the file in an older format."
        )
    if missing := [library.filepath for library in bpy.data.libraries if library.is_missing]:
        raise InputError(
            f"{file}: the linked library {missing[0]} is missing; put it back, or make the linked "
            "data local in Blender."
        )


def list_files() -> list[str]:
    """The files that the open .blend draws upon, but for those that are part of Blender."""
    blender = bpy.utils.system_resource("DATAFILES")
    paths = bpy.utils.blend_paths(absolute=True, packed=False)
    return sorted(path for path in paths if not Path(path).is_relative_to(blender))


def list_fixed_files() -> list[str]:
    """Those among them that it would not find from another folder."""
    paths = set(bpy.utils.blend_paths(absolute=False, packed=False))
    return [path for path in list_files() if path in paths and os.path.isfile(path)]


class _Extractor(bpy.types.RenderEngine):
    """Extracts instead of rendering: only a render's depsgraph has all that will be rendered."""

    bl_idname = "LIGHTTREE_EXTRACTOR"
    bl_label = "LightTree extractor"
    result: Scene | Exception | None = None

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        try:
            _Extractor.result = extract_scene(depsgraph)
        except Exception as error:  # Blender would print it and go on
            _Extractor.result = error


def extract(scene: bpy.types.Scene) -> Scene:
    """LightTree's view of a scene as it would be rendered, checked."""
    bpy.utils.register_class(_Extractor)
    engine, scene.render.engine = scene.render.engine, _Extractor.bl_idname
    try:
        bpy.ops.render.render()
    finally:
        scene.render.engine = engine
        bpy.utils.unregister_class(_Extractor)
    result, _Extractor.result = _Extractor.result, None
    if isinstance(result, Exception):
        raise result
    result.check()
    return result
