"""The evaluation of Beini Ma's thesis, repeated: its eight scenes at equal time, and its builds.

Two tables, thesis.csv and thesis-build.csv. LightTree alone renders, the references too: the
samplers are compared within one renderer, as in the thesis. Errors contain the reference's noise.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from lighttree_core import Scene
from lighttree_core.compilation import compile_kernels
from lighttree_core.light_tree.build import build_tree
from lighttree_core.light_tree.nodes import NUM_LANES
from lighttree_core.light_tree.options import EQUAL, MIDDLE, SAH, SAOH, TreeOptions
from lighttree_core.lights import LightBounds, bound_lights, build_lights

from . import metrics, single
from .arguments import output_file
from .equal_time import compare_costs, group_by
from .images import ImageError
from .methods import METHODS, tree_options
from .process import Progress
from .scenes import SCENES
from .wording import format_budget

TREE, SINGLE, THESIS, POWER = (
    "lighttree",
    "lighttree-single",
    "lighttree-thesis",
    "lighttree-power",
)
# What a comparison of these scenes does unless told otherwise.
DEFAULTS = {
    "methods": (TREE, SINGLE, THESIS, POWER),
    "budgets": (8,),
    "references": (TREE,),
}
# Error x seconds of the first over that of the second.
RATIOS = {
    "power_over_tree": (POWER, TREE),
    "single_over_split": (SINGLE, TREE),
    "power_over_thesis": (POWER, THESIS),
}
ERROR_COLUMNS = {
    "scene": "\nscene",
    "lights": "\nlights",
    TREE: "\ntree",
    SINGLE: "tree, no\nsplitting",
    THESIS: "thesis'\nsampler",
    POWER: "by\npower",
    "power_over_tree": "power\n/ tree",
    "single_over_split": "single\n/ split",
    "power_over_thesis": "power\n/ thesis'",
    "reference_noise": "reference\nnoise",
}

BUILD_SCENE, BUILD_LIGHTS = "thesis-ceiling-points", 1_000_000
# The thesis' own numbers, of its builder and on its author's machine: quoted, not measured.
QUOTED_SECONDS = {1000: 43, 0: 3 * 3600}
QUOTED = {"tree": "QUOTED from the thesis", "split": "", "lights": 1_000_000, "threads": 1}
QUOTED |= {"machine": "Intel Core i7-4770K"}


def build_scenes(folder: Path, max_lights: int | None, progress: Progress) -> list[Path]:
    """The .blend files of the eight scenes; builds those that are not in the folder yet."""
    files = []
    for name, recipe in SCENES.items():
        if name.startswith("thesis-"):
            most = max(recipe.min_lights, max_lights or recipe.num_lights)
            stem = name if most >= recipe.num_lights else f"{name}-{most}"
            files.append(output_file(folder / f"{stem}.blend", ".blend"))
            if not files[-1].exists():
                single.build_blend(name, files[-1], min(most, recipe.num_lights), 0, progress)
    return files


def build_tables(folder: Path, max_lights: int | None, progress: Progress) -> list[Table]:
    """Measure a finished comparison, time builds, write both as CSV; returns both to be printed."""
    run, errors = metrics.read_run(folder), collect_errors(folder, progress)
    with tempfile.TemporaryDirectory(dir=folder) as temp:
        bounds = load_bounds(Path(temp), min(BUILD_LIGHTS, max_lights or BUILD_LIGHTS), progress)
    builds = time_builds(bounds, run["threads"], run["machine"]["cpu"], progress)
    metrics.write_rows(folder / "thesis.csv", errors[0], errors)
    metrics.write_rows(folder / "thesis-build.csv", builds[0], builds)
    thesis_tree = tree_options(METHODS[THESIS].overrides)
    return [
        _draw(
            [row | {"scene": row["scene"].removeprefix("thesis-")} for row in errors],
            ERROR_COLUMNS,
            "Relative MSE of the thesis' scenes after "
            f"{format_budget(errors[0]['budget'])}, mean over seeds ({run['seeds']})",
            "Ratios are of error x seconds; above 1 the second is better. Reference: LightTree "
            f"alone, {run['reference_seconds']:g} s;\nits noise is part of every error. "
            f"The thesis' tree uses {thesis_tree.width} of the {NUM_LANES} lanes of a node, so "
            "samples take it longer than\nthey need; results.csv counts them, and --samples "
            "compares at equal ones.",
        ),
        _draw(
            builds,
            {name: name for name in builds[0]},
            f"Seconds to build a tree over the lights of {BUILD_SCENE}",
            "The quoted builds are another program's, on another machine; "
            f"thesis' options: width {thesis_tree.width},\n"
            f"buckets of equal {thesis_tree.bucket_kind}, no factor for thin boxes.",
        ),
    ]


def collect_errors(folder: Path, progress: Progress | None = None) -> list[dict]:
    """One row a scene: the errors of the methods at the longest budget, and their ratios."""
    run = metrics.read_run(folder)
    budget = metrics.budget_label({run["budget_kind"]: max(run["budgets"])})
    measured = [
        row
        for row in metrics.collect_results(folder, progress)[0]
        if row["budget"] == budget and row["rel_mse"] > 0
    ]
    table = []
    for scene in run["scenes"]:
        rows = group_by((row for row in measured if row["scene"] == scene["name"]), "method")
        entry = {"scene": scene["name"], "lights": sum(scene["lights"].values()), "budget": budget}
        for method in DEFAULTS["methods"]:
            errors = [row["rel_mse"] for row in rows.get(method, [])]
            entry[method] = np.mean(errors) if errors else math.nan
        for name, (worse, better) in RATIOS.items():
            is_known = worse in rows and better in rows
            entry[name] = (
                compare_costs([(rows[better], rows[worse])]).mean if is_known else math.nan
            )
        entry["reference_noise"] = _reference_noise(folder / scene["name"])
        table.append(entry)
    return table


def _reference_noise(folder: Path) -> float:
    """The relative MSE that the noise of LightTree's reference causes by itself."""
    path = folder / f"reference-{TREE}.exr"
    try:
        return metrics.noise_floor(
            metrics.read_rgb(path)[0], metrics.read_rgb(path, "variance.")[0]
        )
    except ImageError:
        return math.nan


