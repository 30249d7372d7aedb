"""LightTree's panels of lights, objects and view layers: settings it shares with Cycles."""

import bpy

from .lamps import RAY_BITS
from .panels import LightTreePanel

SEEN_TYPES = ("MESH", "CURVE", "SURFACE", "FONT", "META", "LIGHT")


class DATA_PT_lighttree_rays(LightTreePanel, bpy.types.Panel):
    bl_label = "Rays"
    bl_context = "data"
    bl_parent_id = "DATA_PT_EEVEE_light"

    @classmethod
    def poll(cls, context):
        return context.light and super().poll(context)

    def draw(self, context):
        light = context.light
        self.layout.use_property_split = True
        if light.type == "AREA":
            self.layout.prop(light, "spread")
        self.layout.prop(light, "use_shadow", text="Cast Shadow")


class OBJECT_PT_lighttree_ray_visibility(LightTreePanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_visibility"

    @classmethod
    def poll(cls, context):
        thing = context.object
        is_seen = thing and (thing.type in SEEN_TYPES or thing.instance_type != "NONE")
        return is_seen and super().poll(context)

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        column = self.layout.column()
        for ray in RAY_BITS:
            # Whether a light is shadowed, its own data tells.
            if ray != "shadow" or context.object.type != "LIGHT":
                column.prop(context.object, f"visible_{ray}", text=ray.capitalize())


class VIEWLAYER_PT_lighttree_passes(LightTreePanel, bpy.types.Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context):
        layer = context.view_layer
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        column = self.layout.column(heading="Data", align=True)
        column.prop(layer, "use_pass_z", text="Depth")
        column.prop(layer, "use_pass_normal", text="Normal")
        column = self.layout.column(heading="Diffuse", align=True)
        column.prop(layer, "use_pass_diffuse_direct", text="Direct")
        column.prop(layer, "use_pass_diffuse_indirect", text="Indirect")
        column.prop(layer, "use_pass_diffuse_color", text="Color")
        column = self.layout.column(heading="Other", align=True)
        column.prop(layer, "use_pass_emit", text="Emission")
        column.prop(layer.lighttree, "use_pass_variance", text="Variance")


class VIEWLAYER_PT_lighttree_override(LightTreePanel, bpy.types.Panel):
    bl_label = "Override"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.layout.prop(context.view_layer, "material_override")
        self.layout.prop(context.view_layer, "world_override")


PANELS = (
    DATA_PT_lighttree_rays,
    OBJECT_PT_lighttree_ray_visibility,
    VIEWLAYER_PT_lighttree_passes,
    VIEWLAYER_PT_lighttree_override,
)


def register():
    for panel in PANELS:
        bpy.utils.register_class(panel)


def unregister():
    for panel in reversed(PANELS):
        bpy.utils.unregister_class(panel)
