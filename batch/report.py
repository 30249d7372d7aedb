"""Turn a result folder into results.csv and one HTML page that needs no network; never renders.

Errors come from metrics.py alone; here they are averaged over seeds and scenes and handed to
templates/report.html with the pictures of figures.py. At equal time, the error ratio of two
methods is the ratio of their costs, cost = rel_mse * seconds_render.
"""

import contextlib
import math
import os
from collections.abc import Callable, Iterable
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

import jinja2
import numpy as np
from markupsafe import Markup

from . import figures, metrics
from .images import ImageError, replacing
from .methods import CYCLES, METHODS

TEMPLATES = Path(__file__).parent / "templates"
Rows = list[dict]
TABLE_COLUMNS = [*metrics.HEADER_COLUMNS[3:], *metrics.ERROR_COLUMNS, "mean_ratio", "peak_mib"]


class Spread(NamedTuple):
    """A mean over seeds, and the smallest and largest of them."""

    mean: float
    low: float
    high: float


def write_report(folder: str | Path, progress: Callable[[float, str], None] | None = None) -> Path:
    """Write results.csv and report.html into a result folder; returns the path of the page.

    progress is called with the fraction done and a text.
    """
    folder = Path(folder)
    run = metrics.read_run(folder)
    rows, problems = metrics.collect_results(folder, progress)
    metrics.write_results(folder, rows)
    if metrics.flip_evaluator is None:
        problems.append("FLIP, which needs the package flip-evaluator.")
    scenes = []
    for scene in run["scenes"]:
        if progress:
            progress(1.0, f"Drawing {scene['name']}")
        of_scene = [row for row in rows if row["scene"] == scene["name"]]
        scenes.append(describe_scene(folder / scene["name"], run, scene, of_scene))
    viewer, viewer_license = load_viewer()
    page = load_template().render(
        run=run,
        scenes=scenes,
        problems=problems,
        headline=compare_engines([scene["pair"] for scene in scenes if scene["pair"]]),
        rival=find_rival([scene["comparable"] for scene in scenes if scene["pair"]]),
        styles=figures.STYLES,
        descriptions={name: method.description for name, method in METHODS.items()},
        figures=figures,
        metrics=metrics,
        headers={name: header for scene in scenes for name, header in scene["headers"].items()},
        viewer=Markup(f"<script>{viewer}</script>"),
        viewer_license=viewer_license,
    )
    path = folder / "report.html"
    with replacing(path) as temp:
        temp.write_text(page, encoding="utf-8")
    return path


def load_viewer() -> tuple[str, str]:
    """SimpleImageIO's flip viewer and its licence.

    Inside Blender both are files of ours: its package has to be compiled, so Blender lacks it.
    """
    if (script := TEMPLATES / "flipbook.js").exists():
        licence = script.with_suffix(".LICENSE")
        return script.read_text(encoding="utf-8"), licence.read_text(encoding="utf-8")
    package = distribution("simpleimageio")
    script = Path(package.locate_file("simpleimageio/flipbook.js"))
    return script.read_text(encoding="utf-8"), package.read_text("licenses/LICENSE")


def load_template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {
        "number": format_number,
        "budget": format_budget,
        "comparative": format_comparative,
        "comparative_range": format_comparative_range,
    }
    return environment.get_template("report.html")


def describe_scene(folder: Path, run: dict, scene: dict, rows: Rows) -> dict:
    """Everything the page shows of one scene."""
    measured = [row for row in rows if row["rel_mse"] > 0 and row["seconds_render"] > 0]
    budget = pick_budget(run, measured or rows)
    equal = group_by_method(row for row in rows if row["budget"] == budget)
    comparable = group_by_method(row for row in measured if row["budget"] == budget)
    pair = None
    if "lighttree" in comparable and "cycles" in comparable:
        pair = comparable["lighttree"], comparable["cycles"]
    plots = []
    for x, *label in (("seconds_render", "time", "seconds"), ("samples", "samples", "per pixel")):
        if curves := group_by_method(row for row in measured if row[x] > 0):
            plots.append(figures.draw_plot(curves, x, *label))
    return {
        **scene,
        "budget": budget,
        "pair": pair,
        "comparable": comparable,
        "compared": compare_engines([pair] if pair else []),
        "table": build_table(comparable),
        "plots": plots,
        **describe_models(folder, min((row["rel_mse"] for row in measured), default=None)),
        **describe_pictures(folder, equal),
    }


def group_by_method(rows: Iterable[dict]) -> dict[str, Rows]:
    groups: dict[str, Rows] = {}
    for row in rows:
        groups.setdefault(row["method"], []).append(row)
    return groups


