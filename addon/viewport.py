"""Rendered shading of a 3D view: a thread that refines its picture until something changes.

Blender tells of edits on its main thread, where the scene is read; all else is done by the thread.
It first renders few pixels, then ever more, then samples. Only what an edit can have changed is
read and built anew: lamps leave the meshes alone, and Embree keeps triangles that are as before.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import weakref
from dataclasses import fields, is_dataclass, replace
from typing import NamedTuple

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d

from lighttree_core import Film, Scene, SceneError, Settings
from lighttree_core.compilation import Cancelled
from lighttree_core.render import Renderer
from lighttree_core.scene import Camera

from .extract import extract_scene
from .passes import COMBINED
from .properties import render_settings

log = logging.getLogger(__name__)

COARSEST = 8  # screen pixels along the side of one of the first picture
REDRAW_S = 0.05
NICENESS = 10  # of the threads that render
# What may be edited without a change of meshes or materials; of lights and worlds, Blender also
# tells of their node trees, of materials not without these themselves.
BESIDE_MESHES = (
    bpy.types.Camera,
    bpy.types.Collection,
    bpy.types.Light,
    bpy.types.NodeTree,
    bpy.types.Scene,
    bpy.types.World,
)


class Job(NamedTuple):
    """What is to be rendered. finest: screen pixels along the side of a pixel at the end."""

    scene: Scene
    settings: Settings
    camera: Camera
    finest: int


class Viewport:
    """One 3D view. picture: (H, W, 4) float32 premultiplied RGBA from below, None at first.

    message: for the user, in the corner of the view.
    """

    open_ones: weakref.WeakSet[Viewport] = weakref.WeakSet()

    def __init__(self):
        self.picture, self.message, self.has_news = None, "", False
        self._scene, self._settings, self._meshes = None, None, None
        self._job: Job | None = None
        self._is_open, self._changed = True, threading.Condition()
        self._texture, self._drawn = None, None
        self._renderer, self._rendered = None, None  # the thread's own
        self._thread = threading.Thread(target=self._work, name="LightTree viewport", daemon=True)
        self._thread.start()
        self.open_ones.add(self)
        if not bpy.app.timers.is_registered(_redraw):
            bpy.app.timers.register(_redraw, first_interval=REDRAW_S)

    def close(self) -> None:
        """Stop rendering and waiting for kernels; the thread ends soon."""
        with self._changed:
            self._is_open, self._job = False, None
            self._changed.notify()
        self.open_ones.discard(self)

    def update(self, depsgraph, camera: Camera) -> None:
        """Read what an edit may have changed, and render it."""
        try:
            settings = _viewport_settings(depsgraph.scene)
            meshes = _placed_meshes(depsgraph)
            is_known = self._scene and meshes == self._meshes and not _touches_meshes(depsgraph)
            # Cameras are told by jobs; here it is the same for all scenes, so that they compare.
            first_camera = self._scene.camera if self._scene else camera
            scene = extract_scene(depsgraph, first_camera, known=self._scene if is_known else None)
        except SceneError as error:
            self._scene = None
            self._start(None, str(error))
            return
        self._meshes = meshes
        is_same = self._scene and settings == self._settings and _is_same(scene, self._scene)
        self._scene, self._settings = scene, settings
        if not is_same:  # Blender tells of selections too
            self._start(Job(scene, settings, camera, _finest(depsgraph.scene)))

    def look(self, camera: Camera) -> None:
        """Render from another camera, if it is another."""
        if self._job and not _is_same(camera, self._job.camera):
            self._start(self._job._replace(camera=camera))

    def draw(self, width: int, height: int) -> None:
        """Draw the picture over the view."""
        self.has_news = False  # before it is read, or what comes meanwhile would stay unseen
        picture = self.picture
        if picture is None:
            return
        if picture is not self._drawn:
            pixels = gpu.types.Buffer("FLOAT", picture.size, picture.ravel())
            size = picture.shape[1::-1]
            self._texture = gpu.types.GPUTexture(size, format="RGBA16F", data=pixels)
            self._drawn = picture
        draw_texture_2d(self._texture, (0, 0), width, height)

    def _start(self, job: Job | None, message: str = "") -> None:
        with self._changed:
            self._job = job
            self._tell(message)
            self._changed.notify()

    def _tell(self, message: str) -> None:
        self.message, self.has_news = message, True

    def _work(self) -> None:
        """What the thread does: each job until there is another."""
        _yield_to_the_window()
        job = None
        while True:
            with self._changed:
                self._changed.wait_for(lambda job=job: self._job is not job or not self._is_open)
                job = self._job
                if not self._is_open:
                    return
            try:
                if job:
                    self._render(job)
            except SceneError as error:
                self._tell(str(error))
            except Cancelled:
                return
            except Exception as error:
                log.exception("LightTree's viewport failed")
                self._tell(f"LightTree failed: {error}. The console tells where.")

    def _render(self, job: Job) -> None:
        self._prepare(job)
        coarsest = step = max(COARSEST, job.finest)
        while step >= job.finest:
            self._renderer.aim(_coarser(job.camera, step))
            is_first, is_last = step == coarsest, step == job.finest
            # The first is always shown, or a view that turns without end would show nothing.
            film = self._renderer.run(
                lambda is_first=is_first: not is_first and self._job is not job,
                self._show,
                samples=None if is_last else 1,
            )
            if film.cancelled or self._job is not job:
                return
            step //= 2

    def _prepare(self, job: Job) -> None:
        """Build what the last job does not have already."""
        last, self._rendered = self._rendered, job
        if last and last.scene is job.scene and last.settings == job.settings:
            return
        tracer = None
        if last and _has_same_triangles(job.scene, last.scene):
            tracer = self._renderer.tracer
        self._rendered = self._renderer = None  # should the next line fail
        self._renderer = Renderer(
            job.scene,
            job.settings,
            lambda share, message: self._tell(message),
            tracer,
            cancel=lambda: not self._is_open,
        )
        self._rendered = job

    def _show(self, film: Film) -> None:
        self.picture = COMBINED.read(film)
        self._tell(f"Sample {film.num_samples}")


def _yield_to_the_window() -> None:
    """Lower the priority of this thread and of those that it starts, so that the window is quick.

    Linux alone has that for threads by themselves.
    """
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)


def _redraw() -> float | None:
    """Have views drawn that have news; a timer, for the thread itself may not touch Blender."""
    if any(viewport.has_news for viewport in Viewport.open_ones):
        redraw_views(bpy.context)
    return REDRAW_S if Viewport.open_ones else None


def redraw_views(context) -> None:
    """Have all 3D views drawn anew."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "WINDOW":  # not headers and sidebars, which take longer
                        region.tag_redraw()


