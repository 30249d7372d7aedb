"""The settings an artist makes, kept with each Blender scene as `scene.lighttree`."""

from dataclasses import fields

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from lighttree_core import SceneError, Settings
from lighttree_core.camera import BLACKMAN_HARRIS
from lighttree_core.light_tree.nodes import NUM_LANES
from lighttree_core.light_tree.options import MAX_BUCKETS, TreeOptions

DEFAULTS = Settings()
TREE_DEFAULTS = DEFAULTS.tree


class LightTreeSettings(bpy.types.PropertyGroup):
    """`lighttree_core.Settings` as Blender properties; threads are Blender's own setting."""

    samples: IntProperty(
        name="Samples",
        description="Samples for each pixel; with a time limit, at most so many",
        default=DEFAULTS.samples,
        min=1,
        soft_max=4096,
    )
    viewport_samples: IntProperty(
        name="Viewport Samples",
        description="Samples for each pixel in rendered shading of a 3D view; 0 for no end",
        default=1024,
        min=0,
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
        name="Light Samples",
        description="Lights chosen at each surface the camera sees and at the next one a path "
        "meets; one at later ones",
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
    max_passes: IntProperty(
        name="Transparent",
        description="Transparent surfaces that light may go straight through, beside its bounces",
        default=DEFAULTS.max_passes,
        min=0,
        soft_max=64,
        max=1024,
    )
    seed: IntProperty(
        name="Seed",
        description="Another seed gives other noise",
        default=DEFAULTS.seed,
        min=0,
    )
    use_animated_seed: BoolProperty(
        name="Animate Seed",
        description="Give each frame of an animation a seed of its own, so that its noise does not "
        "stand still while things move",
        default=False,
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
    # Blender's images are filtered like this by Cycles too, unless one asks for another filter.
    filter: EnumProperty(
        name="Pixel Filter",
        description="What a pixel takes of the image around it",
        items=(
            ("box", "Box", "The pixel itself: the sharpest, with jagged edges where it is bright"),
            ("gaussian", "Gaussian", "A bell: soft"),
            ("blackman-harris", "Blackman-Harris", "A bell that ends: as Cycles by default"),
        ),
        default=BLACKMAN_HARRIS,
    )
    filter_width_px: FloatProperty(
        name="Width",
        description="Of the filter, in pixels; a box is one pixel wide at any width",
        default=DEFAULTS.filter_width_px,
        min=0.01,
        max=10,
        subtype="PIXEL",
    )
    tree_split: EnumProperty(
        name="Split",
        description="How a set of lights is cut in two when the tree is built",
        items=(
            ("saoh", "Area and Orientation", "By surface area, power and directions of emission"),
            ("sah", "Area", "By surface area alone"),
            ("middle", "Middle", "Halfway along the longest side"),
            ("equal", "Equal Counts", "As many lights on either side"),
        ),
        default=TREE_DEFAULTS.split,
    )
    tree_thin_box: BoolProperty(
        name="Avoid Thin Boxes",
        description="Count cuts across the shorter sides of a box as costlier; of Split by area "
        "and orientation alone",
        default=TREE_DEFAULTS.thin_box,
    )
    tree_buckets: IntProperty(
        name="Buckets",
        description="Cuts are tried at the bounds of so many buckets along each side; 0 for all "
        "cuts, else 2 and more",
        default=TREE_DEFAULTS.buckets,
        min=0,
        max=MAX_BUCKETS,
    )
    tree_bucket_kind: EnumProperty(
        name="Bucket Kind",
        description="What all buckets have in common",
        items=(
            ("width", "Equal Width", "They are equally wide"),
            ("count", "Equal Count", "They hold as many lights each"),
        ),
        default=TREE_DEFAULTS.bucket_kind,
    )
    tree_cone_axis: EnumProperty(
        name="Cone Axis",
        description="Where a set of lights points to while cuts are compared",
        items=(
            ("mean", "Mean", "The mean direction of its lights"),
            ("union", "Union", "The axis of a cone around the cones of its lights"),
        ),
        default=TREE_DEFAULTS.cone_axis,
    )
    tree_width: IntProperty(
        name="Width",
        description="Children of each node",
        default=TREE_DEFAULTS.width,
        min=2,
        max=NUM_LANES,
    )
    tree_importance: EnumProperty(
        name="Importance",
        description="How a node is weighed at a point of a surface",
        items=(
            ("moments", "Moments", "By where its lights are and shine to on average"),
            ("clamped", "Bounds, Clamped", "By bounds alone, as Conty and Kulla do"),
            ("cutoff", "Bounds, Cut Off", "By bounds alone, as in the thesis of Beini Ma"),
        ),
        default=TREE_DEFAULTS.importance,
    )
    tree_split_threshold: FloatProperty(
        name="Split Threshold",
        description="Sets of lights whose distances from a point vary by less than this share get "
        "one light sample at most; 1 for no splitting",
        default=TREE_DEFAULTS.split_threshold,
        min=0,
        max=1,
    )
    strict: BoolProperty(
        name="Strict",
        description="Refuse to render a scene with anything that LightTree does not model",
        default=False,
    )


def render_settings(scene: bpy.types.Scene) -> Settings:
    """The settings of a Blender scene for the renderer; SceneError if one makes no sense."""
    chosen = scene.lighttree
    render = scene.render
    names = [field.name for field in fields(TreeOptions)]
    settings = Settings(
        samples=chosen.samples,
        time_limit_s=chosen.time_limit_s,
        sampler=chosen.sampler,
        split_lights=chosen.split_lights,
        tree=TreeOptions(**{name: getattr(chosen, f"tree_{name}") for name in names}),
        max_bounces=chosen.max_bounces,
        max_passes=chosen.max_passes,
        seed=(chosen.seed + scene.frame_current * chosen.use_animated_seed) % 2**31,
        threads=render.threads if render.threads_mode == "FIXED" else 0,
        mis=chosen.mis,
        filter=chosen.filter,
        filter_width_px=chosen.filter_width_px,
    )
    try:
        settings.check()
    except ValueError as error:
        raise SceneError(f"{error}.") from error
    return settings


def register():
    bpy.utils.register_class(LightTreeSettings)
    bpy.types.Scene.lighttree = PointerProperty(type=LightTreeSettings)


def unregister():
    del bpy.types.Scene.lighttree
    bpy.utils.unregister_class(LightTreeSettings)
