"""A comparison for somebody who looks at Blender: one scene, one picture of it, and a short table.

It is asked of a worker (`worker.py`) by the button of the add-on, see `addon/compare.py`.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

from . import figures, metrics
from .blend import keep_shown
from .equal_time import compare_costs
from .experiment import run_comparison
from .images import replacing
from .methods import InputError, assign
from .plan import REFERENCE_CHUNKS, Options
from .report import describe_models

TITLES = {
    "lighttree": "LightTree",
    "cycles": "Cycles",
    "cycles-no-lamp-mis": "Cycles, no lamp MIS",
}
# What `run_comparison` is at: SCENE METHOD-BUDGET-seedN: ..., of a reference SCENE METHOD-N: ...
UNIT = re.compile(rf"\S+ ({'|'.join(sorted(TITLES, reverse=True))})-(?:(\d+)|[^:]*):.*")
PICTURE = "side-by-side.png"
COMMAND = "Compare with Cycles, in Blender"
# Of the picture, in pixels and sRGB: Blender's own greys.
LEAST_WIDTH_PX, GAP_PX = 360, 8
BACKGROUND, FOREGROUND = "#303030", "#e6e6e6"
DPI = 100

Progress = Callable[[float, str], None]


class Column(NamedTuple):
    """What the picture shows of one method: sRGB images with a line over each, top to bottom."""

    captions: list[str]
    images: list[np.ndarray]


def compare_scene(
    progress: Progress,
    file: str,
    out: str,
    options: dict,
    view: dict,
    shown: dict | None = None,
) -> dict:
    """Compare on one .blend; returns what to tell: a table, notes, and paths of what was written.

    options: of `plan.Options`. view: the view settings to see it with. shown: names of the scene
    and view layer to compare, where they are not those that opening the file would give.
    """
    os.chdir(Path(file).parent)  # the report calls the file by its name alone
    if shown:
        keep_shown(file, **shown)
    folder = Path(out)
    outcome = run_comparison(
        [Path(file).name],
        folder,
        Options(**options),
        lambda share, text: progress(share, translate(text)),
        COMMAND,
    )
    progress(1.0, "Drawing")
    (scene,) = metrics.read_run(folder)["scenes"]
    rows, _ = metrics.collect_results(folder)
    rows = {row["method"]: row for row in rows}
    if not rows.keys() >= {*options["methods"]} or any(
        np.isnan(r["rel_mse"]) for r in rows.values()
    ):
        raise InputError(f"Not all could be rendered: {outcome.failed[0]}")
    table = [describe_row(rows, method) for method in rows]
    draw_picture(folder / PICTURE, draw_columns(folder / scene["name"], rows, table, view))
    return {
        "table": table,
        "notes": [*outcome.failed, *describe_doubts(folder / scene["name"], scene)],
        "picture": str(folder / PICTURE),
        "report": str(outcome.report),
    }


def translate(text: str) -> str:
    """What a comparison is at, for a narrow panel."""
    if text.startswith("Measuring "):
        return "Measuring errors"
    if not (unit := UNIT.fullmatch(text)):
        return text
    method, part = unit.groups()
    if part:
        return f"{TITLES[method]} reference {int(part) + 1} of {REFERENCE_CHUNKS}"
    return f"Rendering with {TITLES[method]}"


def describe_row(rows: dict[str, dict], method: str) -> dict:
    """A line of the table. gain: how many times less error than Cycles at equal time; None if
    nobody can tell."""
    row, base = rows[method], rows.get("cycles")
    gain = None
    if base and all(r["rel_mse"] > 0 and r["seconds_render"] > 0 for r in (row, base)):
        gain = compare_costs([([row], [base])]).mean
    told = {"seconds": row["seconds_render"], "samples": int(row["samples"])}
    told |= {"error": row["rel_mse"]}
    return {"title": TITLES.get(method, method), "gain": gain} | told


def describe_doubts(folder: Path, scene: dict) -> list[str]:
    """Sentences on what, beside noise, may make the engines' images differ."""
    doubts = []
    if num := len(scene["not_modelled"]):
        things = "1 thing" if num == 1 else f"{num} things"
        doubts.append(f"LightTree does not model {things} of this scene, see the report.")
    if not metrics.read_rgb(folder / "reference.exr")[0].any():
        doubts.append("The image is black: no light reaches what the camera sees.")
    models = describe_models(folder, None)
    if models["models"] and not models["models_agree"]:
        doubts.append("The engines' converged images differ, see the report.")
    return doubts


def draw_columns(folder: Path, rows: dict[str, dict], table: list[dict], view: dict):
    """A Column for each method."""
    reference, _ = metrics.read_rgb(folder / "reference.exr")
    columns = []
    for row, line in zip(rows.values(), table, strict=True):
        path = folder / f"{row['method']}-{row['budget']}-seed{row['seed']:.0f}.exr"
        image, _ = metrics.read_rgb(path)
        error = metrics.relative_error(image, reference)
        captions = [
            f"{line['title']}: {row['seconds_render']:.3g} s, {row['samples']:.0f} samples",
            f"Relative error, yellow where 300 %; mean square {row['rel_mse']:.3g}",
        ]
        images = [develop(path, view), figures.color_error(error)]
        mean, flip = metrics.flip(image, reference)
        if np.isfinite(mean):
            captions.append(f"FLIP, bright where one sees a difference; mean {mean:.2g}")
            images.append(figures.color_flip(flip))
        columns.append(Column(captions, images))
    return columns


def develop(path: Path, view: dict) -> np.ndarray:
    """An image as Blender shows it with these view settings: (H, W, 3) sRGB in 0 to 1."""
    scene = bpy.context.scene
    assign(scene.view_settings, view)
    settings = {"file_format": "PNG", "color_mode": "RGB", "color_depth": "8"}
    assign(scene.render.image_settings, settings)
    image = bpy.data.images.load(str(path.absolute()))
    try:
        with tempfile.TemporaryDirectory() as temp:
            image.save_render(os.path.join(temp, "x.png"), scene=scene)
            return imread(os.path.join(temp, "x.png"))[..., :3]
    finally:
        bpy.data.images.remove(image)


def draw_picture(path: Path, columns: list[Column]) -> None:
    """Write the columns side by side as PNG; small images are enlarged, pixel by pixel."""
    height, width = columns[0].images[0].shape[:2]
    scale = -(-LEAST_WIDTH_PX // width)
    height, width = height * scale, width * scale
    font_px = width / 34  # so that the longest caption fits
    caption_px = int(1.8 * font_px)
    num_rows = len(columns[0].images)
    total_width = len(columns) * (width + GAP_PX) + GAP_PX
    total_height = num_rows * (height + caption_px) + GAP_PX
    figure = Figure(figsize=(total_width / DPI, total_height / DPI), dpi=DPI)
    font = {"color": FOREGROUND, "fontsize": 72 / DPI * font_px, "va": "center"}
    for column_id, (captions, images) in enumerate(columns):
        x = GAP_PX + column_id * (width + GAP_PX)
        for row_id, (caption, image) in enumerate(zip(captions, images, strict=True)):
            top = total_height - row_id * (height + caption_px)
            figure.text(x / total_width, (top - caption_px / 2) / total_height, caption, **font)
            pixels = np.repeat(np.repeat(image[::-1], scale, axis=0), scale, axis=1)
            figure.figimage(pixels, x, top - caption_px - height, origin="lower")
    with replacing(path) as temp:
        figure.savefig(temp, format="png", dpi=DPI, facecolor=BACKGROUND)
