"""The picture of a comparison in Blender's Image Editor: an image that no file ever gets to hold.

It is runtime data, which Blender does not save. Neither does it keep it for undo, so the editors
that show it get it back after each step.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

NAME = "LightTree Comparison"

_path = ""
_shown_in: set[int] = set()  # areas, by address


def show_picture(context, path: str) -> bool:
    """Show an image file in an Image Editor, a new one if there is none; whether it is shown."""
    image = load_picture(path)
    if not _find_editors(context):
        _open_editor()
    for window, area in _find_editors(context):
        area.spaces.active.image = image
        region = next(region for region in area.regions if region.type == "WINDOW")
        with context.temp_override(window=window, area=area, region=region):
            bpy.ops.image.view_all(fit_view=True)
        return True
    return False


def load_picture(path: str) -> bpy.types.Image:
    """An image file as an image of Blender, the same one each time."""
    global _path
    _path = path
    if image := find_picture():
        image.filepath = path
        image.reload()
        return image
    image = bpy.data.images.load(path)
    image.name = NAME
    image.is_runtime_data = True
    return image


def find_picture() -> bpy.types.Image | None:
    pictures = (i for i in bpy.data.images if i.is_runtime_data and i.name.startswith(NAME))
    return next(pictures, None)


def _open_editor() -> None:
    """Open what the user wants for renders; it comes with an image for them, which may not stay."""
    images = set(bpy.data.images)
    bpy.ops.render.view_show("INVOKE_DEFAULT")
    for image in set(bpy.data.images) - images:
        bpy.data.images.remove(image)


def _find_editors(context) -> list[tuple]:
    """Window and area of each editor that just shows an image."""
    return [
        (window, area)
        for window in context.window_manager.windows
        for area in window.screen.areas
        if area.ui_type == "IMAGE_EDITOR" and area.spaces.active.mode == "VIEW"
    ]


@persistent
def _note_editors(*_) -> None:
    """Before undo or redo: which editors show the picture."""
    _shown_in.clear()
    if image := find_picture():
        editors = _find_editors(bpy.context)
        _shown_in.update(a.as_pointer() for _, a in editors if a.spaces.active.image == image)


@persistent
def _fill_editors(*_) -> None:
    """After it: show it there again."""
    for _, area in _find_editors(bpy.context):
        if area.as_pointer() in _shown_in and area.spaces.active.image is None:
            area.spaces.active.image = find_picture() or load_picture(_path)


HANDLERS = (
    ("undo_pre", _note_editors),
    ("undo_post", _fill_editors),
    ("redo_pre", _note_editors),
    ("redo_post", _fill_editors),
)


def register():
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister():
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
