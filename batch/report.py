"""Turn a result folder into results.csv and HTML pages that need no network; never renders.

Errors come from metrics.py alone, equal_time.py compares them; here they are handed to
templates/report.html with the pictures of figures.py and the plots of plots.py. One page holds all
of it, unless that would be slow to open: then every scene has a page of its own.
"""

import contextlib
import csv
import math
import os
from base64 import b64encode
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from importlib.metadata import distribution
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from . import equal_time, figures, metrics, plots, wording
from .equal_time import Rows, compare_budgets, compare_engines, find_rival, group_by
from .history import record
from .images import ImageError, replacing
from .methods import METHODS

TEMPLATES = Path(__file__).parent / "templates"
# What a page may weigh: 40 MiB open in about a second and a half on two cores.
PAGE_MIB, SCENE_MIB = 40, 60  # of several scenes, of one
# In base64: four bytes a pixel for the viewer; the JPEGs of an image and of its two error maps.
HDR_BYTES, JPEG_BYTES = 16 / 3, 5
PROBE_COLUMNS = ("choose_ns", "rel_variance_median", "variance_ns_median", "variance_ns_mean")
Progress = Callable[[float, str], None]


def write_report(folder: str | Path, progress: Progress | None = None) -> Path:
    """Write results.csv, results.sqlite and report.html; returns the path of the page.

    progress is called with the fraction done and a text.
    """
    folder = Path(folder)
    run = metrics.read_run(folder)
    rows, problems = metrics.collect_results(folder, progress)
    metrics.write_results(folder, rows)
    record(folder, run, rows)
    if metrics.flip_evaluator is None:
        problems.append("FLIP, which needs the package flip-evaluator.")
    scenes = []
    for number, scene in enumerate(run["scenes"], 1):
        of_scene = [row for row in rows if row["scene"] == scene["name"]]
        facts = describe_scene(folder / scene["name"], run, scene, of_scene)
        scenes.append(facts | {"number": number})
    sizes = [expected_mib(run["resolution"], len(scene["equal"]) + 1) for scene in scenes]
    is_split = len(scenes) > 1 and sum(sizes) > PAGE_MIB
    compared = [scene for scene in scenes if scene["pair"]]
    render = partial(
        load_template().render,
        run=run,
        scenes=scenes,
        problems=problems,
        headline=compare_engines([scene["pair"] for scene in compared]),
        rival=find_rival([scene["comparable"] for scene in compared]),
        by_budget=[row | {"scene": scene} for scene in scenes for row in scene["by_budget"]],
        is_split=is_split,
        **load_scripts(),
    )
    shown, headers = [], {}
    for scene, mib in zip(scenes, sizes, strict=True):
        if progress:
            progress(1.0, f"Drawing {scene['name']}")
        # A scene too large for a page by itself gives its viewer every n-th pixel.
        step = math.ceil(math.sqrt(max(mib / SCENE_MIB, 1)))
        pictures = draw_pictures(folder / scene["name"], scene["equal"], step)
        headers |= pictures.pop("headers")
        own_page = folder / scene["name"] / "report.html"
        if is_split:
            own_page.parent.mkdir(exist_ok=True)
            write_page(own_page, render(shown=[scene | pictures], home="../report.html"))
        else:
            own_page.unlink(missing_ok=True)
            shown.append(scene | pictures)
    path = folder / "report.html"
    write_page(path, render(shown=shown, home="", headers=headers))
    return path


def expected_mib(resolution: tuple[int, int], num_pictures: int) -> float:
    """About what these pictures weigh in a page."""
    width, height = resolution
    jpeg_share = min(1, figures.PICTURE_PX / width) ** 2
    return num_pictures * width * height * (HDR_BYTES + JPEG_BYTES * jpeg_share) / 2**20


def write_page(path: Path, page: str) -> None:
    with replacing(path) as temp:
        temp.write_text(page, encoding="utf-8")


