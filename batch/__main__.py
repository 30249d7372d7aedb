"""The command line: parsing, printing and exit codes; the work is done elsewhere.

Exit codes: 0 done, 1 something went wrong, 2 bad input, 130 stopped with Ctrl-C. Whatever takes
long to import, bpy above all, is imported by the command that needs it.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from rich.table import Column, Table

from . import comparing, measuring, serving, single
from .arguments import (
    Blend,
    CameraName,
    Frame,
    SceneName,
    Size,
    Strict,
    Threads,
    Tree,
    ViewLayer,
    existing_file,
    open_file,
    output_file,
    own_arguments,
    parse_counts,
    parse_frames,
    parse_names,
    parse_numbers,
    parse_size,
    render_settings,
    tree_properties,
)
from .comparing import command_line, tell_outcome
from .console import console, progress_bar
from .methods import ENDLESS, METHODS, InputError
from .process import Progress, running_blender
from .views import AS_SAVED, View

if TYPE_CHECKING:
    from .experiment import Options

NO_SPACE = os.strerror(errno.ENOSPC)

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code.

    Inside Blender, commands that get no file take the one that is open, as it is on disk.
    """
    argv = list(own_arguments() if argv is None else argv)
    if running_blender():  # which lets Ctrl-C stop renders in its own process, and nothing else
        signal.signal(signal.SIGINT, signal.default_int_handler)
    opened = {}
    if file := open_file():
        opened = {name: {"file": file} for name in ("render", "export", "probe")}
        opened["bench"] = {"files": [file]}
    command = typer.main.get_command(app)
    try:
        code = command.main(
            argv, "lighttree", standalone_mode=False, obj=[*argv], default_map=opened
        )
    except typer.TyperException as error:
        return _fail(error, error.format_message(), 2)
    except Exception as error:
        return _fail(error, *_explain(error))
    if code == 130:
        console.print("lighttree: stopped; run the same command again to go on.")
    return code or 0


def _explain(error: Exception) -> tuple[str, int]:
    """One sentence for the user, and the exit code."""
    if NO_SPACE in str(error):  # an OSError, or a RuntimeError of OpenEXR
        return "The disk is full; make room and run the same command again.", 1
    if type(error).__module__.startswith("lighttree_"):  # our own errors tell all there is to tell
        return str(error), 2 if isinstance(error, ValueError) else 1
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}.", 1
    return f"Internal error, {type(error).__name__}: {error}; --debug tells where.", 1


def _fail(error: Exception, sentence: str, code: int) -> int:
    if os.environ.get("LIGHTTREE_DEBUG"):
        traceback.print_exception(error)
    for line in sentence.splitlines():
        console.print(f"lighttree: {line}", markup=False)
    return code


@app.callback()
def set_up(
    debug: Annotated[bool, typer.Option("--debug", help="Show where an error came from.")] = False,
) -> None:
    """Render Blender scenes with very many lights, and measure LightTree against Cycles.

    **Try it**: build a small city, render it with both, open the report it names:

        lighttree demo

    **Compare** on your own scenes at equal time, 1 to 16 seconds an image:

        lighttree compare a.blend b.blend --out results --seconds 1,2,4,8,16

    **Render** with LightTree alone, for half a minute:

        lighttree render street.blend -o street.exr --seconds 30

    **Make a scene** with 100,000 lights, and save one for use without Blender:

        lighttree scene city -o city.blend --lights 100000
        lighttree export city.blend -o city.npz
    """
    if debug:
        os.environ["LIGHTTREE_DEBUG"] = "1"


def _warn(sentences: Sequence[str]) -> None:
    for sentence in sentences:
        console.print(f"Not modelled: {sentence}", markup=False)