def pick_budget(run: dict, rows: Rows) -> str | None:
    """The largest budget both engines have rows for, or else any method has."""
    engines = [{r["budget"] for r in rows if r["method"] == m} for m in ("lighttree", "cycles")]
    usable = set.intersection(*engines) or {row["budget"] for row in rows}
    for budget in sorted(run["budgets"], reverse=True):
        if (label := metrics.budget_label({run["budget_kind"]: budget})) in usable:
            return label
    return None


def spread(values: list[float]) -> Spread:
    return Spread(float(np.mean(values)), min(values), max(values))


def compare_costs(pairs: list[tuple[Rows, Rows]], error="rel_mse", setup=False) -> Spread:
    """How many times lower the error of the first of each pair is at equal time.

    One pair a scene; the mean is the geometric mean over scenes of the ratio of mean costs,
    low and high are over single seeds.
    """

    def costs(rows: Rows) -> dict[int, float]:
        return {
            row["seed"]: row[error] * (row["seconds_render"] + setup * row["seconds_setup"])
            for row in rows
        }

    scenes = [(costs(ours), costs(theirs)) for ours, theirs in pairs]
    mean = geometric_mean(np.mean([*b.values()]) / np.mean([*a.values()]) for a, b in scenes)
    seeds = set.intersection(*(set(costs) for scene in scenes for costs in scene))
    by_seed = [geometric_mean(b[seed] / a[seed] for a, b in scenes) for seed in seeds]
    return Spread(mean, min(by_seed, default=mean), max(by_seed, default=mean))


def geometric_mean(values: Iterable[float]) -> float:
    return math.exp(np.mean([math.log(value) for value in values]))


def compare_engines(pairs: list[tuple[Rows, Rows]]) -> dict | None:
    """LightTree against Cycles over some scenes: the numbers of the headline."""
    if not pairs:
        return None
    return {
        "ratio": compare_costs(pairs),
        "trimmed": compare_costs(pairs, error="rel_mse_trimmed"),
        "with_setup": compare_costs(pairs, setup=True),
        "budgets": sorted({ours[0]["budget"] for ours, _ in pairs}, key=lambda b: (len(b), b)),
        "num_scenes": len(pairs),
        "num_seeds": min(len(rows) for pair in pairs for rows in pair),
    }


def find_rival(scenes: list[dict[str, Rows]]) -> dict | None:
    """The control row of Cycles that comes closest to LightTree, if it beats Cycles as it comes.

    scenes: rows by method; a control row counts if every scene has it.
    """
    if not scenes:
        return None
    controls = set.intersection(*(set(rows) for rows in scenes)) & set(METHODS)
    ratios = {
        method: compare_costs([(rows["lighttree"], rows[method]) for rows in scenes])
        for method in sorted(controls)
        if METHODS[method].engine == CYCLES
    }
    method = min(ratios, key=lambda name: ratios[name].mean)
    return {"method": method, "ratio": ratios[method]} if method != "cycles" else None


def build_table(comparable: dict[str, Rows]) -> list[dict]:
    """One entry a method at the equal budget, most efficient first; every number is a Spread."""
    table = []
    for method, rows in comparable.items():
        entry = {name: spread([row[name] for row in rows]) for name in TABLE_COLUMNS}
        per_seed = spread([metrics.efficiency(r["rel_mse"], r["seconds_render"]) for r in rows])
        # Mean cost, not mean efficiency: a lucky seed must not count for more than an unlucky one.
        mean_cost = np.mean([row["rel_mse"] * row["seconds_render"] for row in rows])
        base = comparable.get("cycles")
        entry |= {
            "method": method,
            "efficiency": per_seed._replace(mean=1 / mean_cost),
            "speed_up": compare_costs([(rows, base)]) if base else None,
        }
        table.append(entry)
    return sorted(table, key=lambda entry: -entry["efficiency"].mean)


