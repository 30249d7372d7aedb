"""The settings an artist makes, kept with each Blender scene as `scene.lighttree`."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from lighttree_core import Settings

DEFAULTS = Settings()


class LightTreeSettings(bpy.types.PropertyGroup):
    """`lighttree_core.Settings` as Blender properties; threads are Blender's own setting."""

    samples: IntProperty(
        name="Samples",
        description="Samples for each pixel; with a time limit, at most so many",
        default=DEFAULTS.samples,
        min=1,
        soft_max=4096,
    )
    time_limit_s: FloatProperty(
        name="Time Limit",
        description="Stop before the pass that would take longer than this; 0 for no limit",
        default=DEFAULTS.time_limit_s,
        min=0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    sampler: EnumProperty(
        name="Light Sampler",
        description="How a light is chosen for each point of a surface",
        items=(
            ("tree", "Light Tree", "By a hierarchy over all lights: best with many lights"),
            ("power", "Power", "By emitted power alone, wherever the surface is"),
            ("uniform", "Uniform", "Any light as often as any other"),
        ),
        default=DEFAULTS.sampler,
    )
    split_lights: IntProperty(
        name="Lights per Camera Hit",
        description="Lights chosen at each surface the camera sees, half as many with each "
        "bounce; best a power of two",
        default=DEFAULTS.split_lights,
        min=1,
        soft_max=16,
        max=64,
    )
    max_bounces: IntProperty(
        name="Max Bounces",
        description="How often light may be scattered before it reaches what the camera sees",
        default=DEFAULTS.max_bounces,
        min=0,
        soft_max=16,
        max=1024,
    )
    seed: IntProperty(
        name="Seed",
        description="Another seed gives other noise",
        default=DEFAULTS.seed,
        min=0,
    )
    mis: EnumProperty(
        name="MIS Heuristic",
        description="How light samples and scattered rays that find the same light are weighted",
        items=(
            ("power", "Power", "Squares of the densities (Veach)"),
            ("balance", "Balance", "The densities themselves"),
        ),
        default=DEFAULTS.mis,
    )
    strict: BoolProperty(
        name="Strict",
        description="Refuse to render a scene with anything that LightTree does not model",
        default=False,
    )


def render_settings(scene: bpy.types.Scene) -> Settings:
    """The settings of a Blender scene for the renderer."""
    chosen = scene.lighttree
    render = scene.render
    return Settings(
        samples=chosen.samples,
        time_limit_s=chosen.time_limit_s,
        sampler=chosen.sampler,
        split_lights=chosen.split_lights,
        max_bounces=chosen.max_bounces,
        seed=chosen.seed,
        threads=render.threads if render.threads_mode == "FIXED" else 0,
        mis=chosen.mis,
    )


def register():
    bpy.utils.register_class(LightTreeSettings)
    bpy.types.Scene.lighttree = PointerProperty(type=LightTreeSettings)


def unregister():
    del bpy.types.Scene.lighttree
    bpy.utils.unregister_class(LightTreeSettings)
