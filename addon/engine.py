"""The render engine: Blender's settings in, the film out to passes, messages to the user."""

from __future__ import annotations

import logging
import queue
import sys
import threading
import weakref
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent

from lighttree_core import Film, Scene, SceneError, Settings
from lighttree_core.compilation import Cancelled, are_kernels_compiled
from lighttree_core.render import Renderer

from .camera import view_camera
from .extract import extract_scene
from .passes import wanted_light_passes, wanted_passes
from .properties import render_settings
from .viewport import Viewport

try:
    import resource
except ModuleNotFoundError:
    resource = None  # on Windows

log = logging.getLogger(__name__)

PREVIEW_SAMPLES = 32
PATIENCE_S = 0.1  # between looks at whether the user has pressed Escape
# Called with (share done, message) by every render, for programs that run without a window.
progress_listener: Callable[[float, str], None] | None = None


class LightTreeEngine(bpy.types.RenderEngine):
    """`scene.render.engine = "LIGHTTREE"`."""

    bl_idname = "LIGHTTREE"
    bl_label = "LightTree"
    bl_use_eevee_viewport = True
    bl_use_preview = True
    bl_use_shading_nodes_custom = False

    # Of the last frame, view layer by view layer, those that went through.
    rendered: ClassVar[list[tuple[Film, Scene]]] = []

    viewport: Viewport | None = None

    def update_render_passes(self, scene=None, renderlayer=None):
        for item in wanted_passes(renderlayer):
            channels = item.channels
            self.register_pass(scene, renderlayer, item.name, len(channels), channels, item.kind)

    def render(self, depsgraph):
        # An exception that leaves here is swallowed, and can crash Blender when it writes the
        # image; a reported error stops the render cleanly.
        try:
            if self.is_preview:
                self._render_preview(depsgraph)
            else:
                self._render(depsgraph)
        except SceneError as error:
            self.report({"ERROR"}, f"LightTree: {error}")
        except Exception as error:
            log.exception("LightTree failed")
            self.report({"ERROR"}, f"LightTree failed: {error}. The console tells where.")

    def _render(self, depsgraph):
        self._progress(0.0, "Reading the scene")
        scene = extract_scene(depsgraph)
        if scene.not_modelled and depsgraph.scene.lighttree.strict:
            raise SceneError(
                "Strict is on and the scene has what is not modelled: "
                + " ".join(scene.not_modelled)
            )
        for sentence in scene.not_modelled:
            self.report({"WARNING"}, sentence)

        settings = render_settings(depsgraph.scene)
        light_passes = bool(wanted_light_passes(depsgraph.view_layer))
        settings = replace(settings, light_passes=light_passes)
        film = self._render_scene(scene, settings, depsgraph.view_layer)
        if film is None:
            return
        if film.dropped_samples:
            self.report({"WARNING"}, f"{film.dropped_samples} samples were not finite: left black.")
        if film.num_samples and not film.mean.any():
            self.report({"WARNING"}, "The image is black: no light reaches what the camera sees.")
        if not film.cancelled:
            self.rendered.append((film, scene))

    def _render_preview(self, depsgraph):
        """A material or world by itself, as in its tab.

        Only once kernels are compiled: nobody has asked for a picture, let alone for a wait.
        """
        if are_kernels_compiled():
            settings = Settings(samples=PREVIEW_SAMPLES)
            self._render_scene(extract_scene(depsgraph), settings, depsgraph.view_layer)

    def _render_scene(self, scene: Scene, settings: Settings, layer) -> Film | None:
        """Render into a layer of Blender's result; None if stopped before the first sample."""
        height, width = scene.camera.shape
        result = self.begin_result(0, 0, width, height, layer=layer.name)
        try:
            renderer = self._prepare(scene, settings)
            if renderer is None:
                return None
            return renderer.run(self.test_break, lambda film: self._show(film, result, layer))
        finally:
            self.end_result(result)

    def _prepare(self, scene: Scene, settings: Settings) -> Renderer | None:
        """A renderer of the scene, None if the user stops.

        Stopping ends the compilation of kernels; building tables and Embree is left to a thread
        that nobody waits for.
        """
        told, is_cancelled = queue.SimpleQueue(), threading.Event()

        def prepare():
            try:
                told.put(
                    Renderer(
                        scene,
                        settings,
                        lambda *progress: told.put(progress),
                        cancel=is_cancelled.is_set,
                    )
                )
            except Cancelled:
                pass
            except Exception as error:
                told.put(error)

        threading.Thread(target=prepare, name="LightTree set-up", daemon=True).start()
        try:
            while not self.test_break():
                try:
                    news = told.get(timeout=PATIENCE_S)
                except queue.Empty:
                    continue
                if isinstance(news, Exception):
                    raise news
                if isinstance(news, Renderer):
                    news.progress = self._progress
                    return news
                self._progress(*news)
        finally:
            is_cancelled.set()
        return None

    def view_update(self, context, depsgraph):
        if self.viewport is None:
            self.viewport = Viewport()
            # Not in __del__, where Blender may have removed the engine behind this object.
            weakref.finalize(self, self.viewport.close)
        camera = view_camera(context.region, context.region_data, depsgraph)
        self.viewport.update(depsgraph, camera)

    def view_draw(self, context, depsgraph):
        region = context.region
        self.viewport.look(view_camera(region, context.region_data, depsgraph))
        gpu.state.blend_set("ALPHA_PREMULT")
        self.bind_display_space_shader(depsgraph.scene)
        self.viewport.draw(region.width, region.height)
        self.unbind_display_space_shader()
        gpu.state.blend_set("NONE")
        self.update_stats("LightTree", self.viewport.message)

    def _progress(self, share: float, message: str) -> None:
        self.update_progress(share)
        # Blender shows nowhere what engines tell by update_memory_stats.
        self.update_stats("", f"{message}{_memory()}")
        if progress_listener:
            progress_listener(share, message)

    def _show(self, film: Film, result, layer) -> None:
        """Write the film so far to Blender's passes."""
        passes = result.layers[0].passes
        for item in wanted_passes(layer):
            if item.name in passes:
                passes[item.name].rect.foreach_set(item.read(film).astype(np.float32).ravel())
        self.update_result(result)


def _memory() -> str:
    """The most memory that Blender has had at a time, for the status line."""
    if resource is None:
        return ""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return f" | {peak / 2 ** (30 if sys.platform == 'darwin' else 20):.1f} GiB"


@persistent
def _forget(*_):
    LightTreeEngine.rendered.clear()


def register():
    bpy.utils.register_class(LightTreeEngine)
    bpy.app.handlers.render_pre.append(_forget)


def unregister():
    for viewport in list(Viewport.open_ones):
        viewport.close()
    bpy.app.handlers.render_pre.remove(_forget)
    bpy.utils.unregister_class(LightTreeEngine)
