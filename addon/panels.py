"""LightTree's panels, and Blender's own panels that make sense with it."""

import textwrap
from pathlib import Path

import bpy

from lighttree_core.camera import BOX

from . import checkup, compare, overlay
from .comparison import estimate_s
from .engine import LightTreeEngine

# Panels of Blender's built-in engines that set what LightTree does not have.
EXCLUDED_PANELS = {
    "DATA_PT_camera_stereoscopy",
    "DATA_PT_light",
    "NODE_DATA_PT_light",
    "OBJECT_PT_shading",
    "RENDER_PT_gpencil",
    "RENDER_PT_output_views",
    "RENDER_PT_simplify",  # LightTree's own comes after its Sampling
    "RENDER_PT_stereoscopy",
    "VIEWLAYER_PT_filter",
    "VIEWLAYER_PT_layer_passes",
}
# EEVEE's panels over properties that every engine shares.
SHARED_PANELS = {
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "DATA_PT_EEVEE_light",
    "DATA_PT_spot",
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
    "MATERIAL_PT_preview",
}


class LightTreePanel:
    """What LightTree's own panels have in common."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {LightTreeEngine.bl_idname}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES


class RENDER_PT_lighttree_sampling(LightTreePanel, bpy.types.Panel):
    bl_label = "Sampling"

    def draw_header_preset(self, context):
        bpy.types.RENDER_PT_lighttree_sampling_presets.draw_panel_header(self.layout)

    def draw(self, context):
        settings = context.scene.lighttree
        _draw_settings(
            self.layout,
            settings,
            ("samples", "time_limit_s", "viewport_samples"),
            ("sampler", "split_lights", "mis"),
        )
        row = self.layout.row(align=True)
        row.prop(settings, "seed")
        row.prop(settings, "use_animated_seed", text="", icon="TIME")


class RENDER_PT_lighttree_tree(LightTreePanel, bpy.types.Panel):
    bl_label = "Light Tree"
    bl_parent_id = "RENDER_PT_lighttree_sampling"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.lighttree
        self.layout.active = settings.sampler == "tree"
        _draw_settings(
            self.layout,
            settings,
            ("tree_split", "tree_thin_box", "tree_buckets", "tree_bucket_kind", "tree_cone_axis"),
            ("tree_width", "tree_importance", "tree_split_threshold"),
        )
        found = checkup.found_in(context.scene)
        if found:
            column = self.layout.column(align=True)
            for kind, num in sorted(found.lights.items(), key=lambda item: -item[1]):
                column.label(text=f"{num:,} {kind} light{'' if num == 1 else 's'}")
            column.label(text=f"Depth {found.tree.depth}, built in {found.build_seconds:.2g} s")


class RENDER_PT_lighttree_overlay(LightTreePanel, bpy.types.Panel):
    bl_label = "Viewport Overlay"
    bl_parent_id = "RENDER_PT_lighttree_tree"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.window_manager.lighttree_overlay, "show", text="")

    def draw(self, context):
        settings = context.window_manager.lighttree_overlay
        self.layout.active = settings.show
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        column = self.layout.column(align=True)
        column.prop(settings, "depth", slider=True)
        column.prop(settings, "show_cones")
        if not settings.show:
            return
        if checkup.found_in(context.scene):
            lines = overlay.describe(context)
        else:
            self.layout.operator("lighttree.check_scene", icon="VIEWZOOM")
            lines = textwrap.wrap(settings.problem, _num_letters(context))
        column = self.layout.column(align=True)
        for line in lines:
            column.label(text=line)


class RENDER_PT_lighttree_light_paths(LightTreePanel, bpy.types.Panel):
    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, context):
        bpy.types.RENDER_PT_lighttree_light_paths_presets.draw_panel_header(self.layout)

    def draw(self, context):
        _draw_settings(self.layout, context.scene.lighttree, ("max_bounces", "max_passes"))


class RENDER_PT_lighttree_film(LightTreePanel, bpy.types.Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.lighttree
        names = ("filter",) if settings.filter == BOX else ("filter", "filter_width_px")
        _draw_settings(self.layout, settings, names)
        _draw_settings(self.layout, context.scene.render, ("film_transparent",))


class RENDER_PT_lighttree_simplify(LightTreePanel, bpy.types.Panel):
    bl_label = "Simplify"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.render, "use_simplify", text="")

    def draw(self, context):
        render = context.scene.render
        self.layout.active = render.use_simplify
        self.layout.use_property_split = True
        column = self.layout.column(align=True)
        column.prop(render, "simplify_subdivision_render", text="Max Subdivision")
        column.prop(render, "simplify_child_particles_render", text="Max Child Particles")


class RENDER_PT_lighttree_performance(LightTreePanel, bpy.types.Panel):
    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        render = context.scene.render
        _draw_settings(self.layout, render, ("threads_mode",))
        column = self.layout.column()
        column.enabled = render.threads_mode == "FIXED"
        column.prop(render, "threads")


class RENDER_PT_lighttree_not_modelled(LightTreePanel, bpy.types.Panel):
    bl_label = "Not Modelled"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        _draw_settings(self.layout, context.scene.lighttree, ("strict",))
        self.layout.operator("lighttree.check_scene", icon="VIEWZOOM")
        found = checkup.found_in(context.scene)
        if found and not found.findings:
            self.layout.label(text="All of the scene is modelled", icon="CHECKMARK")
        for index, (names, text) in enumerate(found.findings if found else ()):
            box = self.layout.box().column(align=True)
            names = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
            select = box.operator("lighttree.select_found", text=names, icon="RESTRICT_SELECT_OFF")
            select.index = index
            _draw_text(box, text[:1].upper() + text[1:], context)


class RENDER_PT_lighttree_compare(LightTreePanel, bpy.types.Panel):
    bl_label = "Compare with Cycles"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, last = self.layout, compare.last
        if last and last.is_running:
            layout.progress(factor=last.fraction, text=f"{last.fraction:.0%}")
            _draw_text(layout, last.text, context)
            layout.operator("lighttree.cancel_compare", icon="X")
            return
        names = ("seconds", "percentage", "folder"), ("no_lamp_mis",)
        _draw_settings(layout, context.scene.lighttree_compare, *names)
        layout.operator("lighttree.compare", icon="PLAY")
        layout.label(text=f"Takes about {_duration(estimate_s(context.scene))}", icon="TIME")
        if last and last.scene_name == context.scene.name:
            if last.error:
                _draw_text(layout.box(), last.error, context, icon="ERROR")
            if last.result:
                _draw_result(layout.box(), last.result, context)


def _draw_result(layout, result, context):
    """The table of a comparison, what to know about it, and its report."""
    _draw_text(layout, compare.summarize(result), context)
    table = layout.row()
    headings = table.column(align=True)
    for text in ("", "Time", "Samples", "Error", "Better"):
        headings.label(text=text)
    for line in result["table"]:
        time, samples, error, gain = (
            compare.format_number(line[name]) for name in ("seconds", "samples", "error", "gain")
        )
        times = "x" if line["gain"] else ""
        column = table.column(align=True)
        for text in (line["title"], f"{time} s", samples, error, gain + times):
            column.label(text=text)
    for note in result["notes"]:
        _draw_text(layout, note, context, icon="INFO")
    url = Path(result["report"]).as_uri()
    layout.operator("wm.url_open", text="Open Report", icon="URL").url = url


def _draw_text(layout, text, context, icon="NONE"):
    """A text in as many lines as it needs, the icon before the first."""
    column = layout.column(align=True)
    for line in textwrap.wrap(text, _num_letters(context)):
        column.label(text=line, icon=icon)
        icon = "BLANK1" if icon != "NONE" else icon


def _duration(seconds: float) -> str:
    """'50 seconds', '2 minutes'."""
    if seconds < 90:
        return f"{seconds:.0f} seconds"
    return f"{seconds / 60:.0f} minutes"


def _num_letters(context) -> int:
    """About how many letters a line of a panel holds."""
    width = context.region.width if context.region else 300
    scale = context.preferences.system.ui_scale or 1.0  # without a window there is none
    return max(20, int(width / (7.5 * scale)))


def _draw_settings(layout, settings, *groups):
    """Show settings by their names, those of a group close together."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    for group in groups:
        column = layout.column(align=True)
        for name in group:
            column.prop(settings, name)


PANELS = (
    RENDER_PT_lighttree_sampling,
    RENDER_PT_lighttree_tree,
    RENDER_PT_lighttree_overlay,
    RENDER_PT_lighttree_light_paths,
    RENDER_PT_lighttree_film,
    RENDER_PT_lighttree_simplify,
    RENDER_PT_lighttree_performance,
    RENDER_PT_lighttree_not_modelled,
    RENDER_PT_lighttree_compare,
)


def _blender_panels():
    """Blender's panels that also work for LightTree."""
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, "COMPAT_ENGINES", ())
        name = panel.__name__
        if name in SHARED_PANELS or ("BLENDER_RENDER" in engines and name not in EXCLUDED_PANELS):
            yield panel


def register():
    for panel in PANELS:
        bpy.utils.register_class(panel)
    for panel in _blender_panels():
        panel.COMPAT_ENGINES.add(LightTreeEngine.bl_idname)


def unregister():
    for panel in _blender_panels():
        panel.COMPAT_ENGINES.discard(LightTreeEngine.bl_idname)
    for panel in reversed(PANELS):
        bpy.utils.unregister_class(panel)