def load_scripts() -> dict:
    """The page's scripts, the flip viewer's licence, and the policy that lets nothing else run."""
    viewer, viewer_license = load_viewer()
    sources = {"viewer": viewer}
    for name in ("report", "flip"):
        sources[name] = (TEMPLATES / f"{name}.js").read_text(encoding="utf-8")
    hashes = [b64encode(sha256(text.encode()).digest()).decode() for text in sources.values()]
    scripts = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return {
        "scripts": {name: Markup(f"<script>{text}</script>") for name, text in sources.items()},
        "viewer_license": viewer_license,
        # data: and blob: are parts of the page itself; the viewer fetches its images from there.
        "policy": f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; "
        "img-src data: blob:; connect-src data:; base-uri 'none'; form-action 'none'",
    }


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
        "number": wording.format_number,
        "budget": wording.format_budget,
        "comparative": wording.format_comparative,
        "comparative_range": wording.format_comparative_range,
    }
    descriptions = {name: method.description for name, method in METHODS.items()}
    environment.globals |= {"descriptions": descriptions, "figures": figures, "plots": plots}
    environment.globals |= {"metrics": metrics}
    return environment.get_template("report.html")


def describe_scene(folder: Path, run: dict, scene: dict, rows: Rows) -> dict:
    """Everything the pages tell of one scene, but its large pictures."""
    measured = [row for row in rows if row["rel_mse"] > 0 and row["seconds_render"] > 0]
    budget = pick_budget(run, measured or rows)
    equal = group_by((row for row in rows if row["budget"] == budget), "method")
    comparable = group_by((row for row in measured if row["budget"] == budget), "method")
    pair = None
    if "lighttree" in comparable and "cycles" in comparable:
        pair = comparable["lighttree"], comparable["cycles"]
    curves = {name: plots.summarize(of) for name, of in group_by(measured, "method").items()}
    table = equal_time.build_table(comparable)
    return {
        **scene,
        "stem": Path(scene["file"]).stem,
        "budget": budget,
        "cpu": rows[0]["cpu"] if rows else run["machine"]["cpu"],
        "equal": equal,
        "pair": pair,
        "comparable": comparable,
        "compared": compare_engines([pair] if pair else []),
        "by_budget": compare_budgets(measured),
        "table": table,
        "percentiles": plots.place_percentiles(table),
        "curves": curves,
        "plots": {x: plots.plot_errors(curves, x) for x in ("seconds_render", "samples")},
        "thumbnail": draw_thumbnail(folder / "reference.exr"),
        "probe": read_probe(folder),
        **describe_models(folder, min((row["rel_mse"] for row in measured), default=None)),
    }


def pick_budget(run: dict, rows: Rows) -> str | None:
    """The largest budget both engines have rows for, or else any method has."""
    engines = [{r["budget"] for r in rows if r["method"] == m} for m in ("lighttree", "cycles")]
    usable = set.intersection(*engines) or {row["budget"] for row in rows}
    for budget in sorted(run["budgets"], reverse=True):
        if (label := metrics.budget_label({run["budget_kind"]: budget})) in usable:
            return label
    return None


def draw_thumbnail(path: Path) -> str | None:
    """A small picture of a reference, if there is one; collect_results has told if there is not."""
    try:
        return figures.draw_thumbnail(metrics.read_rgb(path)[0])
    except ImageError:
        return None


def read_probe(folder: Path) -> dict | None:
    """The rows and the plot of `lighttree probe`, if it wrote them there."""
    try:
        plot = b64encode((folder / "probe.png").read_bytes()).decode()
        with open(folder / "probe.csv", newline="", encoding="utf-8") as file:
            rows = [
                row | {name: float(row[name] or "nan") for name in PROBE_COLUMNS}
                for row in csv.DictReader(file)
            ]
        return {"rows": rows, "num_points": int(rows[0]["points"]), "plot": plot}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ImageError(f"{folder / 'probe.csv'}: damaged ({error}); remove it.") from error


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


def draw_pictures(folder: Path, equal: dict[str, Rows], step: int) -> dict:
    """Pictures of the reference and of each method's first seed, and the HDR viewer's data.

    step: the viewer gets every step-th pixel of every step-th row.
    """
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
    small = {name: image[::step, ::step] for name, image in images.items()}
    viewer = {
        "names": list(small),
        "dataUrls": [figures.encode_rgbe(image) for image in small.values()],
        "types": ["rgbe"] * len(images),
        "width": -(-first.shape[1] // step),
        "height": -(-first.shape[0] // step),
        "initialZoom": -1,  # fit
        "initialTMO": {"activeTMO": "exposure", "exposure": exposure_ev},
        "colorTheme": "light",
    }
    return {
        "pictures": pictures,
        "viewer": viewer,
        "viewer_step": step,
        "headers": headers,
        "exposure_ev": exposure_ev,
    }