def _viewport_settings(scene) -> Settings:
    samples = scene.lighttree.viewport_samples or 2**31 - 1
    return replace(render_settings(scene), samples=samples, time_limit_s=0.0)


def _finest(scene) -> int:
    size = scene.render.preview_pixel_size
    return 1 if size == "AUTO" else int(size)


def _coarser(camera: Camera, step: int) -> Camera:
    width, height = -(-camera.width_px // step), -(-camera.height_px // step)
    return replace(camera, width_px=width, height_px=height, crop_px=(0, 0, width, height))


def _placed_meshes(depsgraph) -> int:
    """A number that another set of visible meshes would hardly have.

    Of Indirect Only, which is a collection's, Blender tells no more than of a selection.
    """
    view_layer = depsgraph.view_layer_eval
    return hash(
        tuple(
            (
                instance.object.as_pointer(),
                instance.show_self,
                (instance.parent or instance.object).indirect_only_get(view_layer=view_layer),
            )
            for instance in depsgraph.object_instances
            if instance.object.type == "MESH"
        )
    )


def _touches_meshes(depsgraph) -> bool:
    """Whether an edit may have changed meshes, where they are, or their materials."""
    for update in depsgraph.updates:
        item = update.id
        if isinstance(item, bpy.types.Object):
            if item.type not in ("CAMERA", "LIGHT"):
                return True
        elif not isinstance(item, BESIDE_MESHES):
            return True
    return False


def _has_same_triangles(a: Scene, b: Scene) -> bool:
    return _is_same(a.vertices, b.vertices) and _is_same(a.triangles, b.triangles)


def _is_same(a, b) -> bool:
    """Whether two dataclasses, arrays or plain values are equal throughout."""
    if a is b:
        return True
    if is_dataclass(a):
        return all(_is_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return np.array_equal(a, b)
