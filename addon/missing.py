"""What LightTree is where a library it needs cannot be loaded: a message in its preferences."""

import platform
import textwrap

import bpy

reason = ""  # the import's own words

LINE_LENGTH = 80


def explain() -> list[str]:
    """Lines that say what is missing and what to do."""
    blender = f"Blender {bpy.app.version_string} (Python {platform.python_version()})"
    system = f"{platform.system()} {platform.machine()}"
    return [
        *textwrap.wrap(f"LightTree cannot start: {reason}", LINE_LENGTH),
        f"Its zip must be the one for {blender} on {system}.",
        "Uninstall LightTree, restart Blender, and install that zip.",
    ]


class LightTreePreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    def draw(self, context):
        column = self.layout.column(align=True)
        for index, line in enumerate(explain()):
            column.label(text=line, icon="NONE" if index else "ERROR")


def register():
    print(*explain(), sep="\n")
    bpy.utils.register_class(LightTreePreferences)


def unregister():
    bpy.utils.unregister_class(LightTreePreferences)
