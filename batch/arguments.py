"""Arguments of the command line: from text to values, or a sentence that says what is wrong."""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from .methods import InputError
from .process import running_blender

MOST_FRAMES = 100_000
# Its defaults come first.
TREE_HELP = (
    "An option of the light tree, as often as there are some to give: "
    "split=saoh|sah|middle|equal, thin_box=on|off, buckets=0 (all cuts) or 2 to 4096, "
    "bucket_kind=width|count, cone_axis=mean|union, width=2 to 16, "
    "importance=moments|clamped|cutoff, split_threshold=0 to 1 (no splitting)."
)


Blend = Annotated[Path, typer.Argument(metavar="FILE.blend")]
SceneName = Annotated[
    str | None, typer.Option("--scene", metavar="NAME", help="Which scene of the file.")
]
ViewLayer = Annotated[
    str | None,
    typer.Option("--view-layer", metavar="NAME", help="Which one, used for rendering or not."),
]
CameraName = Annotated[
    str | None,
    typer.Option(
        "--camera", metavar="NAME|auto", help="Which one; auto looks at everything in the scene."
    ),
]
Frame = Annotated[
    int | None, typer.Option("--frame", help="Which one, instead of that the file was saved at.")
]
Threads = Annotated[int, typer.Option(min=0, max=1024, help="CPU threads; 0 for all cores.")]
Strict = Annotated[bool, typer.Option("--strict", help="Refuse what LightTree does not model.")]
Tree = Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help=TREE_HELP)]


def own_arguments() -> list[str]:
    """The arguments of this process that are for us; Blender's own come first and end at "--"."""
    if running_blender() is None:
        return sys.argv[1:]
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def open_file() -> str:
    """The .blend that is open in the Blender we run in; empty without one."""
    blender = running_blender()
    return blender.data.filepath if blender else ""


def parse_numbers(text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a list of numbers like 1,2,4.") from None
    return [int(number) if number.is_integer() else number for number in numbers]


def parse_counts(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a list of whole numbers like 1,4,16.") from None


def parse_frames(text: str) -> list[int]:
    frames = []
    for part in text.split(","):
        if not (found := re.fullmatch(r"\s*(-?\d+)(?:-(-?\d+))?\s*", part)):
            raise typer.BadParameter(f"'{text}' is not a list of frames like 1,10,20-40.")
        first, last = int(found[1]), int(found[2] or found[1])
        if first > last:
            raise typer.BadParameter(f"The frames {part.strip()} end before they begin.")
        if last - first >= MOST_FRAMES:
            raise typer.BadParameter(f"{part.strip()} are over {MOST_FRAMES:,} frames.")
        frames += range(first, last + 1)
    return list(dict.fromkeys(frames))


def parse_names(text: str) -> list[str]:
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def parse_size(text: str) -> tuple[int, int]:
    try:
        width, height = map(int, text.lower().split("x"))
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not a size in pixels like 480x270.") from None
    return width, height


Size = Annotated[tuple | None, typer.Option("--resolution", parser=parse_size, metavar="WxH")]


def render_settings(resolution: tuple[int, int] | None, threads: int = 0) -> dict[str, Any]:
    """Settings of `scene.render` that are not those of the file."""
    settings = {"threads_mode": "FIXED", "threads": threads} if threads else {}
    if resolution:
        width, height = resolution
        settings |= {"resolution_x": width, "resolution_y": height, "resolution_percentage": 100}
    return settings


def tree_properties(texts: Sequence[str]) -> dict[str, Any]:
    """What "name=value" texts set, by its names in `scene.lighttree`: {"tree_split": "sah"}."""
    from lighttree_core.light_tree.options import TreeOptions

    try:
        options = TreeOptions.parse(texts)
    except ValueError as error:
        raise InputError(f"--tree {error}.") from None
    names = (text.partition("=")[0] for text in texts)
    return {f"tree_{name}": getattr(options, name) for name in names}


def output_file(path: Path, suffix: str) -> Path:
    """An absolute path to write to, refused early if that is not possible."""
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: the name of the file to write must end in {suffix}.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            return path.absolute()
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error


def existing_file(path: Path) -> str:
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    return str(path.absolute())
