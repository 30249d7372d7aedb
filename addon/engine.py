"""The render engine: Blender's settings in, the film out to passes, messages to the user."""

from __future__ import annotations

import logging
import sys
import weakref
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import bpy
import gpu
import numpy as np

from lighttree_core import Film, Scene, SceneError, render

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

# Called with (share done, message) by every render, for programs that run without a window.
progress_listener: Callable[[float, str], None] | None = None


class LightTreeEngine(bpy.types.RenderEngine):
    """`scene.render.engine = "LIGHTTREE"`."""

    bl_idname = "LIGHTTREE"
    bl_label = "LightTree"
    bl_use_eevee_viewport = True
    bl_use_shading_nodes_custom = False

    last_film: ClassVar[Film | None] = None  # of the last render that went through
    last_scene: ClassVar[Scene | None] = None

    viewport: Viewport | None = None

    def update_render_passes(self, scene=None, renderlayer=None):
        for item in wanted_passes(renderlayer):
            channels = item.channels
            self.register_pass(scene, renderlayer, item.name, len(channels), channels, item.kind)

    def render(self, depsgraph):
        # An exception that leaves here is swallowed, and can crash Blender when it writes the
        # image; a reported error stops the render cleanly.
        try:
            self._render(depsgraph)
        except SceneError as error:
            self.report({"ERROR"}, f"LightTree: {error}")
        except Exception as error:
            log.exception("LightTree failed")
            self.report({"ERROR"}, f"LightTree failed: {error}. The console tells where.")

    def _render(self, depsgraph):
        type(self).last_film = type(self).last_scene = None
        self._progress(0.0, "Reading the scene")
        scene = extract_scene(depsgraph)
        if scene.not_modelled and depsgraph.scene.lighttree.strict:
            raise SceneError(
                "Strict is on and the scene has what is not modelled: "
                + " ".join(scene.not_modelled)
            )
        for sentence in scene.not_modelled:
            self.report({"WARNING"}, sentence)

        height, width = scene.camera.shape
        layer, settings = depsgraph.view_layer, render_settings(depsgraph.scene)
        settings = replace(settings, light_passes=bool(wanted_light_passes(layer)))
        result = self.begin_result(0, 0, width, height, layer=layer.name)
        try:
            film = render(
                scene,
                settings,
                progress=self._progress,
                cancel=self.test_break,
                on_pass=lambda film: self._show(film, result, layer),
            )
        finally:
            self.end_result(result)
        if film.dropped_samples:
            self.report({"WARNING"}, f"{film.dropped_samples} samples were not finite: left black.")
        if film.num_samples and not film.mean.any():
            self.report({"WARNING"}, "The image is black: no light reaches what the camera sees.")
        if not film.cancelled:
            type(self).last_film, type(self).last_scene = film, scene

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
        self.update_stats("LightTree", self.viewport.message)
        gpu.state.blend_set("ALPHA_PREMULT")
        self.bind_display_space_shader(depsgraph.scene)
        self.viewport.draw(region.width, region.height)
        self.unbind_display_space_shader()
        gpu.state.blend_set("NONE")

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


def register():
    bpy.utils.register_class(LightTreeEngine)


def unregister():
    for viewport in list(Viewport.open_ones):
        viewport.close()
    bpy.utils.unregister_class(LightTreeEngine)
