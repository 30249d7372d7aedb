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
from .process import ProcessDied, Progress, RenderError, RenderProcess
from .views import AS_SAVED, View


def build_blend(
    name: str, out: Path, num_lights: int | None, seed: int, progress: Progress
) -> None:
    """Build the scene `name` of `scenes.py`."""
    with _unfinished(out) as temp, RenderProcess() as process:
        job = {"do": "build", "name": name, "num_lights": num_lights, "seed": seed}
        process.ask(job | {"out": str(temp)}, progress)


def render_blend(
    file: Path,
    outs: dict[Path, View],
    settings: dict[str, Any],
    render: dict[str, Any],
    progress: Progress,
) -> Iterator[tuple[Path, dict]]:
    """Render a .blend with its own settings but those given; yields each image and its facts.

    outs: what is seen in each image; of several, those are kept that were rendered before. render:
    settings of `scene.render`.
    """
    job = {"do": "render_file", "file": os.path.abspath(file), "settings": settings}
    with RenderProcess() as process:
        for i, (out, view) in enumerate(outs.items()):

            def advance(share: float, text: str, i: int = i, name: str = out.stem) -> None:
                several = len(outs) > 1
                progress((i + share) / len(outs), f"{name}: {text}" if several else text)

            old = str(out.absolute()) if len(outs) > 1 else ""
            with _unfinished(out) as temp, _blame_blender(file, view):
                images = {"view": view._asdict(), "render": render, "old": old, "out": str(temp)}
                facts = process.ask(job | images, advance, settings.get("time_limit_s", 0))
            yield out, facts


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


def list_blend(file: Path, progress: Progress) -> list[dict]:
    """What each scene of a .blend has to render, the active one first."""
    with RenderProcess() as process:
        return process.ask({"do": "list", "file": os.path.abspath(file)}, progress)


def explain_file(file: Path, progress: Progress, view: View = AS_SAVED) -> dict:
    """What a .blend or an exported scene uses of LightTree, see `explain.py`."""
    from lighttree_core import Scene

    from .explain import explain_scene

    if file.suffix.lower() == ".npz":
        return explain_scene(Scene.load(file))
    with RenderProcess() as process, _blame_blender(file, view):
        job = {"do": "explain", "file": os.path.abspath(file), "view": view._asdict()}
        return process.ask(job, progress)


def export_blend(
    file: Path,
    out: Path,
    progress: Progress,
    view: View = AS_SAVED,
    render: dict[str, Any] | None = None,
) -> list[str]:
    """Save a .blend as a scene for LightTree's core; returns what is not modelled.

    render: settings of `scene.render`, beside those of the file.
    """
    with _unfinished(out) as temp, RenderProcess() as process, _blame_blender(file, view):
        job = {"do": "export", "file": os.path.abspath(file), "view": view._asdict()}
        return process.ask(job | {"render": render or {}, "out": str(temp)}, progress)


@contextmanager
def _blame_blender(file: Path, view: View) -> Iterator[None]:
    """Where a process crashes, tell whether Blender does so without us, with Cycles."""
    try:
        yield
    except ProcessDied as error:
        if error.is_crash and _kills_cycles(file, view):
            sentence = (
                f"{file}: Blender itself crashed while evaluating this file (Cycles does too)."
            )
            raise ProcessDied(sentence, error.status, error.output) from error
        raise


def _kills_cycles(file: Path, view: View) -> bool:
    job = {"do": "try_cycles", "file": os.path.abspath(file), "view": view._asdict()}
    try:
        with RenderProcess() as process:
            process.ask(job)
    except ProcessDied:
        return True
    except (RenderError, ValueError, OSError):
        return False
    return False


@contextmanager
def _unfinished(out: Path) -> Iterator[Path]:
    """A path in a temporary folder beside `out`, which becomes `out` if the block succeeds."""
    with tempfile.TemporaryDirectory(prefix=".lighttree-", dir=out.parent) as folder:
        temp = Path(folder, out.name).absolute()
        yield temp
        if temp.exists():  # not if what is there already was kept
            os.replace(temp, out)
