"""The child process that renders: one JSON job a line in, JSON answers out, one a line.

    {"do": "render", ...}  ->  {"text": ..., "fraction": ...} any number of times, once with
                               "renders", when rendering begins, and then
                               {"done": result} or {"failed": sentence, ...}

A process of its own because Cycles cannot be cancelled: whoever started it may kill it at any
moment, so it writes only where its parent wants unfinished files. It ends when its input does,
that is when its parent is gone or wants no more of it, and ends what it started itself.
"""

from __future__ import annotations

import ctypes
import errno
import faulthandler
import json
import os
import queue
import re
import shutil
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

import lighttree_addon
from lighttree_addon import engine
from lighttree_core import Scene, SceneError
from lighttree_core.compilation import compile_kernels
from lighttree_core.lights import build_lights, count_lights

from .blend import (
    extract,
    list_files,
    list_fixed_files,
    list_scenes,
    open_blend,
    render_alone,
)
from .explain import explain_scene
from .facts import describe_machine, describe_packages, describe_renderers, hash_files
from .images import ImageError, read_exr, read_passes, read_render, write_exr
from .methods import (
    CYCLES,
    LIGHTTREE,
    METHODS,
    InputError,
    assign,
    configure,
    engine_settings,
    write_float_exr_to,
)
from .process import Progress, kill_all
from .scenes import build_scene
from .views import View

Answer = Callable[..., None]

CLEAR_REFS = Path("/proc/self/clear_refs")
MIN_FREE_BYTES = 2**20
BY_LINE = 1  # _IOLBF


def main() -> None:
    """Do the jobs that come in until the input ends; never returns."""
    answers = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)  # Blender prints to standard output whenever it likes
    _show_at_once()
    faulthandler.enable()

    def answer(**message: Any) -> None:
        answers.write(json.dumps(message) + "\n")

    lighttree_addon.register()
    answer(ready=describe_packages() | {"blender": bpy.app.version_string})
    jobs: queue.Queue[dict] = queue.Queue()
    threading.Thread(target=_read_jobs, args=(jobs,), daemon=True).start()
    while True:
        job = jobs.get()
        try:
            answer(done=JOBS[job.pop("do")](answer=answer, **job))
        except Exception as error:  # the parent reports it and goes on with other jobs
            traceback.print_exc()
            answer(
                failed=_sentence(error),
                bad_input=isinstance(error, ValueError),
                disk_full=_is_disk_full(error, job),
            )


def _show_at_once() -> None:
    """Have C's standard output written line by line, so that a crash does not lose the last."""
    with suppress(OSError, ValueError, AttributeError):  # where it has another name
        libc = ctypes.CDLL(None)
        libc.setvbuf(ctypes.c_void_p.in_dll(libc, "stdout"), None, BY_LINE, 0)


def _is_disk_full(error: Exception, job: dict) -> bool:
    """Whether a job failed for want of space; neither Blender nor OpenEXR says so."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOSPC
    return "out" in job and shutil.disk_usage(Path(job["out"]).parent).free < MIN_FREE_BYTES


def _read_jobs(jobs: queue.Queue[dict]) -> None:
    for line in sys.stdin:
        jobs.put(json.loads(line))
    kill_all()
    os._exit(0)  # at once: a render cannot be stopped, and Blender 4.5 hangs on a normal exit


def _sentence(error: Exception) -> str:
    """What to tell the user: errors meant for them as they are, others with their type."""
    text = str(error).strip().removeprefix("Error: ")
    is_for_users = isinstance(error, ValueError | OSError) or type(error) is RuntimeError
    return text if is_for_users and text else f"{type(error).__name__}: {text}"


def inspect(answer: Answer, file: str, view: dict, common: dict) -> dict:
    """What is known of a scene before a comparison; also compiles the kernels."""
    answer(text=f"Reading {Path(file).name}")
    (scene, warnings), files = open_blend(file, View(**view)), list_files()
    layer, *others = (layer.name for layer in scene.view_layers if layer.use)
    if others:
        warnings.append(
            f"View layer {', '.join(others)}: left out, as a comparison renders one, {layer}."
        )
    fixed_files = list_fixed_files()
    settings = common | {"seed": 0, "budget": {"samples": 1}}
    configure(bpy.data, scene, METHODS["lighttree"], **settings)
    extracted = extract(scene)
    _load_kernels(answer, lambda share, text: answer(text=text, fraction=share))
    return {
        "camera": scene.camera.name,
        "frame": scene.frame_current,
        "scene": scene.name,
        "view_layer": layer,
        "lights": count_lights(build_lights(extracted)[0]),
        "triangles": len(extracted.triangles),
        "not_modelled": [*warnings, *extracted.not_modelled],
        "files": files,
        "fixed_files": fixed_files,
        "file_sha256": hash_files([file, *files]),
        "renderers": describe_renderers(),
    }


def _extract(
    answer: Answer, file: str, view: dict, render: dict, needs_camera: bool = True
) -> Scene:
    """A scene of a .blend; what its file lacks is told with what is not modelled."""
    answer(text=f"Reading {Path(file).name}")
    scene, warnings = open_blend(file, View(**view), render, needs_camera)
    extracted = extract(scene)
    return replace(extracted, not_modelled=[*warnings, *extracted.not_modelled])


def export(answer: Answer, file: str, view: dict, render: dict, out: str) -> list[str]:
    """Save a .blend as a scene of LightTree's core; returns what is not modelled."""
    extracted = _extract(answer, file, view, render)
    answer(text=f"Writing {Path(out).name}")
    extracted.save(out)
    return list(extracted.not_modelled)


