"""LightTree for Blender: a render engine for scenes with very many lights."""

from . import checkup, engine, panels, passes, properties

MODULES = (properties, passes, engine, checkup, panels)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
