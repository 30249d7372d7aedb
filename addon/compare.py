"""The button Compare with Cycles: it starts a comparison, can cancel it, and shows what it says."""

from __future__ import annotations

import atexit

import bpy
from bpy.app.handlers import persistent

from .comparison import CompareError, Comparison, LightTreeCompareSettings, prepare
from .picture import load_picture, show_picture

TICK_S = 0.2

last: Comparison | None = None  # it may be running


def summarize(result: dict) -> str:
    """The outcome in one sentence."""
    gain = result["table"][0]["gain"]
    if gain is None:
        return "LightTree and Cycles were compared"
    times, less = (gain, "less") if gain >= 1 else (1 / gain, "more")
    return f"LightTree: {format_number(times)} times {less} error than Cycles at equal time"


def format_number(value: float | None) -> str:
    """Three digits, or whole from 100 on; a dash if unknown."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


class LIGHTTREE_OT_compare(bpy.types.Operator):
    bl_idname = "lighttree.compare"
    bl_label = "Compare with Cycles"
    bl_description = (
        "Render this scene with LightTree and with Cycles for equal time and measure their errors. "
        "Both are unbiased and otherwise as shipped; bounces and threads are the scene's. "
        "Whatever else the computer does meanwhile costs one of them time"
    )
    bl_options = set()

    _timer = None

    @classmethod
    def poll(cls, context):
        return not (last and last.is_running)

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        _prepare(context)
        if last.error:
            return self._end(context)
        last.start()
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if last is None:  # ended for another file, which could not be opened
            context.window_manager.event_timer_remove(self._timer)
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            last.stop()
            return {"RUNNING_MODAL"}
        if event.type == "TIMER":
            _redraw(context)
            if not last.is_running:
                context.window_manager.event_timer_remove(self._timer)
                return self._end(context)
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Its window is closed, with or without Blender."""
        context.window_manager.event_timer_remove(self._timer)
        _end_last()

    def execute(self, context):
        _prepare(context)
        if not last.error:
            last.run()
        return self._end(context)

    def _end(self, context):
        if last.error:
            self.report({"ERROR"}, f"LightTree: {last.error}")
        if last.result is None:
            return {"CANCELLED"}
        picture = last.result["picture"]
        if bpy.app.background:
            load_picture(picture)
        elif not show_picture(context, picture):
            self.report({"INFO"}, f"The images are side by side in {picture}")
        self.report({"INFO"}, summarize(last.result))
        return {"FINISHED"}


class LIGHTTREE_OT_cancel_compare(bpy.types.Operator):
    """Stop comparing. What was rendered stays in the output folder"""

    bl_idname = "lighttree.cancel_compare"
    bl_label = "Cancel"
    bl_options = set()

    @classmethod
    def poll(cls, context):
        return last is not None and last.is_running

    def execute(self, context):
        last.stop()
        return {"FINISHED"}


def _prepare(context) -> None:
    global last
    try:
        last = prepare(context)
    except CompareError as error:
        last = Comparison(context.scene.name, error=str(error))


def _redraw(context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()


@persistent
def _end_last(*_) -> None:
    """Forget the last comparison, and end it if it is running."""
    global last
    if last:
        last.end()
    last = None


CLASSES = LightTreeCompareSettings, LIGHTTREE_OT_compare, LIGHTTREE_OT_cancel_compare


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.lighttree_compare = bpy.props.PointerProperty(type=LightTreeCompareSettings)
    bpy.app.handlers.load_pre.append(_end_last)
    atexit.register(_end_last)


def unregister():
    atexit.unregister(_end_last)
    _end_last()
    bpy.app.handlers.load_pre.remove(_end_last)
    del bpy.types.Scene.lighttree_compare
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
