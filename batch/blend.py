"""Open .blend files safely, and take from them what a comparison must know beforehand."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from lighttree_addon.extract import extract_scene
from lighttree_core import Scene

from .auto_camera import add_camera
from .methods import InputError, assign
from .views import AS_SAVED, AUTO_CAMERA, View

# A scene is read and rendered by itself, whatever else its file makes of the picture.
RENDER_ALONE = {"use_sequencer": False, "use_compositing": False, "use_freestyle": False}


def open_blend(
    file: str,
    view: View = AS_SAVED,
    render: dict[str, Any] | None = None,
    needs_camera: bool = True,
) -> tuple[bpy.types.Scene, list[str]]:
    """The scene of a .blend that is to be seen, set as the active one, and warnings; scripts do not
    run.

    render: settings of `scene.render`, beside those of the file. Without a camera it is refused, or
    if none is needed, seen by one that looks at everything.
    """
    warnings = _load(file)
    scene = _choose(file, "scene", bpy.data.scenes, view.scene) or bpy.context.scene
    if scene != bpy.context.scene:
        bpy.context.window.scene = scene
    if view.frame not in (None, scene.frame_current):
        scene.frame_set(view.frame)  # before the camera: a marker may be bound to another one
    if bpy.app.autoexec_fail:
        what = bpy.app.autoexec_fail_message or "scripts"
        warnings.append(f"Scripts do not run, so what they drive stays as it was saved: {what}.")
    _choose_view_layer(file, scene, view.view_layer)
    assign(scene.render, render or {})  # before a camera is made to fit the frame
    _choose_camera(file, scene, view.camera)
    if scene.camera is None:
        sentence = "the scene has no active camera; set one in Blender"
        if needs_camera:
            raise InputError(
                f"{file}: {sentence}, or say --camera {AUTO_CAMERA} for one that looks at "
                "everything."
            )
        warnings.append(f"There is no camera: rendering needs one, or --camera {AUTO_CAMERA}.")
        scene.camera = add_camera(scene, AUTO_CAMERA)
    return scene, warnings


def _load(file: str) -> list[str]:
    """Open a file; what Blender warns of, in sentences."""
    warnings = []
    try:
        bpy.ops.wm.open_mainfile(filepath=file, load_ui=False, use_scripts=False)
    except RuntimeError as error:
        reason = str(error).strip().removeprefix("Error: ").replace(f' in file "{file}"', "")
        # Blender raises for whatever it would show in red, even if it has opened the file.
        if not bpy.data.filepath or not os.path.samefile(bpy.data.filepath, file):
            raise InputError(f"{file}: Blender cannot open it ({reason}).") from error
        warnings += [f"Blender: {line.removeprefix('Error: ')}" for line in reason.splitlines()]
    written, running = bpy.data.version[:2], bpy.app.version[:2]
    if written > running:
        warnings.append(
            f"The file was written by Blender {written[0]}.{written[1]}, newer than this Blender "
            f"{running[0]}.{running[1]}, which leaves out what it does not know."
        )
    return warnings


def _choose(file: str, kind: str, choices: bpy.types.bpy_prop_collection, name: str | None):
    """The one of that name, None for none; refuses a name that is not among them."""
    if name is not None and name not in choices:
        names = ", ".join(choices.keys()) or "none"
        raise InputError(f"{file}: there is no {kind} called '{name}'; there is {names}.")
    return None if name is None else choices[name]


def _choose_view_layer(file: str, scene: bpy.types.Scene, name: str | None) -> None:
    """Have one view layer rendered; None for those that are used for rendering."""
    if _choose(file, "view layer", scene.view_layers, name):
        for layer in scene.view_layers:
            layer.use = layer.name == name
    if not any(layer.use for layer in scene.view_layers):
        raise InputError(
            f"{file}: no view layer is used for rendering; name one with --view-layer, of: "
            f"{', '.join(scene.view_layers.keys())}."
        )


def _choose_camera(file: str, scene: bpy.types.Scene, name: str | None) -> None:
    cameras = {thing.name: thing for thing in scene.objects if thing.type == "CAMERA"}
    if name == AUTO_CAMERA and name not in cameras:
        scene.camera = add_camera(scene, AUTO_CAMERA)
    elif name is not None and name not in cameras:
        names = ", ".join(cameras) or "none"
        raise InputError(f"{file}: there is no camera called '{name}'; there is {names}.")
    elif name is not None:
        scene.camera = cameras[name]


def keep_shown(file: str, scene: str, view_layer: str) -> None:
    """Save a .blend anew with another scene active, and only one view layer in it to render."""
    _load(file)
    kept = bpy.data.scenes[scene]
    bpy.context.window.scene = kept
    for layer in list(kept.view_layers):
        if layer.name != view_layer:
            kept.view_layers.remove(layer)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_factory_settings(use_empty=True)  # or all of it would stay in memory


def list_scenes(file: str) -> list[dict]:
    """What each scene of a .blend has to render, the active one first."""
    _load(file)
    active = bpy.context.scene
    return [
        {
            "scene": scene.name,
            "view_layers": [layer.name for layer in scene.view_layers if layer.use],
            "unused_view_layers": [layer.name for layer in scene.view_layers if not layer.use],
            "cameras": [item.name for item in scene.objects if item.type == "CAMERA"],
            "camera": scene.camera.name if scene.camera else None,
            "frame": scene.frame_current,
            "frames": [scene.frame_start, scene.frame_end],
            "resolution": [scene.render.resolution_x, scene.render.resolution_y],
            "percentage": scene.render.resolution_percentage,
        }
        for scene in sorted(bpy.data.scenes, key=lambda scene: scene != active)
    ]


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
    results: list[Scene | Exception] = []

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        try:
            _Extractor.results.append(extract_scene(depsgraph))
        except Exception as error:  # Blender would print it and go on
            _Extractor.results.append(error)


def extract(scene: bpy.types.Scene) -> Scene:
    """LightTree's view of a scene as it would be rendered, checked; of its first view layer.

    What is not modelled is told of all its view layers.
    """
    bpy.utils.register_class(_Extractor)
    try:
        with render_alone(scene, engine=_Extractor.bl_idname):
            bpy.ops.render.render()
    finally:
        bpy.utils.unregister_class(_Extractor)
        results, _Extractor.results = _Extractor.results, []
    for result in results:
        if isinstance(result, Exception):
            raise result
        result.check()
    if not results:
        raise RuntimeError("Blender did not render the scene.")
    told = dict.fromkeys(sentence for result in results for sentence in result.not_modelled)
    return replace(results[0], not_modelled=list(told))


@contextmanager
def render_alone(scene: bpy.types.Scene, **changed: object) -> Iterator[None]:
    """Have renders show the scene and nothing else, with some render settings changed meanwhile."""
    changed = RENDER_ALONE | changed
    kept = {name: getattr(scene.render, name) for name in changed}
    assign(scene.render, changed)
    try:
        yield
    finally:
        assign(scene.render, kept)
