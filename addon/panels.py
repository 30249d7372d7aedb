"""LightTree's panels, and Blender's own panels that make sense with it."""

import bpy

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
    "DATA_PT_EEVEE_light",
    "DATA_PT_spot",
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
}


class RENDER_PT_lighttree_sampling(bpy.types.Panel):
    bl_label = "Sampling"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {LightTreeEngine.bl_idname}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.lighttree
        for group in (("samples", "time_limit_s"), ("sampler", "split_lights"), ("max_bounces",)):
            column = layout.column(align=True)
            for name in group:
                column.prop(settings, name)
        column = layout.column(align=True)
        for name in ("mis", "seed", "strict"):
            column.prop(settings, name)


def _blender_panels():
    """Blender's panels that also work for LightTree."""
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, "COMPAT_ENGINES", ())
        name = panel.__name__
        if name in SHARED_PANELS or ("BLENDER_RENDER" in engines and name not in EXCLUDED_PANELS):
            yield panel


def register():
    bpy.utils.register_class(RENDER_PT_lighttree_sampling)
    for panel in _blender_panels():
        panel.COMPAT_ENGINES.add(LightTreeEngine.bl_idname)


def unregister():
    for panel in _blender_panels():
        panel.COMPAT_ENGINES.discard(LightTreeEngine.bl_idname)
    bpy.utils.unregister_class(RENDER_PT_lighttree_sampling)