@app.command()
def scene(
    name: Annotated[str, typer.Argument(help="Which scene, see --list.")] = "",
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE.blend")] = None,
    lights: Annotated[int | None, typer.Option(help="How many lights, about.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another scene.")] = 0,
    list_all: Annotated[bool, typer.Option("--list", help="List all scenes.")] = False,
) -> None:
    """Build one of LightTree's test scenes.

    lighttree scene city-small -o city.blend --lights 2000
    """
    if list_all:
        from .scenes import SCENES

        table = Table(
            Column("Scene", no_wrap=True), Column("Lights", justify="right"), "What it is"
        )
        for key, recipe in SCENES.items():
            table.add_row(key, f"{recipe.num_lights:,}", recipe.description)
        Console().print(table)
        return
    if not name or out is None:
        raise InputError("Give a scene and -o FILE.blend; `lighttree scene --list` shows them.")
    path = output_file(out, ".blend")
    with progress_bar() as progress:
        single.build_blend(name, path, lights, seed, progress)
    typer.echo(out)


@app.command()
def render(
    file: Annotated[Path, typer.Argument(metavar="FILE.blend|SCENE.npz")],
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="OUT.exr")] = None,
    samples: Annotated[int | None, typer.Option(min=1, help="Samples a pixel.")] = None,
    seconds: Annotated[float | None, typer.Option(min=1e-3, help="Time limit.")] = None,
    sampler: Annotated[Literal["tree", "power", "uniform"] | None, typer.Option()] = None,
    split_lights: Annotated[
        int | None, typer.Option(min=1, max=64, help="Lights chosen at a point.")
    ] = None,
    tree: Tree = None,
    mis: Annotated[Literal["power", "balance"] | None, typer.Option()] = None,
    pixel_filter: Annotated[
        Literal["box", "gaussian", "blackman-harris"] | None, typer.Option("--filter")
    ] = None,
    threads: Threads = 0,
    seed: Annotated[int | None, typer.Option(min=0)] = None,
    scene: SceneName = None,
    view_layer: ViewLayer = None,
    camera: CameraName = None,
    frame: Annotated[
        list | None,
        typer.Option(
            parser=parse_frames, metavar="1,10,20-40", help="Each into a file of its own."
        ),
    ] = None,
    resolution: Size = None,
    bounces: Annotated[int | None, typer.Option(min=0, help="0 is direct light only.")] = None,
    strict: Strict = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Tell what the scene uses; render nothing.")
    ] = False,
    list_all: Annotated[
        bool, typer.Option("--list", help="Tell scenes, cameras, frames; render nothing.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="With --explain or --list: for programs.")
    ] = False,
) -> None:
    """Render a .blend or an exported scene with LightTree.

    What is not given is as the file has it, or LightTree's default for an exported scene. Colours,
    alpha if the film is transparent, and all passes go into one EXR; of several frames, into one
    each, OUT.0001.exr and so on, and the same command again goes on where it was stopped.

        lighttree render street.blend -o street.exr --seconds 30
        lighttree render street.blend --explain
        lighttree render street.blend -o street.exr --tree split=sah --tree buckets=1000
    """
    views = [View(camera, number, scene, view_layer) for number in frame or (None,)]
    is_exported = file.suffix.lower() == ".npz"
    if is_exported and (views != [AS_SAVED] or resolution):
        raise InputError(f"{file}: an exported scene is seen as it was exported.")
    if list_all:
        return _list_file(file, as_json)
    if explain:
        return _explain_file(file, views[0], as_json)
    if out is None:
        raise InputError("Give -o OUT.exr, or --explain to render nothing.")
    if samples and seconds:
        raise InputError("--samples and --seconds exclude each other; give one of them.")
    given = {"samples": samples, "sampler": sampler, "split_lights": split_lights, "mis": mis}
    given |= {"seed": seed, "filter": pixel_filter, "max_bounces": bounces}
    given |= tree_properties(tree or ())
    if samples or seconds:
        given |= {"samples": samples or ENDLESS, "time_limit_s": seconds or 0.0}
    given = {key: value for key, value in given.items() if value is not None}
    source, path = existing_file(file), output_file(out, ".exr")
    with progress_bar() as progress:
        if is_exported:
            rendered = [(path, single.render_npz(source, path, given, threads, strict, progress))]
        else:
            given |= {"strict": True} if strict else {}
            settings = render_settings(resolution, threads)
            outs = {_frame_path(path, view.frame, len(views)): view for view in views}
            rendered = [*single.render_blend(source, outs, given, settings, progress)]
    for path, facts in rendered:
        _tell_render(facts)
        typer.echo(out if len(rendered) == 1 else out.with_name(path.name))


