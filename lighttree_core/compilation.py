"""Compiling all kernels at once, before the first picture: in processes of their own.

No kernel depends on the scene, so it is done once for a version of LightTree, of numba and of the
processor; `jit/cache.py` keeps the result. Two processes share the work. Whoever comes meanwhile
waits for them. Then each process loads what is compiled by rendering a tiny scene.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from importlib import import_module

import filelock
import numba
import numpy as np
from numba.core import event

from .jit import KERNELS
from .jit.cache import cache_folder, compiler_digest, remove_old_kernels, sources_digest
from .light_tree.build import build_tree
from .lights import bound_lights, build_lights
from .scene import (
    ALL_RAYS,
    COLOR_ATTRIBUTE,
    IMAGE_TEXTURE,
    SHADOW_RAY,
    SPHERE,
    TRANSPARENT,
    Camera,
    Closures,
    Lamps,
    Materials,
    Scene,
    Textures,
)

log = logging.getLogger("lighttree")

PATIENCE_S = 0.1
NICENESS = 10  # of processes that compile in the background

Progress = Callable[[float, str], None]
Cancel = Callable[[], bool]

_loading = threading.Lock()
_is_loaded = False


class Cancelled(Exception):
    """The user has asked to stop."""


def are_kernels_compiled() -> bool:
    """Whether all kernels of these sources are in the cache; then none is compiled any more."""
    if numba.config.DISABLE_JIT or _is_loaded:
        return True
    folder = cache_folder()
    return folder is not None and (folder / _marker()).exists()


def compile_kernels(
    progress: Progress = lambda share, message: None,
    cancel: Cancel = lambda: False,
    background: bool = False,
) -> float:
    """Have all kernels compiled and loaded into this process; the seconds that took.

    progress is called with the share done and a message; cancel is asked all the while, and once it
    returns true Cancelled is raised. background: with low priority, and nothing is loaded.
    """
    start = time.perf_counter()
    if numba.config.DISABLE_JIT or _is_loaded:
        return 0.0
    if cache_folder() and not are_kernels_compiled():
        _compile_in_processes(progress, cancel, background)
    if not background:
        _load(progress)
    return time.perf_counter() - start


def _load(progress: Progress) -> None:
    """Load all kernels from the cache, and compile those that are not there."""
    global _is_loaded
    with _loading:
        if _is_loaded:
            return
        if not are_kernels_compiled():
            progress(0.0, "Compiling kernels")
        _is_loaded = True  # else the renders below would ask for it again
        try:
            for part in PARTS.values():
                part()
        except BaseException:
            _is_loaded = False
            raise
        if folder := cache_folder():
            with contextlib.suppress(OSError):
                (folder / _marker()).touch()  # in use, so it is not removed


@functools.cache
def _marker() -> str:
    """The file that says that all kernels are compiled."""
    sources = sources_digest(f"{__package__}.render")  # which imports all that has kernels
    return f"all-{sources[:12]}-{compiler_digest()[:12]}.compiled"


def _compile_in_processes(progress: Progress, cancel: Cancel, background: bool) -> None:
    folder = cache_folder()
    lock = filelock.FileLock(folder / "compiling.lock", thread_local=False)
    state = folder / "compiling.progress"
    while True:
        try:
            lock.acquire(timeout=PATIENCE_S)
            break
        except filelock.Timeout:
            _check(cancel)
            _report(progress, _read_share(state))
        except OSError as error:
            log.warning("Kernels are compiled in this process: %s", error)
            return
    try:
        if are_kernels_compiled():
            return
        remove_old_kernels()
        if _run_parts(progress, cancel, background, state):
            (folder / _marker()).touch()
    except OSError as error:  # a full disk
        log.warning("Compiled kernels could not be kept: %s", error)
    finally:
        state.unlink(missing_ok=True)
        lock.release()


def _run_parts(progress: Progress, cancel: Cancel, background: bool, state) -> bool:
    """Compile each part in a process; whether all came to their end."""
    lines = {part: [] for part in PARTS}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    call = f"from {__name__} import compile_part; compile_part(%r, {background})"
    processes = {}
    try:
        for part in PARTS:
            processes[part] = subprocess.Popen(
                [sys.executable, "-c", call % part],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        readers = [
            threading.Thread(target=_collect, args=(process.stdout, lines[part]), daemon=True)
            for part, process in processes.items()
        ]
        for reader in readers:
            reader.start()
        while any(reader.is_alive() for reader in readers):
            _check(cancel)
            compiled = set().union(*lines.values())
            share = min(0.99, len(compiled) / len(KERNELS))
            state.write_text(str(share))
            _report(progress, share)
            time.sleep(PATIENCE_S)
        for part, process in processes.items():
            if process.wait() != 0:
                log.warning("Compiling %s failed:\n%s", part, "".join(lines[part][-20:]))
        return all(process.returncode == 0 for process in processes.values())
    finally:
        for process in processes.values():
            process.kill()
            process.wait()
            process.stdin.close()
            process.stdout.close()


def _check(cancel: Cancel) -> None:
    if cancel():
        raise Cancelled


def _report(progress: Progress, share: float) -> None:
    progress(share, f"Compiling kernels, once for this version: {share:.0%}")


def _collect(stream, lines: list[str]) -> None:
    """Collect the lines that a process writes: the name of each kernel, or what went wrong."""
    with contextlib.suppress(ValueError, OSError):  # it has been killed
        for line in stream:
            lines.append(line)


def _read_share(state) -> float:
    try:
        return float(state.read_text())
    except (OSError, ValueError):
        return 0.0


def _compile_light_tree() -> None:
    """Call all that builds a light tree."""
    lights, _, _ = build_lights(_tiny_scene())
    build_tree(bound_lights(lights))


def _compile_rendering() -> None:
    """Call all that renders; without a tree, which is the other process's part."""
    render = import_module(f"{__package__}.render")
    plain, full = _tiny_scene(), _tiny_scene()
    full.closures, full.materials.num_closures[:] = Closures.empty(2), 2
    full.closures.kind[0], full.closures.weight[:] = TRANSPARENT, 0.5
    full.vertices = np.concatenate([full.vertices, full.vertices + np.float32([0, 0, 3])])
    full.triangles = np.concatenate([full.triangles, full.triangles + 4])
    full.triangle_material = np.zeros(4, np.int32)
    full.object_names, full.object_first_triangle = ["Floor", "Hidden"], np.int32([0, 2])
    full.object_visible = np.array([ALL_RAYS | SHADOW_RAY, 0], np.int32)
    full.textures = Textures.empty(2, 1)
    full.textures.kind[:] = IMAGE_TEXTURE, COLOR_ATTRIBUTE
    full.textures.size[:], full.textures.texels = 1, np.ones((1, 4), np.uint8)
    full.uvs, full.colors = np.zeros((1, 4, 3, 2), np.float32), np.ones((1, 4, 3, 3), np.float32)
    full.materials.emission[:], full.materials.emission_texture[:] = 1, [[0, 1]]
    settings = render.Settings(samples=16, sampler="uniform", threads=1)
    for scene in (plain, full):
        render.render(scene, settings)