def explain(answer: Answer, file: str, view: dict) -> dict:
    """What a .blend uses of LightTree, see `explain.py`."""
    return explain_scene(_extract(answer, file, view, {}, needs_camera=False))


def list_views(answer: Answer, file: str) -> list[dict]:
    """What a .blend has to render: its scenes, see `single.list_blend`."""
    answer(text=f"Reading {Path(file).name}")
    return list_scenes(file)


def try_cycles(answer: Answer, file: str, view: dict) -> None:
    """Render a .blend with Cycles, as little as that can be: does Blender survive it?"""
    scene, _ = open_blend(file, View(**view), needs_camera=False)
    assign(scene.render, {"resolution_x": 8, "resolution_y": 8, "resolution_percentage": 100})
    assign(scene.cycles, {"samples": 1, "use_denoising": False})
    with render_alone(scene, engine=CYCLES):
        bpy.ops.render.render()


def bench(
    answer: Answer, file: str, view: dict, num_pixels: int, samples: int, threads: int
) -> dict:
    """The figures of a .blend or an exported scene, see `bench.py`."""
    from .bench import measure_scene

    _reset_peak()
    base_mib = _peak_mib()
    answer(text="Reading", fraction=0.0)
    scene = None if file.endswith(".npz") else open_blend(file, View(**view))[0]
    started = time.perf_counter()
    extracted = Scene.load(file) if scene is None else extract(scene)
    seconds_read = time.perf_counter() - started
    figures = measure_scene(
        extracted,
        num_pixels,
        samples,
        threads,
        lambda share, text: answer(text=text, fraction=share),
    )
    figures["startup_s"] |= {"read": seconds_read}
    return figures | {"base_mib": base_mib, "peak_mib": _peak_mib()}


def build(answer: Answer, name: str, num_lights: int | None, seed: int, out: str) -> None:
    """Build one of the scenes of `scenes.py`."""
    answer(text=f"Building {name}")
    build_scene(name, out, num_lights, seed)


def compare(answer: Answer, **job: Any) -> dict:
    """Compare the engines on one scene for somebody who looks at Blender, see `side_by_side.py`."""
    from .side_by_side import compare_scene

    return compare_scene(lambda share, text: answer(text=text, fraction=share), **job)


def render_unit(answer: Answer, file: str, header: dict, asked_at: float, out: str) -> None:
    """Render one unit of a comparison, described by its header, to `out`."""
    shown = header["settings"]
    method = replace(METHODS[header["method"]], overrides=header["overrides"])
    if method.overrides.get("use_guiding"):
        _require_path_guiding()
    scene, _ = open_blend(file, View(*(shown[key] for key in View._fields)))
    if hash_files([file, *list_files()]) != shown["file_sha256"]:
        raise InputError(f"{file} has changed meanwhile; run the same command again.")
    settings = {key: header[key] for key in ("resolution", "bounces", "threads", "seed", "budget")}
    configure(bpy.data, scene, method, **settings)
    seconds_compile = 0.0
    if method.engine == LIGHTTREE:
        # Without a share done: that would be of this render, among others.
        seconds_compile = _load_kernels(answer, lambda share, text: answer(text=text))
    header |= {"seconds_start": time.time() - asked_at, "seconds_compile": seconds_compile}
    _render(answer, scene, header, out)


def _load_kernels(answer: Answer, progress: Progress) -> float:
    """Have LightTree's kernels compiled and loaded before anything is timed; seconds that took."""
    answer(text="Loading kernels")
    return compile_kernels(progress)


def render_file(
    answer: Answer, file: str, view: dict, render: dict, settings: dict, old: str, out: str
) -> dict:
    """Render a .blend with LightTree and its own settings but those given; returns the facts.

    old: an image that is kept if it is the same one, rendered before; "" for none.
    """
    answer(text=f"Reading {Path(file).name}")
    scene, warnings = open_blend(file, View(**view), render)
    key = [view, render, settings, hash_files([file, *list_files()]), describe_renderers()]
    if old and (facts := _read_kept(old, key)):
        return facts | {"is_kept": True}
    if scene.render.use_freestyle:
        warnings.append("Scene: without Freestyle's lines.")
    if warnings and settings.get("strict", scene.lighttree.strict):
        raise InputError(f"{file}: {warnings[0]} (refused by --strict)")
    assign(scene.lighttree, settings)
    seconds = _load_kernels(answer, lambda share, text: answer(text=text, fraction=share))
    header = {"file": file, "key": key, "seconds_compile": seconds, "warnings": warnings}
    with render_alone(scene, engine=LIGHTTREE):
        return _render(answer, scene, header, out, every_pass=True)