def _frame_path(path: Path, frame: int | None, num: int) -> Path:
    """Where one of several frames goes: OUT.0001.exr for OUT.exr, as Blender numbers them."""
    if num == 1:
        return path
    return path.with_name(f"{path.stem}.{'-' * (frame < 0)}{abs(frame):04}{path.suffix}")


def _tell_render(facts: dict) -> None:
    _warn(facts["not_modelled"])
    if facts["dropped_samples"]:
        console.print(f"{facts['dropped_samples']} samples were not finite and count as black.")
    if facts["is_black"]:
        console.print("The image is black: no light reaches what the camera sees.")
    if facts.get("is_kept"):
        return console.print("Rendered before, with the same settings.")
    console.print(f"{facts['samples']} samples a pixel in {facts['seconds_render']:.1f} s.")


def _explain_file(file: Path, view: View, as_json: bool) -> None:
    existing_file(file)
    with progress_bar() as progress:
        facts = single.explain_file(file, progress, view)
    from .explain import tell

    for line in [json.dumps(facts, indent=2)] if as_json else tell(facts):
        typer.echo(line)


def _list_file(file: Path, as_json: bool) -> None:
    existing_file(file)
    with progress_bar() as progress:
        found = single.list_blend(file, progress)
    if as_json:
        return typer.echo(json.dumps(found, indent=2))
    for entry in found:
        typer.echo(
            f"Scene {entry['scene']}: frame {entry['frame']} of {entry['frames'][0]} to "
            f"{entry['frames'][1]}, {'{} x {}'.format(*entry['resolution'])} pixels at "
            f"{entry['percentage']} %"
        )
        cameras = [f"{name}{' (active)' * (name == entry['camera'])}" for name in entry["cameras"]]
        typer.echo(f"  Cameras: {', '.join(cameras) or 'none'}")
        layers = entry["view_layers"] + [
            f"{name} (not used)" for name in entry["unused_view_layers"]
        ]
        typer.echo(f"  View layers: {', '.join(layers)}")


@app.command()
def export(
    file: Blend,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="SCENE.npz")],
    scene: SceneName = None,
    view_layer: ViewLayer = None,
    camera: CameraName = None,
    frame: Frame = None,
    resolution: Size = None,
) -> None:
    """Save a .blend for LightTree's core, to be rendered without Blender.

    lighttree export street.blend -o street.npz
    """
    source, path = existing_file(file), output_file(out, ".npz")
    with progress_bar() as progress:
        view = View(camera, frame, scene, view_layer)
        settings = render_settings(resolution)
        not_modelled = single.export_blend(source, path, progress, view, settings)
    _warn(not_modelled)
    typer.echo(out)


