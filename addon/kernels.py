"""Compiling kernels while nobody waits: in the background, once LightTree is switched on.

The status bar and the preferences show how far that is. A render that comes meanwhile waits for
the same processes. Disabling LightTree and quitting Blender stop them.
"""

from __future__ import annotations

import logging
import threading

import bpy

from lighttree_core.compilation import Cancelled, are_kernels_compiled, compile_kernels

log = logging.getLogger(__name__)

REDRAW_S = 0.25
PATIENCE_S = 5.0  # for processes to end


class Compilation:
    """A thread that has kernels compiled. share, message: how far it is; failure: why it ended."""

    running: Compilation | None = None

    def __init__(self):
        self.share, self.message, self.failure = 0.0, "", ""
        self._is_cancelled = threading.Event()
        self._thread = threading.Thread(target=self._work, name="LightTree kernels", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def cancel(self) -> None:
        """Stop, and wait until no process is left."""
        self._is_cancelled.set()
        self._thread.join(PATIENCE_S)

    def _work(self) -> None:
        try:
            compile_kernels(self._tell, self._is_cancelled.is_set, background=True)
        except Cancelled:
            pass
        except Exception as error:
            log.exception("LightTree's kernels could not be compiled")
            self.failure = f"Kernels could not be compiled: {error}"

    def _tell(self, share: float, message: str) -> None:
        self.share, self.message = share, message


class LightTreePreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    def draw(self, context):
        running = Compilation.running
        if running and running.is_alive and running.message:
            self.layout.progress(factor=running.share, text=running.message)
            self.layout.label(text="Renders wait until this is done.", icon="INFO")
        elif are_kernels_compiled():
            self.layout.label(text="Kernels are compiled", icon="CHECKMARK")
        else:
            text = running.failure if running else ""
            self.layout.label(text=text or "The next render compiles kernels", icon="INFO")


def _show() -> float | None:
    """Show how far it is, as a timer; nothing once it is done."""
    running = Compilation.running
    is_alive = running is not None and running.is_alive
    if running and running.message:
        _set_status(f"LightTree: {running.message}" if is_alive else None)
    return REDRAW_S if is_alive else None


def _set_status(text: str | None) -> None:
    """Set what all status bars say, None for what Blender says there."""
    for workspace in bpy.data.workspaces:
        workspace.status_text_set(text)
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PREFERENCES":
                area.tag_redraw()


def register():
    bpy.utils.register_class(LightTreePreferences)
    if not bpy.app.background:  # there and in a bpy module the first render compiles
        Compilation.running = Compilation()
        bpy.app.timers.register(_show, first_interval=REDRAW_S, persistent=True)


def unregister():
    if bpy.app.timers.is_registered(_show):
        bpy.app.timers.unregister(_show)
        _set_status(None)
    if Compilation.running:
        Compilation.running.cancel()
        Compilation.running = None
    bpy.utils.unregister_class(LightTreePreferences)
