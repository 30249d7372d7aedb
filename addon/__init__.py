"""LightTree for Blender: a render engine for scenes with very many lights."""

try:
    from . import (
        checkup,
        command,
        compare,
        data_panels,
        engine,
        kernels,
        overlay,
        panels,
        passes,
        picture,
        preset_menus,
        properties,
    )
except (ImportError, OSError) as error:  # a library is missing, or made for another system
    from . import missing

    missing.reason = str(error)
    MODULES = (missing,)
else:
    MODULES = (
        properties,
        passes,
        engine,
        checkup,
        overlay,
        compare,
        picture,
        preset_menus,
        panels,
        data_panels,
        command,
        kernels,
    )


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
