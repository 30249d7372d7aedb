"""Errors of images against a reference, and the rows of results.csv; the only place for both.

Images are (H, W, 3) linear Rec. 709, top row first. Every relative error here divides by
reference^2 + eps with eps = EPS_SHARE * (mean luminance of the reference)^2, so an error
does not change when scene and exposure are scaled, and black pixels do not explode.
A result folder holds run.json, SCENE/reference*.exr and SCENE/METHOD-8s-seed1.exr.
"""

import csv
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .images import ImageError, read_exr, replacing

try:
    import flip_evaluator
except ImportError:  # it is not made for every Python that a Blender may have
    flip_evaluator = None

EPS_SHARE = 1e-2
TRIM_PERCENT = 0.1
TILE_PX = 16
# Differences below this share of a tile's brightness are rounding: skies and lamps have no noise,
# and Cycles' own fast trigonometry is off by more where mesh lights are near.
ROUNDING = 1e-4
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
HEADER_COLUMNS = ["scene", "method", "seed", "samples", "seconds_render", "seconds_setup"]
ERROR_COLUMNS = ["rel_mse", "rel_mse_trimmed", "mse", "mean_abs", "flip", "p50", "p90", "p99"]
# New ones come last: others read these tables by position.
COLUMNS = [*HEADER_COLUMNS, *ERROR_COLUMNS, "mean_ratio", "peak_mib", "budget", "cpu"]
COLUMNS += ["seconds_compile"]


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Rec. 709 luminance, float64."""
    return rgb @ LUMINANCE


def squared_scale(reference: np.ndarray) -> np.ndarray:
    """reference^2 + eps, what squared errors are divided by."""
    eps = EPS_SHARE * luminance(reference).mean() ** 2
    return np.square(reference, dtype=np.float64) + max(eps, np.finfo(np.float64).tiny)


def relative_error(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(H, W) relative error of each pixel: root mean square over its three channels."""
    error_sq = np.square(image.astype(np.float64) - reference) / squared_scale(reference)
    return np.sqrt(error_sq.mean(axis=2))


def flip(image: np.ndarray, reference: np.ndarray) -> tuple[float, np.ndarray]:
    """HDR-FLIP (Andersson et al. 2021): its mean and its (H, W) map, 0 same to 1 most different.

    The exposures follow FLIP's own rule, except that its median is over lit pixels only: where
    most of a night is black, FLIP would compare at exposures of +20 stops, and where all of it
    is, end the process. Without flip-evaluator all is NaN.
    """
    if flip_evaluator is None:
        return np.nan, np.full(image.shape[:2], np.nan)
    lit = luminance(reference)
    lit = lit[lit > 1e-6 * lit.max()]
    white = 2.118915  # the radiance that FLIP's ACES curve maps to 0.85
    start, stop = np.log2(white / np.array([lit.max(), np.median(lit)])) if lit.size else (0, 0)
    exposures = {"startExposure": float(start), "stopExposure": float(max(stop, start + 1e-3))}
    error, mean, _ = flip_evaluator.evaluate(
        np.maximum(reference, 0, dtype=np.float32),
        np.maximum(image, 0, dtype=np.float32),
        "HDR",
        applyMagma=False,
        parameters=exposures,
    )
    return mean, error[..., 0]


