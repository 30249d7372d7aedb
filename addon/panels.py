"""LightTree's panels, and Blender's own panels that make sense with it."""

import bpy

from lighttree_core.camera import BOX

from .engine import LightTreeEngine

# Panels of Blender's built-in engines that set what LightTree does not have.
EXCLUDED_PANELS = {
    "DATA_PT_light",
    "NODE_DATA_PT_light",
    "RENDER_PT_freestyle",
    "RENDER_PT_gpencil",
    "RENDER_PT_simplify",
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

    def draw(self, context):
        _draw_settings(
            self.layout,
            context.scene.lighttree,
            ("samples", "time_limit_s"),
            ("sampler", "split_lights"),
            ("max_bounces", "max_passes"),
            ("mis", "seed", "strict"),
        )


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


class RENDER_PT_lighttree_film(LightTreePanel, bpy.types.Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.lighttree
        names = ("filter",) if settings.filter == BOX else ("filter", "filter_width_px")
        _draw_settings(self.layout, settings, names)
        _draw_settings(self.layout, context.scene.render, ("film_transparent",))


def _draw_settings(layout, settings, *groups):
    """Show settings by their names, those of a group close together."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    for group in groups:
        column = layout.column(align=True)
        for name in group:
            column.prop(settings, name)


PANELS = (RENDER_PT_lighttree_sampling, RENDER_PT_lighttree_tree, RENDER_PT_lighttree_film)


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
