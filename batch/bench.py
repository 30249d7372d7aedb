"""Where LightTree's time goes in a scene: rays, choosing lights, shading, start-up, memory.

Kernels are loaded before a scene is prepared. Then it renders the same samples three times. On one
thread, with stopwatches around Embree and around the kernels that shade; they are looked at twice
for a wave of thousands of paths, which costs nothing that could be seen. On all threads, for the
speed-up. At last on one thread while every vertex chooses its lights a second time, alone: no clock
can be read within a kernel, so this is taken for what choosing costs there, and shading is what is
left. It is a little too little, as the tree is in the processor's cache by then.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Column, Table

from lighttree_core import Film, Scene, Settings
from lighttree_core.compilation import compile_kernels
from lighttree_core.direct_light import num_light_samples, receiver_at
from lighttree_core.jit import ZERO, kernel
from lighttree_core.light_tree.sample import sample_lights
from lighttree_core.path import load_vertex
from lighttree_core.rays import Hits, Tracer
from lighttree_core.render import WAVE_SIZE, Renderer
from lighttree_core.sampling import LIGHT_PICK, dim, uniform
from lighttree_core.vec import max_abs
from lighttree_core.waves import TWO_SIDED, allocate_wave, load_receiver, store_receiver

from .images import replacing
from .process import Progress, RenderProcess
from .views import AS_SAVED, View

# The modules, whose names stand for the functions they hold in `lighttree_core` itself.
RENDER, WORLD = (import_module(f"lighttree_core.{name}") for name in ("render", "world"))
SHADING_KERNELS = ("shade_wave", "pass_surfaces", "gather_lamp_rays", "add_lamps_met")

NUM_PIXELS = 320 * 180
QUICK_PIXELS, QUICK_SAMPLES = 96 * 54, 2

# What each figure is, in the order in which they are shown.
STARTUP = {
    "read": "take the scene out of Blender, or load it",
    "embree": "Embree's structure over all triangles",
    "tree": "the light tree",
    "tables": "lights, materials and other tables",
    "kernels": "load compiled kernels, or compile them the first time",
}
PARTS = {
    "closest": "Embree: closest hit",
    "occlusion": "Embree: is a light hidden",
    "choice": "choosing lights",
    "shading": "shading: surfaces, light samples, scattering",
    "rest": "camera rays, film, Python",
}


class Stopwatch:
    """Seconds spent, and things done, under some names."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()

    def time(self, name: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """What the function returns."""
        start = time.perf_counter()
        result = function(*args, **kwargs)
        self.seconds[name] += time.perf_counter() - start
        return result

    @contextmanager
    def watching(self, module: Any, names: dict[str, str]) -> Iterator[None]:
        """Time a module's functions, each under a name of its own; on one thread only."""
        originals = {key: getattr(module, key) for key in names}

        def watch(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            return lambda *args, **kwargs: self.time(name, function, *args, **kwargs)

        try:
            for key, name in names.items():
                setattr(module, key, watch(name, originals[key]))
            yield
        finally:
            for key, function in originals.items():
                setattr(module, key, function)


class WatchedTracer:
    """A `rays.Tracer` under a stopwatch."""

    def __init__(self, tracer: Tracer, stopwatch: Stopwatch):
        self.tracer, self.stopwatch = tracer, stopwatch

    def _trace(self, name: str, query: Callable[..., Any], origin: np.ndarray, *args: Any) -> Any:
        self.stopwatch.counts[name] += len(origin)
        return self.stopwatch.time(name, query, origin, *args)

    def closest(self, *args: Any) -> Hits:
        return self._trace("closest", self.tracer.closest, *args)

    def closest_before(self, *args: Any) -> Hits:
        return self._trace("occlusion", self.tracer.closest_before, *args)

    def occluded(self, *args: Any) -> np.ndarray:
        return self._trace("occlusion", self.tracer.occluded, *args)


@kernel
def load_choices(world, settings, wave, hits, num_paths, depth, lobes, chosen, num, u):
    """Fill rows with the vertices of a wave at which lights are chosen, as `shade_wave` does.

    How many; chosen: a Wave of their receivers. num, u: (k,), see `sample_lights`.
    """
    count = 0
    for i in range(num_paths):
        if hits.triangle[i] < 0 or wave.bounce[i] > settings.max_bounces:
            continue
        vertex = load_vertex(world, wave, hits, i, lobes)
        if vertex.num_lobes == 0 and max_abs(vertex.albedo) == ZERO:
            continue
        store_receiver(chosen, count, receiver_at(vertex))
        chosen.flags[count] = TWO_SIDED if vertex.two_sided else 0
        num[count] = num_light_samples(settings, wave.bounce[i])
        pixel, sample = wave.pixel[i], wave.sample[i]
        u[count] = uniform(settings.seed, pixel, sample, dim(depth, LIGHT_PICK))
        count += 1
    return count


@kernel
def choose_lights(world, num_vertices, chosen, num, u, picks):
    """Choose lights at some vertices; how many lights."""
    num_lights = 0
    for i in range(num_vertices):
        receiver = load_receiver(chosen, i)
        num_lights += sample_lights(world.sampler, receiver, num[i], u[i], picks)
    return num_lights


class ChoiceWatch:
    """Stands in for `shade_wave`: first chooses the lights of its vertices alone, timed."""

    def __init__(self, stopwatch: Stopwatch, shade_wave: Callable[..., Any]):
        self.stopwatch, self.shade_wave = stopwatch, shade_wave
        self.chosen = allocate_wave(WAVE_SIZE)
        self.num, self.u = np.zeros(WAVE_SIZE, np.int64), np.zeros(WAVE_SIZE)

    def __call__(self, world, settings, wave, hits, num_paths, depth, *rest):
        scratch, rows = rest[-1], (self.chosen, self.num, self.u)
        where = (world, settings, wave, hits, num_paths, depth)
        num = load_choices(*where, scratch.lobes, *rows)
        choose = (choose_lights, world, num, *rows, scratch.picks)
        self.stopwatch.counts["vertices"] += num
        self.stopwatch.counts["choice"] += self.stopwatch.time("choice", *choose)
        return self.shade_wave(*where, *rest)


def measure_scene(
    scene: Scene, num_pixels: int, samples: int, threads: int, progress: Progress
) -> dict[str, Any]:
    """All figures of one scene but those of reading it and of memory."""
    scene = replace(scene, camera=_resized(scene.camera, num_pixels))
    scene.check()
    settings = Settings(samples=samples, threads=threads)
    progress(0.05, "Loading kernels")
    # Before the stopwatches start: loading them renders a tiny scene.
    seconds_compile = compile_kernels(lambda share, text: progress(0.05 + 0.25 * share, text))
    progress(0.3, "Preparing")
    renderer, startup = _prepare(scene, settings)
    startup["kernels"] = seconds_compile
    progress(0.4, "Rendering on one thread")
    total_s, parts, counts = _render_watched(renderer, settings)
    progress(0.6, "Rendering on all threads")
    threads_s = _render(renderer, settings).seconds_render
    progress(0.8, "Choosing lights")
    choice_s, counts["choice"], counts["shading"] = _watch_choices(renderer, settings)
    parts["choice"] = min(choice_s, parts["shading"])
    parts["shading"] -= parts["choice"]
    parts["rest"] = total_s - sum(parts.values())
    return {
        "width_px": scene.camera.width_px,
        "height_px": scene.camera.height_px,
        "samples": samples,
        "triangles": len(scene.triangles),
        "lights": len(renderer.world.sampler.lights.kind),
        "startup_s": startup,
        "render_s": {name: parts[name] for name in PARTS},
        "total_s": total_s,
        "counts": counts,
        "per_second": {
            name: num / parts[name] if parts[name] > 0 else 0.0 for name, num in counts.items()
        },
        "threads": settings.num_threads,
        "threads_s": threads_s,
        "speed_up": total_s / threads_s,
    }


def _resized(camera, num_pixels):
    """The whole frame of a camera with about so many pixels."""
    factor = (num_pixels / (camera.width_px * camera.height_px)) ** 0.5
    width, height = (max(1, round(factor * x)) for x in (camera.width_px, camera.height_px))
    return replace(camera, width_px=width, height_px=height, crop_px=(0, 0, width, height))


def _render(renderer: Renderer, settings: Settings) -> Film:
    renderer.settings = settings
    return renderer.run(lambda: False, lambda film: None)


def _prepare(scene: Scene, settings: Settings) -> tuple[Renderer, dict[str, float]]:
    """A renderer, and the seconds that its parts took."""
    stopwatch = Stopwatch()
    in_render = {"build_world": "world", "Tracer": "embree"}
    with (
        stopwatch.watching(RENDER, in_render),
        stopwatch.watching(WORLD, {"build_sampler": "tree"}),
    ):
        renderer = Renderer(scene, settings, lambda share, message: None)
    seconds = stopwatch.seconds
    parts = {name: seconds[name] for name in ("embree", "tree")}
    return renderer, parts | {"tables": seconds["world"] - seconds["tree"]}


def _render_watched(
    renderer: Renderer, settings: Settings
) -> tuple[float, dict[str, float], dict[str, int]]:
    """(total seconds, seconds of Embree and of shading, rays) of a render on one thread."""
    stopwatch = Stopwatch()
    tracers = renderer.tracer, renderer.lamp_tracer
    renderer.tracer, renderer.lamp_tracer = (WatchedTracer(x, stopwatch) for x in tracers)
    try:
        with stopwatch.watching(RENDER, dict.fromkeys(SHADING_KERNELS, "shading")):
            film = _render(renderer, replace(settings, threads=1))
    finally:
        renderer.tracer, renderer.lamp_tracer = tracers
    parts = {name: stopwatch.seconds[name] for name in ("closest", "occlusion", "shading")}
    counts = {name: stopwatch.counts[name] for name in ("closest", "occlusion")}
    return film.seconds_render, parts, counts


def _watch_choices(renderer: Renderer, settings: Settings) -> tuple[float, int, int]:
    """(seconds of choosing lights, lights, vertices) of the same render."""
    shade_wave = RENDER.shade_wave
    # The first sample loads the kernels above, and does not count.
    for samples in (1, settings.samples):
        stopwatch = Stopwatch()
        RENDER.shade_wave = ChoiceWatch(stopwatch, shade_wave)
        try:
            _render(renderer, replace(settings, threads=1, samples=samples))
        finally:
            RENDER.shade_wave = shade_wave
    counts = stopwatch.counts
    return stopwatch.seconds["choice"], counts["choice"], counts["vertices"]


def run_bench(
    files: Sequence[Path],
    num_pixels: int,
    samples: int,
    threads: int,
    progress: Progress,
    view: View = AS_SAVED,
) -> dict[str, Any]:
    """Measure scenes, each in a process of its own, so that memory and start-up are its own."""
    rows, versions = [], {}
    for i, file in enumerate(files):

        def advance(share: float, text: str, i: int = i, name: str = file.stem) -> None:
            progress((i + share) / len(files), f"{name}: {text}")

        job = {"do": "bench", "file": os.path.abspath(file), "num_pixels": num_pixels}
        job |= {"view": view._asdict()}
        with RenderProcess() as process:
            figures = process.ask(job | {"samples": samples, "threads": threads}, advance)
            versions = process.versions
        rows.append({"scene": file.stem} | figures)
    machine = {"machine": platform.machine(), "system": sys.platform, "cpus": os.cpu_count()}
    return {"format": 1, "versions": versions, "machine": machine, "scenes": rows}


def write_json(found: dict[str, Any], path: Path) -> None:
    """Write all figures; seconds, counts and MiB."""
    with replacing(path) as temp:
        temp.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


def build_table(rows: Sequence[dict[str, Any]]) -> Table:
    """The figures of scenes side by side."""
    table = Table("", *(Column(row["scene"], justify="right") for row in rows))

    def add(name: str, tell: Callable[[dict[str, Any]], str]) -> None:
        table.add_row(name, *map(tell, rows))

    add("triangles", lambda row: f"{row['triangles']:,}")
    add("lights", lambda row: f"{row['lights']:,}")
    add("pixels x samples", lambda row: "{width_px} x {height_px} x {samples}".format(**row))
    table.add_section()
    for name, words in STARTUP.items():
        add(words, lambda row, name=name: f"{row['startup_s'][name]:.3f} s")
    table.add_section()
    for name, words in PARTS.items():
        add(words, lambda row, name=name: _share(row, name))
    add("rendering, one thread", lambda row: f"{row['total_s']:.2f} s")
    add("speed-up by threads", lambda row: f"{row['speed_up']:.2f} on {row['threads']}")
    table.add_section()
    add("peak memory", lambda row: _mib(row["peak_mib"]))
    add("of it before the scene", lambda row: _mib(row["base_mib"]))
    return table


def _share(row: dict[str, Any], name: str) -> str:
    """Seconds, share of the render, and a rate where things are counted."""
    seconds = row["render_s"][name]
    text = f"{seconds:.2f} s {seconds / row['total_s']:4.0%}"
    rate = row["per_second"].get(name)
    return text if rate is None else f"{rate / 1e6:.2f} M/s {text}"


def _mib(number: float | None) -> str:
    return "unknown" if number is None else f"{number:,.0f} MiB"
