"""Build, render, explain or export one scene: what `lighttree scene`, `render`, `export` do."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .images import write_exr
from .methods import InputError, tree_options
from .process import Progress, RenderProcess


def build_blend(
    name: str, out: Path, num_lights: int | None, seed: int, progress: Progress
) -> None:
    """Build the scene `name` of `scenes.py`."""
    with _unfinished(out) as temp, RenderProcess() as process:
        job = {"do": "build", "name": name, "num_lights": num_lights, "seed": seed}
        process.ask(job | {"out": str(temp)}, progress)


def render_blend(
    file: Path, out: Path, settings: dict[str, Any], threads: int, progress: Progress
) -> dict:
    """Render a .blend with its own settings but those given; returns the facts of the render."""
    render = {"threads_mode": "FIXED", "threads": threads} if threads else {}
    with _unfinished(out) as temp, RenderProcess() as process:
        job = {"do": "render_file", "file": os.path.abspath(file), "out": str(temp)}
        seconds = settings.get("time_limit_s", 0)
        return process.ask(job | {"settings": settings, "render": render}, progress, seconds)


def render_npz(
    file: Path, out: Path, settings: dict[str, Any], threads: int, strict: bool, progress: Progress
) -> dict:
    """Render an exported scene, without Blender; returns the facts of the render."""
    from lighttree_core import Scene, Settings, render

    scene = Scene.load(file)
    if strict and scene.not_modelled:
        raise InputError(f"{file}: {scene.not_modelled[0]} (refused by --strict)")
    rest = {name: settings[name] for name in settings if not name.startswith("tree_")}
    chosen = Settings(**rest, tree=tree_options(settings), threads=threads)
    film = render(scene, chosen, progress)
    facts = {
        "samples": film.num_samples,
        "seconds_render": film.seconds_render,
        "seconds_setup": film.seconds_setup,
        "seconds_compile": film.seconds_compile,
        "dropped_samples": film.dropped_samples,
        "not_modelled": scene.not_modelled,
        "is_black": not film.mean.any(),
    }
    image = film.mean[::-1]
    with _unfinished(out) as temp:
        channels = {name: image[..., i] for i, name in enumerate("RGB")}
        write_exr(temp, channels, {"file": str(file), "engine_settings": asdict(chosen)} | facts)
    return facts


def explain_file(file: Path, progress: Progress) -> dict:
    """What a .blend or an exported scene uses of LightTree, see `explain.py`."""
    from lighttree_core import Scene

    from .explain import explain_scene

    if file.suffix.lower() == ".npz":
        return explain_scene(Scene.load(file))
    with RenderProcess() as process:
        return process.ask({"do": "explain", "file": os.path.abspath(file)}, progress)


def export_blend(
    file: Path,
    out: Path,
    progress: Progress,
    camera: str | None = None,
    frame: int | None = None,
) -> list[str]:
    """Save a .blend as a scene for LightTree's core; returns what is not modelled.

    camera, frame: None for those it was saved with.
    """
    with _unfinished(out) as temp, RenderProcess() as process:
        job = {"do": "export", "file": os.path.abspath(file), "camera": camera, "frame": frame}
        return process.ask(job | {"out": str(temp)}, progress)


@contextmanager
def _unfinished(out: Path) -> Iterator[Path]:
    """A path in a temporary folder beside `out`, which becomes `out` if the block succeeds."""
    with tempfile.TemporaryDirectory(prefix=".lighttree-", dir=out.parent) as folder:
        temp = Path(folder, out.name).absolute()
        yield temp
        os.replace(temp, out)
