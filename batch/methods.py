"""The methods that are compared, and the settings that make their comparison fair.

Both engines render the same file with the same camera, resolution, bounces, threads, box filter
and exposure. Whatever trades light for less noise, or work for looks, is off in both. Motion blur
and the shadow terminator offset are off too: LightTree has neither.
Nothing here imports bpy, so that the command line can list methods at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lighttree_core.light_tree.options import TreeOptions

LIGHTTREE, CYCLES = "LIGHTTREE", "CYCLES"

# More samples than any time limit lets through. Cycles is no slower or noisier for it (measured).
ENDLESS = 2**20


class InputError(ValueError):
    """What was asked for cannot be done; the message names it and the way out."""


@dataclass(frozen=True)
class Method:
    """An engine (its Blender id) and how its settings differ from the comparison's.

    lamp_mis: whether Cycles' scattered rays look for lamps too, as by default. With thousands of
    lamps that costs Cycles most of its time, as every ray tests every lamp.
    """

    engine: str
    description: str
    overrides: dict[str, Any] = field(default_factory=dict)
    lamp_mis: bool = True


METHODS = {
    "lighttree": Method(LIGHTTREE, "LightTree as shipped"),
    "lighttree-single": Method(LIGHTTREE, "one light a vertex, no splitting", {"split_lights": 1}),
    "lighttree-thesis": Method(
        LIGHTTREE,
        "the sampler of Ma's thesis: a binary tree of bounds, 1,000 buckets, no splitting",
        {
            "split_lights": 1,
            "tree_width": 2,
            "tree_importance": "cutoff",
            "tree_split": "saoh",
            "tree_thin_box": False,
            "tree_buckets": 1000,
            "tree_bucket_kind": "count",
            "tree_cone_axis": "mean",
        },
    ),
    "lighttree-power": Method(LIGHTTREE, "lights chosen by power alone", {"sampler": "power"}),
    "lighttree-uniform": Method(LIGHTTREE, "all lights equally likely", {"sampler": "uniform"}),
    "cycles": Method(CYCLES, "Cycles with its light tree", {"use_light_tree": True}),
    "cycles-no-tree": Method(CYCLES, "Cycles without its light tree", {"use_light_tree": False}),
    "cycles-no-lamp-mis": Method(
        CYCLES,
        "Cycles with its light tree, lamps sampled as lights alone",
        {"use_light_tree": True},
        lamp_mis=False,
    ),
    "cycles-guiding": Method(
        CYCLES, "Cycles with tree and path guiding", {"use_light_tree": True, "use_guiding": True}
    ),
}

RENDER_SETTINGS = {
    "resolution_percentage": 100,
    "use_border": False,
    "use_multiview": False,
    "use_motion_blur": False,
    "use_simplify": False,
    "use_freestyle": False,
    "use_compositing": False,
    "use_sequencer": False,
    "use_persistent_data": False,
    "use_single_layer": False,
    "film_transparent": False,
    "threads_mode": "FIXED",
}
VIEW_LAYER_SETTINGS = {"samples": 0, "material_override": None, "world_override": None}
CYCLES_SETTINGS = {
    "device": "CPU",
    "feature_set": "SUPPORTED",
    "shading_system": False,
    "use_auto_tile": False,
    "use_adaptive_sampling": False,
    "use_denoising": False,
    "use_guiding": False,
    "use_fast_gi": False,
    "use_sample_subset": False,
    "use_animated_seed": False,
    "auto_scrambling_distance": False,
    "scrambling_distance": 1.0,
    "sampling_pattern": "AUTOMATIC",
    "direct_light_sampling_type": "MULTIPLE_IMPORTANCE_SAMPLING",
    "sample_offset": 0,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "light_sampling_threshold": 0.0,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "blur_glossy": 0.0,
    "min_light_bounces": 0,
    "min_transparent_bounces": 0,
    "transparent_max_bounces": 8,
    "volume_bounces": 0,
    "film_exposure": 1.0,
    "pixel_filter_type": "BOX",
}
CYCLES_DEPTHS = ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces")
# Settings that only some of the supported Blender versions have.
VERSION_DEPENDENT = {"feature_set", "save_output", "media_type", "world_override"}


def configure(
    data: Any,
    scene: Any,
    method: Method,
    *,
    resolution: Iterable[int],
    bounces: int,
    threads: int,
    seed: int,
    budget: dict[str, float],
) -> None:
    """Set a loaded scene of `data` (bpy.data) up to be rendered by a method of a comparison.

    budget: {"seconds": s} or {"samples": n}.
    """
    render = scene.render
    render.engine = method.engine
    render.resolution_x, render.resolution_y = resolution
    render.threads = threads
    assign(render, RENDER_SETTINGS)
    _configure_objects(data.objects)
    for light in data.lights:
        if light.cycles.use_multiple_importance_sampling != method.lamp_mis:
            light.cycles.use_multiple_importance_sampling = method.lamp_mis
    _configure_view_layers(scene.view_layers)
    samples, seconds = budget.get("samples", ENDLESS), budget.get("seconds", 0)
    if method.engine == CYCLES:
        depths = dict.fromkeys(CYCLES_DEPTHS, bounces)
        assign(scene.cycles, CYCLES_SETTINGS | depths | method.overrides)
        assign(scene.cycles, {"seed": seed, "samples": samples, "time_limit": seconds})
    else:
        for name in _lighttree_properties(scene):
            scene.lighttree.property_unset(name)
        assign(scene.lighttree, {"max_bounces": bounces, "filter": "box"} | method.overrides)
        assign(scene.lighttree, {"seed": seed, "samples": samples, "time_limit_s": seconds})


def engine_settings(scene: Any) -> dict[str, Any]:
    """The settings a scene's engine is about to use, for the record."""
    if scene.render.engine == CYCLES:
        names = [*CYCLES_SETTINGS, *CYCLES_DEPTHS, "use_light_tree", "seed", "time_limit"]
        return {name: getattr(scene.cycles, name) for name in names if hasattr(scene.cycles, name)}
    return {name: getattr(scene.lighttree, name) for name in _lighttree_properties(scene)}


