"""A look through the open scene without rendering it: its lights, their tree, what is not modelled.

It sees what the viewport shows. The last one is kept until another file is opened.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import bpy
from bpy.app.handlers import persistent

from lighttree_core import SceneError
from lighttree_core.compilation import are_kernels_compiled
from lighttree_core.light_tree.nodes import LightTree
from lighttree_core.light_tree.sample import build_sampler
from lighttree_core.lights import LightBounds, bound_lights, build_lights, count_lights

from .extract import extract_scene
from .nodes import Notes
from .properties import render_settings
from .viewport import redraw_views


class Checkup(NamedTuple):
    """What was found. lights: how many of each kind. findings: (names, what is true of them)."""

    scene_name: str
    lights: dict[str, int]
    tree: LightTree
    bounds: LightBounds
    build_seconds: float
    findings: list[tuple[list[str], str]]


last: Checkup | None = None


def found_in(scene) -> Checkup | None:
    """What was found in a Blender scene, None if nobody looked."""
    return last if last and last.scene_name == scene.name else None


def look(context) -> None:
    """Look through the scene that is open and keep what is found; SceneError as `check_scene`."""
    global last
    if not bpy.app.background and not are_kernels_compiled():
        raise SceneError("Kernels are being compiled: look again when that is done.")
    last = check_scene(context.evaluated_depsgraph_get())
    redraw_views(context)


def check_scene(depsgraph) -> Checkup:
    """Look through an evaluated scene; SceneError for one that cannot be rendered."""
    notes, settings = Notes(), render_settings(depsgraph.scene)
    scene = extract_scene(depsgraph, notes=notes)
    scene.check()
    lights, *_ = build_lights(scene)
    bounds = bound_lights(lights)
    how = {"options": settings.tree, "threads": settings.num_threads}
    # A tree of one light first, so that loading the kernels is not timed.
    build_sampler(lights, type(bounds)(*(column[:1] for column in bounds)), **how)
    start = time.perf_counter()
    sampler = build_sampler(lights, bounds, **how)
    seconds = time.perf_counter() - start
    name = depsgraph.scene.name
    return Checkup(name, count_lights(lights), sampler.tree, bounds, seconds, notes.items())


class LIGHTTREE_OT_check_scene(bpy.types.Operator):
    """Count the lights, build their tree, and list what LightTree renders otherwise than Cycles"""

    bl_idname = "lighttree.check_scene"
    bl_label = "Check Scene"

    def execute(self, context):
        try:
            look(context)
        except SceneError as error:
            self.report({"ERROR"}, f"LightTree: {error}")
            return {"CANCELLED"}
        num = len(last.findings)
        found = f"{num} things are not modelled" if num > 1 else "1 thing is not modelled"
        self.report({"INFO"}, found if num else "All of the scene is modelled")
        return {"FINISHED"}


class LIGHTTREE_OT_select_found(bpy.types.Operator):
    """Select the objects that this is about"""

    bl_idname = "lighttree.select_found"
    bl_label = "Select"
    bl_options = {"REGISTER", "UNDO"}

    index: bpy.props.IntProperty(name="Finding", min=0, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context):
        return last is not None and context.mode == "OBJECT"

    def execute(self, context):
        if self.index >= len(last.findings):
            return {"CANCELLED"}
        names = set(last.findings[self.index][0])
        found = [item for item in context.view_layer.objects if names & _names(item)]
        if not found:
            self.report({"WARNING"}, "No object of this view layer has it")
            return {"CANCELLED"}
        for item in context.view_layer.objects:
            item.select_set(item in found)
        context.view_layer.objects.active = found[0]
        return {"FINISHED"}


def _names(item) -> set[str]:
    """What notes may call an object: by its own name, its materials', or its light's."""
    materials = {f"Material {slot.material.name}" for slot in item.material_slots if slot.material}
    light = {f"Light {item.data.name}"} if item.type == "LIGHT" else set()
    return {item.name} | materials | light


@persistent
def _forget(*_):
    global last
    last = None


OPERATORS = LIGHTTREE_OT_check_scene, LIGHTTREE_OT_select_found


def register():
    for operator in OPERATORS:
        bpy.utils.register_class(operator)
    bpy.app.handlers.load_post.append(_forget)


def unregister():
    _forget()
    bpy.app.handlers.load_post.remove(_forget)
    for operator in reversed(OPERATORS):
        bpy.utils.unregister_class(operator)