def load_bounds(folder: Path, num_lights: int, progress: Progress) -> LightBounds:
    """The lights of the scene that builds are timed on, about so many; leaves files behind."""
    blend, scene = folder / "lights.blend", folder / "lights.npz"
    single.build_blend(BUILD_SCENE, blend, num_lights, 0, progress)
    single.export_blend(blend, scene, progress)
    return bound_lights(build_lights(Scene.load(scene))[0])


def time_builds(bounds: LightBounds, threads: int, machine: str, progress: Progress) -> list[dict]:
    """One row a build: of the tree as shipped, of the thesis' kinds of tree, and as it quotes."""
    ours = tree_options(METHODS[THESIS].overrides)
    trees = [("as shipped", TreeOptions())]
    trees += [("thesis' options", replace(ours, split=split)) for split in (MIDDLE, EQUAL)]
    trees += [
        ("thesis' options", replace(ours, split=split, buckets=buckets))
        for buckets in QUOTED_SECONDS
        for split in (SAH, SAOH)
    ]
    compile_kernels(progress)
    rows = []
    for i, (name, options) in enumerate(trees):
        progress(i / len(trees), f"Timing a build by {options.split}")
        start = time.perf_counter()
        build_tree(bounds, options, threads)
        seconds = time.perf_counter() - start
        row = {"tree": name, "split": options.split, "buckets": _buckets(options)}
        row |= {"lights": len(bounds.flux), "seconds": seconds, "threads": threads}
        rows.append(row | {"machine": machine})
    for buckets, seconds in QUOTED_SECONDS.items():
        quoted = {"buckets": _buckets(TreeOptions(buckets=buckets)), "seconds": seconds}
        rows.append(QUOTED | quoted)
    return rows


def _buckets(options: TreeOptions) -> str:
    """How many cuts a split chooses from, as text."""
    if options.split in (MIDDLE, EQUAL):
        return "one cut"
    return f"{options.buckets}" if options.buckets else "all cuts"


def _draw(rows: Sequence[dict], columns: dict[str, str], title: str, caption: str) -> Table:
    """A table to print; texts to the left, numbers to the right."""
    table = Table(
        *(
            Column(
                heading, justify="left" if isinstance(rows[0][key], str) else "right", no_wrap=True
            )
            for key, heading in columns.items()
        ),
        title=title,
        caption=caption,
        box=SIMPLE_HEAD,
        pad_edge=False,
        title_justify="left",
        caption_justify="left",
    )
    for row in rows:
        table.add_row(*(_cell(row[key]) for key in columns))
    return table


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return value
    if value != value:  # NaN: unknown
        return ""
    return f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