@app.command()
def compare(
    context: typer.Context,
    files: Annotated[list[Path] | None, typer.Argument(metavar="FILE.blend...")] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Where results go.")
    ] = Path("results"),
    seconds: Annotated[
        list | None,
        typer.Option(parser=parse_numbers, metavar="1,2,4", help="Compare at equal time: seconds."),
    ] = None,
    samples: Annotated[
        list | None,
        typer.Option(
            parser=parse_counts, metavar="1,4,16", help="Compare at equal samples instead."
        ),
    ] = None,
    methods: Annotated[
        list | None,
        typer.Option(parser=parse_names, metavar="A,B", help=f"Of: {', '.join(METHODS)}."),
    ] = None,
    resolution: Annotated[tuple, typer.Option(parser=parse_size, metavar="WxH")] = "480x270",
    bounces: Annotated[int, typer.Option(help="0 is direct light only.")] = 4,
    seeds: Annotated[int, typer.Option(help="Renders of each, for a spread.")] = 2,
    reference_seconds: Annotated[
        float, typer.Option(metavar="T", help="For each reference; 0 chooses.")
    ] = 0,
    camera: Annotated[
        list | None,
        typer.Option(
            parser=parse_names, metavar="A,B|auto", help="Cameras; auto looks at everything."
        ),
    ] = None,
    frame: Annotated[
        list | None,
        typer.Option(parser=parse_frames, metavar="1,10,20-40", help="Frames to render."),
    ] = None,
    scene: SceneName = None,
    view_layer: ViewLayer = None,
    threads: Threads = 0,
    strict: Strict = False,
    probe: Annotated[
        bool, typer.Option("--probe", help="Judge the choice of lights too, as lighttree probe.")
    ] = False,
    tree: Tree = None,
    thesis: Annotated[
        bool, typer.Option("--thesis", help="The scenes and tables of the thesis, without Cycles.")
    ] = False,
    max_lights: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Of --thesis: lights a scene, at most.")
    ] = None,
) -> None:
    """Render with LightTree and Cycles, measure their errors, write a report.

    Both engines get the same file, camera, resolution, bounces, threads and pixel filter; clamping,
    denoising and all else that hides noise or loses light is off, as is motion blur. Each file is
    rendered from its active camera unless --camera names others, at the frame it was saved at
    unless --frame does.

    The same command again goes on where it was stopped and renders nothing twice.

        lighttree compare street.blend --out results --seconds 1,2,4,8
        lighttree compare *.blend --out results --samples 1,4,16
        lighttree compare --thesis --out thesis --seconds 8
    """
    from .plan import Options

    if seconds and samples:
        raise InputError("--seconds and --samples exclude each other; give one of them.")
    if files and thesis:
        raise InputError("--thesis has scenes of its own; give it or files, not both.")
    if not files and not thesis and (file := open_file()):
        files = [Path(file)]
        context.obj.append(file)
    if not files and not thesis:
        raise InputError("Missing argument 'FILE.blend...': files to compare, or --thesis.")
    if max_lights and not thesis:
        raise InputError("--max-lights is an option of --thesis.")
    given = {"methods": methods, "budgets": samples or seconds}
    given = {key: value for key, value in given.items() if value}
    if thesis:
        from .thesis import DEFAULTS, build_scenes, build_tables

        given = DEFAULTS | given
    options = Options(
        **given,
        budget_kind="samples" if samples else "seconds",
        seeds=seeds,
        resolution=resolution,
        bounces=bounces,
        threads=threads,
        reference_seconds=reference_seconds,
        cameras=camera or (),
        frames=tuple(frame or ()),
        scene=scene,
        view_layer=view_layer,
        strict=strict,
        probe=probe,
        tree=tree_properties(tree or ()),
    )
    if not thesis:
        return _compare(context, files, out, options)
    with progress_bar() as progress:
        files = build_scenes(out, max_lights, progress)
    _compare(context, files, out, options, partial(build_tables, out, max_lights))


def _compare(
    context: typer.Context,
    files: Sequence[Path],
    out: Path,
    options: Options,
    build_tables: Callable[[Progress], list[Table]] = lambda progress: [],
) -> None:
    from .experiment import run_comparison

    with progress_bar() as progress:
        outcome = run_comparison(files, out, options, progress, command_line(context))
        tables = build_tables(progress)
    tell_outcome(outcome, tables)


@app.command()
def report(folder: Annotated[Path, typer.Argument(metavar="DIR")]) -> None:
    """Rebuild the report of a result folder; renders nothing."""
    from .report import write_report

    with progress_bar() as progress:
        path = write_report(folder, progress)
    typer.echo(path)


app.command()(comparing.batch)
app.command()(serving.scheduler)
app.command()(serving.worker)
app.command()(measuring.probe)
app.command()(measuring.bench)
app.command()(measuring.history)


@app.command()
def demo(
    context: typer.Context,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR")] = Path("demo"),
) -> None:
    """Build a small city, compare LightTree with Cycles on it, write the report: 3 minutes."""
    from .plan import Options

    file = output_file(out / "city-small.blend", ".blend")
    if not file.exists():
        with progress_bar() as progress:
            single.build_blend("city-small", file, None, 0, progress)
    left_out = ("lighttree-single", "lighttree-thesis", "cycles-guiding")
    options = Options(
        methods=[name for name in METHODS if name not in left_out],
        budgets=(1, 2, 4),
        seeds=1,
        resolution=(256, 144),
        reference_seconds=20,
    )
    _compare(context, [file], out, options)


if __name__ == "__main__":
    sys.exit(main())