def _read_kept(path: str, key: list) -> dict | None:
    """The facts of an image that was rendered with this key; None if it is not there."""
    try:
        _, header = read_exr(path)
    except (ImageError, OSError):
        return None
    return header if header.get("key") == key else None


JOBS = {
    "build": build,
    "inspect": inspect,
    "export": export,
    "explain": explain,
    "bench": bench,
    "compare": compare,
    "render": render_unit,
    "render_file": render_file,
    "list": list_views,
    "try_cycles": try_cycles,
}


def _require_path_guiding() -> None:
    import _cycles

    if not _cycles.with_path_guiding:
        raise RuntimeError("This Blender was built without path guiding.")


def _render(
    answer: Answer, scene: bpy.types.Scene, header: dict, out: str, every_pass: bool = False
) -> dict:
    """Render the user's way; write `out` with the header and the facts; return the facts.

    every_pass: write alpha and all passes of all view layers beside the colours.
    """
    raw = Path(f"{out}.raw.exr")
    write_float_exr_to(scene.render, _literal(raw), every_pass)
    watch = _watch_cycles if scene.render.engine == CYCLES else _watch_lighttree
    _reset_peak()
    answer(text="Rendering", fraction=0.0, renders=True)
    started = time.perf_counter()
    with watch(answer) as facts:
        bpy.ops.render.render(write_still=True)
    seconds = time.perf_counter() - started
    # All that is not tracing: evaluation, extraction or synchronization, builds, clean-up.
    facts["seconds_setup"] = seconds - facts["seconds_render"]
    facts["peak_mib"] = _peak_mib()
    facts["engine_settings"] = engine_settings(scene)
    facts["machine"] = describe_machine()
    if every_pass:
        channels = read_passes(raw)
    else:
        channels = dict(zip("RGB", np.moveaxis(read_render(raw)[0], 2, 0), strict=True))
    raw.unlink()
    facts["is_black"] = not any(channels[name].any() for name in "RGB")
    facts["not_modelled"] = [*header.get("warnings", ()), *facts.get("not_modelled", ())]
    write_exr(out, channels, header | facts)
    return facts


def _literal(path: Path) -> str:
    """A path as Blender takes it, which fills in what stands in single braces."""
    return str(path).replace("{", "{{").replace("}", "}}")


@contextmanager
def _watch_lighttree(answer: Answer) -> Iterator[dict[str, Any]]:
    """Forward LightTree's progress; the facts come from its film."""
    facts: dict[str, Any] = {}
    engine.progress_listener = lambda fraction, text: answer(text=text, fraction=fraction)
    try:
        yield facts
    except RuntimeError as error:
        if (prefix := "Error: LightTree: ") in str(error):  # a SceneError, by way of Blender
            raise SceneError(str(error).strip().removeprefix(prefix)) from error
        raise
    else:
        films, scenes = zip(*engine.LightTreeEngine.rendered, strict=True)
    finally:
        engine.progress_listener = None
        engine.LightTreeEngine.rendered.clear()
    facts["samples"] = min(film.num_samples for film in films)
    facts["seconds_render"] = sum(film.seconds_render for film in films)
    facts["dropped_samples"] = sum(film.dropped_samples for film in films)
    told = dict.fromkeys(sentence for scene in scenes for sentence in scene.not_modelled)
    facts["not_modelled"] = list(told)


@contextmanager
def _watch_cycles(answer: Answer) -> Iterator[dict[str, Any]]:
    """Forward Cycles' progress; the facts come from its messages, which are exact to 1 ms.

    (Its EXR header has them to 10 ms, and the samples asked for instead of those done.)
    """
    facts: dict[str, Any] = {"samples": 0, "dropped_samples": 0}
    times: dict[str, float] = {}

    def listen(text: str, _: object) -> None:
        if sample := re.search(r"Sample (\d+)/(\d+)", text):
            times.setdefault("first", time.perf_counter())
            done, asked = map(int, sample.groups())
            if done:  # after the last one Cycles says 0 again
                facts["samples"] = done
                answer(text=f"Sample {done}", fraction=done / asked)
        elif text.endswith("Finished"):
            times["last"] = time.perf_counter()

    bpy.app.handlers.render_stats.append(listen)
    try:
        yield facts
    finally:
        bpy.app.handlers.render_stats.remove(listen)
    facts["seconds_render"] = times["last"] - times["first"]


def _reset_peak() -> None:
    if CLEAR_REFS.exists():
        CLEAR_REFS.write_text("5")


def _peak_mib() -> float | None:
    """Peak resident memory since `_reset_peak`, of the whole process; None where unknown."""
    if not CLEAR_REFS.exists():
        return None
    status = Path("/proc/self/status").read_text()
    return round(int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024, 1)


if __name__ == "__main__":
    main()