def _lighttree_properties(scene: Any) -> list[str]:
    properties = scene.lighttree.bl_rna.properties
    return [
        prop.identifier for prop in properties if not prop.is_readonly and prop.identifier != "name"
    ]


def tree_options(properties: dict[str, Any]) -> TreeOptions:
    """The light tree that properties of `scene.lighttree` describe, those with tree_ in front."""
    from lighttree_core.light_tree.options import TreeOptions

    tree = {name: value for name, value in properties.items() if name.startswith("tree_")}
    return TreeOptions(**{name.removeprefix("tree_"): value for name, value in tree.items()})


def write_float_exr_to(render: Any, path: str, every_pass: bool = False) -> None:
    """Have a render's settings write one 32-bit EXR, uncompressed so that writing takes no time.

    every_pass: of all view layers, instead of the colours alone.
    """
    render.filepath = path
    render.use_file_extension = False
    assign(render, {"save_output": True})
    media, format, colors = "IMAGE", "OPEN_EXR", "RGB"
    if every_pass:
        media, format, colors = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER", "RGBA"
    assign(render.image_settings, {"media_type": media, "file_format": format})
    assign(render.image_settings, {"color_mode": colors, "color_depth": "32", "exr_codec": "NONE"})
    assign(render.image_settings, {"color_management": "FOLLOW_SCENE"})


def assign(target: Any, values: dict[str, Any]) -> None:
    """Set properties by name; skip one only where this version of Blender may lack it."""
    for name, value in values.items():
        if name not in VERSION_DEPENDENT or hasattr(target, name):
            setattr(target, name, value)


def _configure_objects(objects: Iterable[Any]) -> None:
    # Write only what differs: each write makes Blender evaluate the object again.
    for thing in objects:
        if thing.type == "MESH":
            if thing.shadow_terminator_geometry_offset:
                thing.shadow_terminator_geometry_offset = 0.0
            if thing.shadow_terminator_shading_offset:
                thing.shadow_terminator_shading_offset = 0.0
            for modifier in thing.modifiers:
                if getattr(modifier, "use_adaptive_subdivision", False):
                    modifier.use_adaptive_subdivision = False


def _configure_view_layers(view_layers: Iterable[Any]) -> None:
    """Render the first view layer that is used, without passes that cost time for nothing."""
    first = next(layer.name for layer in view_layers if layer.use)
    for layer in view_layers:
        layer.use = layer.name == first
        assign(layer, VIEW_LAYER_SETTINGS)
        for name in dir(layer):
            if name.startswith("use_pass_") and not name.startswith("use_pass_cryptomatte_acc"):
                setattr(layer, name, name == "use_pass_combined")
        layer.cycles.denoising_store_passes = False
