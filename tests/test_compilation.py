"""Kernels are compiled once, before the first picture, and never for a scene."""

import os
import signal
import subprocess
import sys
import time

import numba
import numpy as np
import pytest
from core_scenes import camera, floor_scene, lamps_down, random_scene
from numba.core import event

from lighttree_core import Settings, compilation, render
from lighttree_core.jit import KERNELS
from lighttree_core.jit import cache as kernel_cache
from lighttree_core.light_tree.options import CLAMPED, CONE_UNION, CUT_OFF, TreeOptions
from lighttree_core.scene import (
    ALL_RAYS,
    ALPHA,
    CAMERA_RAY,
    COLOR_ATTRIBUTE,
    DIFFUSE,
    FACING,
    GLASS,
    GLOSSY,
    IMAGE_TEXTURE,
    POINT,
    PRINCIPLED,
    RECTANGLE,
    REFRACTION,
    SHADOW_RAY,
    SPHERE,
    SUN,
    TRANSLUCENT,
    TRANSPARENT,
    Closures,
    Textures,
)

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


class Compilations(event.Listener):
    """Names of what numba compiles."""

    def __init__(self):
        self.names = []

    def on_start(self, event):
        pass

    def on_end(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)


def scene_of(*kinds, **changes):
    """A floor with closures under a point and a sphere."""
    lamps = lamps_down([POINT, SPHERE], [(0, 0, 3), (1, 0, 2)])
    scene = floor_scene(lamps, camera=camera(4, 4))
    scene.closures = Closures.empty(len(kinds))
    scene.closures.kind[:], scene.closures.weight[:] = kinds, 0.5
    scene.materials.num_closures[:] = len(kinds)
    for name, value in changes.items():
        setattr(scene, name, value)
    return scene


def textured(kind):
    scene = scene_of(PRINCIPLED)
    scene.textures = Textures.empty(1, 1)
    scene.textures.kind[:] = kind
    scene.textures.size[:], scene.textures.texels = 1, np.full((1, 4), 99, np.uint8)
    scene.uvs = np.float32([[[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]])
    scene.colors = np.full((1, 2, 3, 3), 0.5, np.float32)
    scene.closures.weight_texture[:] = 0
    return scene


def twenty_scenes():
    """(scene, settings) that differ in all that a scene may or may not have."""
    plain = Settings(samples=1, threads=1)
    for kind in (DIFFUSE, GLOSSY, REFRACTION, GLASS, TRANSLUCENT, TRANSPARENT, PRINCIPLED):
        yield scene_of(kind), plain
    yield floor_scene(camera=camera(4, 4)), plain
    yield random_scene(np.random.default_rng(7)), plain
    for kind in (IMAGE_TEXTURE, COLOR_ATTRIBUTE, FACING):
        yield textured(kind), plain
    bumpy = textured(IMAGE_TEXTURE)
    bumpy.closures.normal_texture[:] = bumpy.closures.height_texture[:] = 0
    bumpy.materials.emission[:], bumpy.materials.emission_texture[:] = 1, 0
    yield bumpy, plain
    smooth = np.zeros((2, 3, 3), np.float32)
    smooth[..., 2] = 1
    yield scene_of(GLOSSY, corner_normals=smooth), plain
    yield scene_of(GLOSSY, film_transparent=True), Settings(samples=1, light_passes=True)
    sky = scene_of(DIFFUSE, background=np.ones(3, np.float32))
    sky.environment.image = np.ones((2, 4, 3), np.float32)
    sky.environment.camera_color = np.ones((1, 3), np.float32)
    yield sky, plain
    hidden = scene_of(PRINCIPLED, object_visible=np.int32([ALL_RAYS & ~CAMERA_RAY | SHADOW_RAY]))
    hidden.closures.values[:, ALPHA] = 0.5
    yield hidden, Settings(samples=1, sampler="power", mis="balance")
    flagged = scene_of(GLOSSY)
    flagged.lamps.casts_shadow[:], flagged.lamps.max_bounces[:] = False, 1
    yield flagged, Settings(samples=1, split_lights=1, filter="gaussian")
    lens = scene_of(DIFFUSE, lamps=lamps_down([RECTANGLE, SUN], [(0, 0, 3), (0, 0, 9)]))
    lens.camera.lens_radius, lens.camera.num_blades = 0.1, 5
    yield lens, Settings(samples=1, tree=TreeOptions(importance=CLAMPED, cone_axis=CONE_UNION))
    yield (
        scene_of(DIFFUSE),
        Settings(samples=1, tree=TreeOptions(importance=CUT_OFF, split="sah", split_threshold=0.5)),
    )


def test_no_scene_and_no_setting_compiles_a_kernel():
    compilation.compile_kernels()
    compilations = Compilations()
    event.register("numba:compile", compilations)
    try:
        films = [render(scene, settings) for scene, settings in twenty_scenes()]
    finally:
        event.unregister("numba:compile", compilations)
    assert compilations.names == []
    assert len(films) == 20 and all(np.isfinite(film.mean).all() for film in films)


def test_an_edit_of_any_kernel_of_the_renderer_is_told_by_the_marker():
    covered, todo = set(), ["lighttree_core.render"]
    while todo:
        name = todo.pop()
        if name not in covered:
            covered.add(name)
            todo += kernel_cache._imports(name)
    kernels = {kernel.__module__ for kernel in KERNELS}
    assert {name for name in kernels if name.startswith("lighttree_core.")} <= covered


def test_compiling_is_told_apart_from_setting_up():
    film = render(floor_scene(camera=camera(4, 4)), Settings(samples=1))
    assert film.seconds_compile == 0  # all is loaded by now
    assert film.seconds_setup > 0


def start(folder, code):
    """A process with an empty cache."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder), "LOCALAPPDATA": str(folder)}
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True
    )


COMPILE = """
from lighttree_core import compilation
compilation.PARTS = {"vectors": lambda: None, "film": lambda: None}
def run(progress, cancel, background, state):
    import time
    print("compiles", flush=True)
    for step in range(20):
        compilation._check(cancel)
        state.write_text(str(step / 20))
        time.sleep(0.05)
    return True
compilation._run_parts = run
told = []
compilation.compile_kernels(lambda share, message: told.append(share))
print("waited" if max(told, default=0) > 0 else "done", flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills by a signal")
def test_of_two_processes_one_compiles_and_a_killed_one_leaves_nothing_locked(tmp_path):
    killed = start(tmp_path, COMPILE)
    assert killed.stdout.readline() == "compiles\n"
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    first, second = start(tmp_path, COMPILE), start(tmp_path, COMPILE)
    told = "".join(process.communicate(timeout=60)[0] for process in (first, second))
    assert told.count("compiles") == 1
    assert start(tmp_path, COMPILE).communicate(timeout=60)[0].split() == ["done"]


def test_cancel_is_heard_while_kernels_are_compiled(tmp_path, monkeypatch):
    monkeypatch.setattr(compilation, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(compilation, "_is_loaded", False)
    told, begun = [], time.perf_counter()
    with pytest.raises(compilation.Cancelled):
        compilation.compile_kernels(
            lambda share, message: told.append((share, message)), lambda: len(told) > 2
        )
    assert all(message.startswith("Compiling kernels") for _, message in told)
    assert time.perf_counter() - begun < 30
    assert not compilation.are_kernels_compiled()
    film = render(floor_scene(camera=camera(4, 4)), Settings(samples=1), cancel=lambda: True)
    assert film.cancelled and film.num_samples == 0