def describe_models(folder: Path, smallest_error: float | None) -> dict:
    """The model-difference check, and the floors that errors against this reference have."""
    try:
        reference, header = metrics.read_rgb(folder / "reference.exr")
        if (weight := header.get("weight_lighttree")) is None:
            raise ImageError("reference.exr: its header has no 'weight_lighttree'.")
        paths = [folder / f"reference-{engine}.exr" for engine in ("lighttree", "cycles")]
        a, b = (metrics.read_rgb(path)[0] for path in paths)
        variance_a, variance_b = (metrics.read_rgb(path, "variance.")[0] for path in paths)
    except ImageError as error:
        reason = str(error).replace(f"{folder}{os.sep}", "")
        return {"models": None, "models_missing": reason, "is_limited": False}
    check = metrics.compare_models(a, variance_a, b, variance_b)
    num_tiles_out = int((np.abs(check.tile_z) > 3).sum())
    is_real = check.difference_sq > 3 * check.difference_sq_sigma
    bias_sq = check.difference_sq if is_real else 0.0
    model_floors = {"LightTree": (1 - weight) ** 2 * bias_sq, "Cycles": weight**2 * bias_sq}
    variance = weight**2 * variance_a + (1 - weight) ** 2 * variance_b
    noise_floor = metrics.noise_floor(reference, variance)
    return {
        "models": check,
        "num_tiles_out": num_tiles_out,
        # Chance puts 0.3 % of the tiles outside, and one of a few is no proof.
        "models_agree": num_tiles_out <= math.ceil(0.01 * check.tile_z.size)
        and abs(check.mean_ratio - 1) <= 3 * check.mean_ratio_sigma
        and not is_real,
        "tile_map": figures.draw_tile_map(check.tile_z),
        "weight_lighttree": weight,
        "noise_floor": noise_floor,
        "model_floors": model_floors,
        "smallest_error": smallest_error,
        "is_limited": bool(smallest_error)
        and smallest_error < 10 * (noise_floor + max(model_floors.values())),
    }


def describe_pictures(folder: Path, equal: dict[str, Rows]) -> dict:
    """Pictures of the reference and of each method's first seed, and the HDR viewer's data."""
    files = {"reference": "reference.exr"}
    for method, rows in equal.items():
        files[method] = f"{method}-{rows[0]['budget']}-seed{rows[0]['seed']}.exr"
    images, headers = {}, {}
    for name, file in files.items():
        with contextlib.suppress(ImageError):  # a reference that collect_results has reported
            images[name], headers[name] = metrics.read_rgb(folder / file)
    if not images:
        return {"pictures": [], "viewer": None, "headers": {}}
    reference = images.get("reference")
    first = next(iter(images.values()))
    exposure_ev = figures.pick_exposure_ev(first)
    pictures = []
    for name, image in images.items():
        picture = {"name": name, "image": figures.draw_image(image, exposure_ev)}
        picture["row"] = equal[name][0] if name in equal else None
        picture["num_dropped"] = headers[name].get("dropped_samples", 0)
        if reference is not None and name != "reference":
            error = metrics.relative_error(image, reference)
            picture["error_map"] = figures.draw_error_map(error)
            if metrics.flip_evaluator:
                picture["flip_map"] = figures.draw_flip_map(metrics.flip(image, reference)[1])
        pictures.append(picture)
    viewer = {
        "names": list(images),
        "dataUrls": [figures.encode_rgbe(image) for image in images.values()],
        "types": ["rgbe"] * len(images),
        "width": first.shape[1],
        "height": first.shape[0],
        "initialZoom": -1,  # fit
        "initialTMO": {"activeTMO": "exposure", "exposure": exposure_ev},
        "colorTheme": "light",
    }
    return {"pictures": pictures, "viewer": viewer, "headers": headers, "exposure_ev": exposure_ev}


def format_number(value: float | None, decimals: int | None = None) -> str | Markup:
    """Three digits, 0.0435, 17.3, 1,240 or 1.20 x 10^-5; counts whole; a dash if unknown."""
    if value is None or not math.isfinite(value):
        return Markup("&ndash;")
    if isinstance(value, int):
        decimals = 0
    if decimals is None and 1 < abs(value) < 1e6:
        decimals = max(0, 2 - int(math.log10(abs(value))))
    if decimals is not None:
        return f"{value:,.{decimals}f}"
    if value == 0 or 1e-3 <= abs(value) <= 1:
        return f"{value:#.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return Markup("{}&nbsp;&times;&nbsp;10<sup>{}</sup>").format(mantissa, int(exponent))


def format_budget(label: str) -> str:
    """'8 s' for '8s', '64 samples per pixel' for '64spp'."""
    number, unit = label.rstrip("sp"), label.lstrip("0123456789.")
    return f"{number} {'s' if unit == 's' else 'samples per pixel'}"


def format_comparative(ratio: float) -> str:
    """'3.10 times lower' for 3.1, '2.00 times higher' for 0.5."""
    if not math.isfinite(ratio):
        return "unknown"
    return f"{format_number(max(ratio, 1 / ratio))} times {'lower' if ratio >= 1 else 'higher'}"


def format_comparative_range(ratio: Spread) -> str:
    """'2.00 to 4.00 times lower'; both words where the seeds do not agree on who is ahead."""
    if (ratio.low >= 1) != (ratio.high >= 1):
        return f"{format_comparative(ratio.low)} to {format_comparative(ratio.high)}"
    nearer, farther = sorted(ratio[1:], key=lambda r: max(r, 1 / r))
    return f"{format_number(max(nearer, 1 / nearer))} to {format_comparative(farther)}"
