"""Menus of presets in the headers of panels, as Cycles has them.

The presets that come with LightTree lie in `presets`; those that a user adds, Blender keeps.
"""

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

FOLDER = str(Path(__file__).parent)


class LightTreePresets(PresetPanel):
    """What the menus have in common."""

    preset_operator = "script.execute_preset"


class RENDER_PT_lighttree_sampling_presets(LightTreePresets, bpy.types.Panel):
    bl_label = "Sampling Presets"
    preset_subdir = "lighttree/sampling"
    preset_add_operator = "render.lighttree_sampling_preset_add"


class RENDER_PT_lighttree_light_paths_presets(LightTreePresets, bpy.types.Panel):
    bl_label = "Light Paths Presets"
    preset_subdir = "lighttree/light_paths"
    preset_add_operator = "render.lighttree_light_paths_preset_add"


class LightTreePresetAdd(AddPresetBase):
    """What adding to any of the menus has in common."""

    preset_defines = ["lighttree = bpy.context.scene.lighttree"]


class RENDER_OT_lighttree_sampling_preset_add(LightTreePresetAdd, bpy.types.Operator):
    """Add or remove a preset of Sampling"""

    bl_idname = "render.lighttree_sampling_preset_add"
    bl_label = "Add Sampling Preset"
    preset_menu = "RENDER_PT_lighttree_sampling_presets"
    preset_subdir = RENDER_PT_lighttree_sampling_presets.preset_subdir
    preset_values = ["lighttree.samples", "lighttree.time_limit_s", "lighttree.split_lights"]


class RENDER_OT_lighttree_light_paths_preset_add(LightTreePresetAdd, bpy.types.Operator):
    """Add or remove a preset of Light Paths"""

    bl_idname = "render.lighttree_light_paths_preset_add"
    bl_label = "Add Light Paths Preset"
    preset_menu = "RENDER_PT_lighttree_light_paths_presets"
    preset_subdir = RENDER_PT_lighttree_light_paths_presets.preset_subdir
    preset_values = ["lighttree.max_bounces", "lighttree.max_passes"]


CLASSES = (
    RENDER_PT_lighttree_sampling_presets,
    RENDER_PT_lighttree_light_paths_presets,
    RENDER_OT_lighttree_sampling_preset_add,
    RENDER_OT_lighttree_light_paths_preset_add,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.utils.register_preset_path(FOLDER)


def unregister():
    bpy.utils.unregister_preset_path(FOLDER)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