PARTS = {"light tree": _compile_light_tree, "rendering": _compile_rendering}


def _tiny_scene() -> Scene:
    """A floor of two triangles under a lamp."""
    world_from_camera = np.eye(4)[:3]
    world_from_camera[2, 3] = 5
    materials = Materials.empty(1)
    materials.albedo[:] = 0.5
    lamps = Lamps.empty(2)
    lamps.kind[:], lamps.radius[:], lamps.radiance[:] = SPHERE, 0.1, 1
    lamps.visible[:] = ALL_RAYS
    lamps.position[:] = [[0, 0, 1], [0, 0, 2]]
    return Scene(
        camera=Camera(world_from_camera, 1.0, 1.0, 2, 1),
        vertices=np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], np.float32),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        triangle_material=np.zeros(2, np.int32),
        materials=materials,
        lamps=lamps,
        object_names=["Floor"],
        object_first_triangle=np.zeros(1, np.int32),
    )


class _NameKernels(event.Listener):
    """Writes the name of each kernel that has been compiled."""

    def on_start(self, event):
        pass

    def on_end(self, event):
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith(__package__):
            print(f"{function.__module__}.{function.__qualname__}", flush=True)


def _end_with_parent() -> None:
    """Wait for the end of standard input, which comes with that of the process at its other end."""
    os.read(0, 1)
    os._exit(1)


def compile_part(part: str, background: bool) -> None:
    """Compile one part, in a process of its own."""
    global _is_loaded
    if background and hasattr(os, "nice"):
        os.nice(NICENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    event.register("numba:compile", _NameKernels())
    _is_loaded = True
    PARTS[part]()
