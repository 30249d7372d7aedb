"""The child process that renders: one JSON job a line in, JSON answers out, one a line.

    {"do": "render", ...}  ->  {"text": ..., "fraction": ...} any number of times, once with
                               "renders", when rendering begins, and then
                               {"done": result} or {"failed": sentence, ...}

A process of its own because Cycles cannot be cancelled: whoever started it may kill it at any
moment, so it writes only where its parent wants unfinished files. It ends when its input does,
that is when its parent is gone or wants no more of it, and ends what it started itself.
"""

from __future__ import annotations

import errno
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
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

import lighttree_addon
from lighttree_addon import engine
from lighttree_core import Scene, SceneError
from lighttree_core.compilation import compile_kernels
from lighttree_core.lights import build_lights, count_lights

from .blend import extract, list_files, list_fixed_files, open_blend
from .explain import explain_scene
from .facts import describe_machine, describe_packages, describe_renderers, hash_files
from .images import read_render, write_exr
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

Answer = Callable[..., None]

CLEAR_REFS = Path("/proc/self/clear_refs")
MIN_FREE_BYTES = 2**20


def main() -> None:
    """Do the jobs that come in until the input ends; never returns."""
    answers = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)  # Blender prints to standard output whenever it likes

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


def inspect(answer: Answer, file: str, camera: str | None, frame: int | None, common: dict) -> dict:
    """What is known of a scene before a comparison; also compiles the kernels."""
    answer(text=f"Reading {Path(file).name}")
    scene, files = open_blend(file, camera, frame), list_files()
    fixed_files = list_fixed_files()
    settings = common | {"seed": 0, "budget": {"samples": 1}}
    configure(bpy.data, scene, METHODS["lighttree"], **settings)
    extracted = extract(scene)
    _load_kernels(answer, lambda share, text: answer(text=text, fraction=share))
    return {
        "camera": scene.camera.name,
        "frame": scene.frame_current,
        "lights": count_lights(build_lights(extracted)[0]),
        "triangles": len(extracted.triangles),
        "not_modelled": list(extracted.not_modelled),
        "files": files,
        "fixed_files": fixed_files,
        "file_sha256": hash_files([file, *files]),
        "renderers": describe_renderers(),
    }


def export(answer: Answer, file: str, camera: str | None, frame: int | None, out: str) -> list[str]:
    """Save a .blend as a scene of LightTree's core; returns what is not modelled."""
    answer(text=f"Reading {Path(file).name}")
    extracted = extract(open_blend(file, camera, frame))
    answer(text=f"Writing {Path(out).name}")
    extracted.save(out)
    return list(extracted.not_modelled)


def explain(answer: Answer, file: str) -> dict:
    """What a .blend uses of LightTree, see `explain.py`."""
    answer(text=f"Reading {Path(file).name}")
    return explain_scene(extract(open_blend(file)))


def bench(answer: Answer, file: str, num_pixels: int, samples: int, threads: int) -> dict:
    """The figures of a .blend or an exported scene, see `bench.py`."""
    from .bench import measure_scene

    _reset_peak()
    base_mib = _peak_mib()
    answer(text="Reading", fraction=0.0)
    scene = None if file.endswith(".npz") else open_blend(file)
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
    scene = open_blend(file, shown["camera"], shown["frame"])
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


def render_file(answer: Answer, file: str, render: dict, settings: dict, out: str) -> dict:
    """Render a .blend with LightTree and its own settings but those given; returns the facts."""
    answer(text=f"Reading {Path(file).name}")
    scene = open_blend(file)
    scene.render.engine = LIGHTTREE
    assign(scene.render, render)
    assign(scene.lighttree, settings)
    seconds = _load_kernels(answer, lambda share, text: answer(text=text, fraction=share))
    return _render(answer, scene, {"file": file, "seconds_compile": seconds}, out)


JOBS = {
    "build": build,
    "inspect": inspect,
    "export": export,
    "explain": explain,
    "bench": bench,
    "compare": compare,
    "render": render_unit,
    "render_file": render_file,
}


def _require_path_guiding() -> None:
    import _cycles

    if not _cycles.with_path_guiding:
        raise RuntimeError("This Blender was built without path guiding.")


def _render(answer: Answer, scene: bpy.types.Scene, header: dict, out: str) -> dict:
    """Render the user's way; write `out` with the header and the facts; return the facts."""
    raw = f"{out}.raw.exr"
    write_float_exr_to(scene.render, raw)
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
    rgb, _ = read_render(raw)
    os.remove(raw)
    facts["is_black"] = not rgb.any()
    channels = {name: rgb[..., i] for i, name in enumerate("RGB")}
    write_exr(out, channels, header | facts)
    return facts


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
        film, scene = engine.LightTreeEngine.last_film, engine.LightTreeEngine.last_scene
    finally:
        engine.progress_listener = None
        engine.LightTreeEngine.last_film = engine.LightTreeEngine.last_scene = None
    facts["samples"] = film.num_samples
    facts["seconds_render"] = film.seconds_render
    facts["dropped_samples"] = film.dropped_samples
    facts["not_modelled"] = list(scene.not_modelled)


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
