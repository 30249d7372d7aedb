"""The commands that measure LightTree by itself: `lighttree probe`, `bench` and `history`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from . import single
from .arguments import (
    CameraName,
    Frame,
    SceneName,
    Threads,
    Tree,
    ViewLayer,
    existing_file,
    output_file,
)
from .console import console, progress_bar
from .views import View


def probe(
    file: Annotated[Path, typer.Argument(metavar="FILE.blend|SCENE.npz")],
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="DIR")] = None,
    points: Annotated[int, typer.Option(min=1, help="And as many after one bounce.")] = 200,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    tree: Tree = None,
    threads: Threads = 0,
    scene: SceneName = None,
    view_layer: ViewLayer = None,
    camera: CameraName = None,
    frame: Frame = None,
) -> None:
    """Judge the choice of lights alone: its variance and cost at points the camera sees.

    Writes into SCENE-probe beside the scene, unless --out names a folder. With --tree a light tree
    of those options is judged beside the usual one.

        lighttree probe city.npz --tree split=sah --tree width=2
    """
    existing_file(file)
    out = out or file.with_name(f"{file.stem}-probe")
    folder = output_file(out / "probe.csv", ".csv").parent
    with progress_bar() as progress:
        from . import probe, probe_report

        view = View(camera, frame, scene, view_layer)
        found = probe.run_probe(file, points, seed, tree or (), threads, progress, view)
        probe_report.write_files(found, folder)
    Console(width=max(console.width, 120)).print(probe_report.build_table(found))
    typer.echo(out)


def bench(
    files: Annotated[list[Path] | None, typer.Argument(metavar="FILE.blend|SCENE.npz...")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="OUT.json", help="Write all figures too.")
    ] = None,
    samples: Annotated[int, typer.Option(min=1, help="Samples a pixel.")] = 32,
    quick: Annotated[
        bool, typer.Option("--quick", help="A small image: all figures, none of them exact.")
    ] = False,
    threads: Threads = 0,
    scene: SceneName = None,
    view_layer: ViewLayer = None,
    camera: CameraName = None,
    frame: Frame = None,
) -> None:
    """Measure where LightTree's time goes; without files, in a small city.

    Each scene is rendered with default settings at 320 x 180 pixels, or as many of its own shape.

    **Start-up**: what comes before the first sample. The first time ever kernels are compiled then.

    **Rendering**, on one thread: closest hits, shadow rays, lights chosen and vertices shaded a
    second; seconds; share of the whole. Choosing lights is timed by itself, for the same vertices
    once more, and taken off shading. Weighing the lights that rays meet counts as shading.

    **Speed-up**: of the same render on all threads, or on --threads.

    **Memory**: of the whole process, with Blender in it.

        lighttree bench
        lighttree bench street.blend city.npz --json figures.json
    """
    from .bench import NUM_PIXELS, QUICK_PIXELS, QUICK_SAMPLES, build_table, run_bench, write_json

    for file in files or ():
        existing_file(file)
    path = json_file and output_file(json_file, ".json")
    size = (QUICK_PIXELS, QUICK_SAMPLES) if quick else (NUM_PIXELS, samples)
    with tempfile.TemporaryDirectory() as folder, progress_bar() as progress:
        if not files:
            files = [Path(folder, "city-small.blend")]
            single.build_blend("city-small", files[0], None, 0, progress)
        view = View(camera, frame, scene, view_layer)
        found = run_bench(files, *size, threads, progress, view)
    Console(width=max(console.width, 100)).print(build_table(found["scenes"]))
    if path:
        write_json(found, path)
        typer.echo(json_file)


def history(
    folder: Annotated[Path, typer.Argument(metavar="DIR")],
    method: Annotated[str, typer.Option(help="Whose history.")] = "lighttree",
) -> None:
    """Tell how a method's error at equal time changed over the versions compared in a folder.

    Versions are compared on the same file, budget, machine and threads; one is called worse where
    its error is larger beyond the spread of the seeds.

        lighttree history results --method lighttree
    """
    from .history import build_table, read_history

    entries = read_history(folder, method)
    Console(width=max(console.width, 160)).print(build_table(entries, method))
    num_worse = sum(entry.is_worse for entry in entries)
    typer.echo(
        f"{num_worse} of {len(entries)} rows are worse than the version before; "
        "by chance alone about 1 in 40 would be."
    )