def measure(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """All errors of one image, under their names in results.csv."""
    relative = relative_error(image, reference)
    difference = image.astype(np.float64) - reference
    squares = np.sort(np.square(relative), axis=None)
    num_kept = int(len(squares) * (1 - TRIM_PERCENT / 100))
    p50, p90, p99 = np.percentile(relative, [50, 90, 99])
    return {
        "rel_mse": squares.mean(),
        "rel_mse_trimmed": squares[:num_kept].mean(),
        "mse": np.square(difference).mean(),
        "mean_abs": np.abs(difference).mean(),
        "flip": flip(image, reference)[0],
        "p50": p50,
        "p90": p90,
        "p99": p99,
        "mean_ratio": mean_ratio(image, reference),
    }


def mean_ratio(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean luminance of the image over that of the reference; NaN over black."""
    mean = luminance(reference).mean()
    return luminance(image).mean() / mean if mean else np.nan


def efficiency(rel_mse: float, seconds_render: float) -> float:
    """1 / (rel_mse * seconds): twice as much needs half the time for the same error."""
    return 1 / (rel_mse * seconds_render) if rel_mse * seconds_render else np.nan


def noise_floor(reference: np.ndarray, variance: np.ndarray) -> float:
    """The rel_mse that noise of the reference alone causes; variance: (H, W, 3), of the mean."""
    return (variance / squared_scale(reference)).mean()


class ModelCheck(NamedTuple):
    """Where two references differ beyond their noise; a is compared with b."""

    tile_z: np.ndarray  # difference of tile means in standard errors, positive where a is brighter
    share_within_3: float  # of the tiles; 0.997 when only noise tells a from b
    mean_ratio: float  # mean luminance of a over that of b
    mean_ratio_sigma: float
    difference_sq: float  # about the rel_mse between a and b without noise; may fall below 0
    difference_sq_sigma: float


def compare_models(
    a: np.ndarray, variance_a: np.ndarray, b: np.ndarray, variance_b: np.ndarray
) -> ModelCheck:
    """Tell a difference of two converged images from their noise, in tiles of 16 x 16 pixels.

    The channels' noise counts as fully correlated (one path carries all three), which rather
    over- than understates the noise of luminance.
    """
    mean_a, mean_b = luminance(a).mean(), luminance(b).mean()
    noise_a, noise_b = (np.square(luminance(np.sqrt(v))) for v in (variance_a, variance_b))
    difference = tile_sums(luminance(a) - luminance(b))
    rounding = ROUNDING * tile_sums(luminance(a) + luminance(b)) / 2
    noise = tile_sums(noise_a + noise_b) + rounding**2
    with np.errstate(divide="ignore", invalid="ignore"):
        tile_z = np.where(difference == 0, 0.0, difference / np.sqrt(noise))
        relative_sq = noise_a.sum() / mean_a**2 + noise_b.sum() / mean_b**2
        ratio = mean_a / mean_b
    # Tile by tile, for a pixel's own scale is small just where its noise is underestimated.
    error_sq = np.square(a.astype(np.float64) - b) - variance_a - variance_b
    error_sq = tile_sums(error_sq.sum(axis=2)) / tile_sums(squared_scale((a + b) / 2).sum(axis=2))
    return ModelCheck(
        tile_z,
        (np.abs(tile_z) <= 3).mean(),
        ratio,
        ratio * np.sqrt(relative_sq) / noise_a.size,
        error_sq.mean(),
        error_sq.std() / np.sqrt(error_sq.size),
    )


def tile_sums(pixels: np.ndarray) -> np.ndarray:
    """Sums over tiles of TILE_PX squared; the last row and column may be cut by the border."""
    rows, columns = (range(0, size, TILE_PX) for size in pixels.shape)
    return np.add.reduceat(np.add.reduceat(pixels, rows, axis=0), columns, axis=1)


def read_run(folder: Path) -> dict:
    """run.json of a result folder."""
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ImageError(f"{folder}: no run.json; `lighttree compare` writes it.") from error
    except ValueError as error:
        raise ImageError(f"{folder / 'run.json'}: damaged ({error}).") from error
    if run.get("format") != 1:
        raise ImageError(f"{folder / 'run.json'}: expected format 1, found {run.get('format')}.")
    for name in (scene["name"] for scene in run["scenes"]):
        if Path(name).name != name or name in ("", ".."):  # the report writes into these folders
            raise ImageError(f"{folder / 'run.json'}: '{name}' is no name of a folder in there.")
    return run


def read_rgb(path: Path, prefix: str = "") -> tuple[np.ndarray, dict]:
    """(H, W, 3) of the channels PREFIX + R, G, B, and the header; refuses NaN and infinity."""
    channels, header = read_exr(path)
    try:
        rgb = np.stack([channels[prefix + name] for name in "RGB"], axis=-1)
    except KeyError as error:
        raise ImageError(f"{path}: no channel {error}.") from error
    if num_bad := np.count_nonzero(~np.isfinite(rgb).all(axis=2)):
        raise ImageError(f"{path}: {num_bad} pixels are NaN or infinite.")
    return rgb, header


def budget_label(budget: dict) -> str:
    """'8s' or '64spp', as in file names."""
    return f"{budget['seconds']:g}s" if "seconds" in budget else f"{budget['samples']}spp"


def build_row(path: Path, reference: np.ndarray | None, run: dict) -> dict:
    """One row of results.csv, and the image's header; without a reference errors are NaN."""
    image, header = read_rgb(path)
    if reference is not None and image.shape != reference.shape:
        raise ImageError(f"{path}: is {image.shape}, the reference {reference.shape}.")
    # By samples, renders may have shared the threads: that changes their time, not their errors.
    alike = ("resolution", "bounces")
    alike += ("threads",) if "seconds" in header.get("budget", {}) else ()
    for name in alike:
        if header.get(name, run[name]) != run[name]:
            raise ImageError(f"{path}: {name} {header[name]}, not {run[name]} as in run.json.")
    try:
        row = {name: header[name] for name in [*HEADER_COLUMNS, "peak_mib"]}
        row["budget"] = budget_label(header["budget"])
        row["cpu"] = header.get("machine", run["machine"])["cpu"]
        row["seconds_compile"] = header.get("seconds_compile")  # not in those of earlier versions
    except KeyError as error:
        raise ImageError(f"{path}: its header has no {error}.") from error
    known = {name: value for name, value in row.items() if value is not None}
    errors = measure(image, reference) if reference is not None else {}
    return dict.fromkeys(COLUMNS, np.nan) | known | errors | {"header": header}


def collect_results(
    folder: Path, progress: Callable[[float, str], None] | None = None
) -> tuple[list[dict], list[str]]:
    """Measure every render in a result folder: rows, and a sentence for whatever is missing."""
    run, rows, problems = read_run(folder), [], []
    budgets = [budget_label({run["budget_kind"]: budget}) for budget in run["budgets"]]
    names = [
        f"{method}-{budget}-seed{seed}"
        for method in run["methods"]
        for budget in budgets
        for seed in range(1, run["seeds"] + 1)
    ]
    for scene_id, scene in enumerate(run["scenes"]):
        reference, of_scene = None, []
        try:
            reference, _ = read_rgb(folder / scene["name"] / "reference.exr")
        except ImageError as error:
            problems.append(f"{error} {scene['name']} therefore has no errors.")
        # Renders that run.json does not name come from an earlier run into the same folder.
        found = {path.stem for path in (folder / scene["name"]).glob("*-seed*.exr")}
        for name_id, name in enumerate(names):
            if progress:
                done = (scene_id + name_id / len(names)) / len(run["scenes"])
                progress(done, f"Measuring {scene['name']} {name}")
            if name in found:
                try:
                    path = folder / scene["name"] / f"{name}.exr"
                    of_scene.append(build_row(path, reference, run))
                except ImageError as error:
                    problems.append(str(error))
        alike, sentences = leave_out_unlike(of_scene)
        rows += alike
        problems += sentences
        if missing := [name for name in names if name not in found]:
            share = f"{len(missing)} of {len(names)} renders"
            problems.append(f"{scene['name']}: {share} are missing: {', '.join(missing)}.")
        if extra := sorted(found - set(names)):
            problems.append(f"{scene['name']}: not in run.json, so left out: {', '.join(extra)}.")
    return rows, [problem.replace(f"{folder}{os.sep}", "") for problem in problems]


def leave_out_unlike(rows: list[dict]) -> tuple[list[dict], list[str]]:
    """The rows of a scene that one CPU made, the one that made most; a sentence for each other.

    Seconds of unlike machines must never meet in a mean or a ratio.
    """
    counts = Counter(row["cpu"] for row in rows).most_common()
    sentences = [
        f"{rows[0]['scene']}: {number} renders by another machine ({cpu}; the others are by "
        f"{counts[0][0]}), so left out."
        for cpu, number in counts[1:]
    ]
    return [row for row in rows if row["cpu"] == counts[0][0]], sentences


def write_results(folder: str | Path, rows: list[dict]) -> Path:
    """Write results.csv."""
    lines = [{name: row[name] for name in COLUMNS} for row in rows]
    return write_rows(Path(folder) / "results.csv", COLUMNS, lines)


def write_rows(path: Path, columns: Iterable[str], rows: list[dict]) -> Path:
    """Write a CSV file; an unknown number is an empty cell."""
    with replacing(path) as temp, temp.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        for row in rows:
            writer.writerow({k: "" if v != v else v for k, v in row.items()})  # v != v: NaN
    return path
