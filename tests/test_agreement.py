"""Every feature, and whole cities, rendered by both engines: the same picture.

The quick test renders each row of `agreement_rows.py` small and noisy, and compares the brightness
of the whole image. The slow ones render to low noise and compare tile by tile. What they find is
kept in agreement.md, which this writes anew, in two hours, or some of its lines:

    python tests/test_agreement.py --write
    python tests/test_agreement.py --write Glass "Principled, coat"

Without --write it prints them alone.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
import OpenEXR
import pytest
from agreement_rows import ROWS, Row

import lighttree_addon
from lighttree_addon.engine import LightTreeEngine
from lighttree_batch.methods import METHODS, configure
from lighttree_batch.metrics import ModelCheck, compare_models, luminance
from lighttree_batch.scenes import build_scene

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]

TABLE = Path(__file__).with_name("agreement.md")
SIZE, SMALL_SIZE = 128, 24  # pixels; tiles of 16 x 16 are 64 a row
NUM_SEEDS, SECONDS = 4, 2  # of each engine, for a row; SECONDS of one render
NUM_BOUNCES = 4
# Of cities, and the seconds of one render. By default Cycles' rays look for lamps: the same picture
# with four times the noise. In much less time than this, means of Cycles are mostly too dark and
# seem more certain than they are: the brightest paths have not come yet.
CITY_SEEDS, CITY_ENGINES = 6, {"lighttree": 20, "cycles-no-lamp-mis": 75}
MOST_OFF, LEAST_SHARE = 5e-3, 0.95  # of the mean, and of tiles within 3 standard errors
SMALL_SAMPLES, SMALL_ERRORS = 32, 4.5
ROUNDING = 1e-3  # of the mean, in the quick test


class Case(NamedTuple):
    """One line of the table."""

    name: str
    check: ModelCheck
    tolerance: float = 0.0
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the engines agree within noise, and 0.5 % of brightness."""
        most_off = MOST_OFF + self.tolerance + 3 * self.check.mean_ratio_sigma
        return abs(self.check.mean_ratio - 1) <= most_off and (
            bool(self.reason) or self.check.share_within_3 >= LEAST_SHARE
        )


def prepare(row: Row) -> None:
    """The scene of a row in a new file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    row.build()


def shoot(method, size, seed, budget, folder, adjust=lambda scene: None):
    """The image of the open file by one method: (H, W, 4) float64, first row at the top."""
    scene = bpy.context.scene
    settings = {"resolution": size, "bounces": NUM_BOUNCES, "threads": 2, "seed": seed}
    configure(bpy.data, scene, METHODS[method], **settings, budget=budget)
    adjust(scene)
    scene.render.filepath = str(folder / "image.exr")
    image = scene.render.image_settings
    image.file_format, image.color_depth, image.color_mode = "OPEN_EXR", "32", "RGBA"
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(scene.render.filepath, separate_channels=True) as file:
        channels = file.channels()
        rgba = [channels[name].pixels for name in "RGBA"]
    return np.stack(rgba, axis=-1).astype(np.float64)


def converge(method, num_seeds, **settings):
    """(mean, its variance) of renders with seeds of their own."""
    images = [shoot(method, seed=seed, **settings) for seed in range(num_seeds)]
    return np.mean(images, 0), np.var(images, 0, ddof=1) / num_seeds


def compare_row(row: Row, folder: Path, size=SIZE, seconds=SECONDS) -> Iterator[Case]:
    """What a row comes to, and its alpha if that is compared."""
    prepare(row)
    settings = {"size": (size, size), "adjust": row.adjust}
    settings |= {"budget": {"seconds": seconds}, "folder": folder}
    found = [converge(name, NUM_SEEDS, **settings) for name in ("lighttree", "cycles")]
    (a, noise_a), (b, noise_b) = found
    rgb = [x[..., :3] for x in (a, noise_a, b, noise_b)]
    yield Case(row.name, compare_models(*rgb), row.tolerance, row.reason)
    if row.has_alpha:
        alpha = [np.repeat(x[..., 3:], 3, axis=-1) for x in (a, noise_a, b, noise_b)]
        yield Case(f"{row.name}, alpha", compare_models(*alpha))


def compare_city(name: str, camera: str, folder: Path) -> Case:
    """A generated city from one of its cameras."""
    path = folder / f"{name}.blend"
    if not path.exists():
        build_scene(name, path)
    bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=False)
    bpy.context.scene.camera = bpy.data.objects[camera]
    found = [
        converge(engine, CITY_SEEDS, size=(160, 96), budget={"seconds": seconds}, folder=folder)
        for engine, seconds in CITY_ENGINES.items()
    ]
    rgb = [x[..., :3] for pair in found for x in pair]
    return Case(f"{name}, {camera}", compare_models(*rgb))


CITIES = [
    (name, camera) for name in ("city-small", "city") for camera in ("street", "roof", "alley")
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "camera"), CITIES)
def test_converged_engines_agree_on_a_city(name, camera, tmp_path):
    case = compare_city(name, camera, tmp_path)
    assert case.agrees, describe(case)


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_converged_engines_agree_on_a_feature(row, tmp_path):
    for case in compare_row(row, tmp_path):
        assert case.agrees, describe(case)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_engines_agree_on_the_brightness_of_a_feature(row, tmp_path):
    prepare(row)
    settings = {"size": (SMALL_SIZE, SMALL_SIZE), "adjust": row.adjust}
    settings |= {"budget": {"samples": SMALL_SAMPLES}, "folder": tmp_path}
    ours = shoot("lighttree", seed=1, **settings)[..., :3]
    ((film, scene),) = LightTreeEngine.rendered
    assert film.dropped_samples == 0 and np.isfinite(ours).all() and ours.any()
    assert scene.not_modelled == []
    theirs, noise = converge("cycles", 2, **settings)
    means = [luminance(image[..., :3]).mean() for image in (ours, theirs)]
    # Pixels are independent; their channels count as fully correlated, as in `compare_models`.
    variances = [
        np.square(luminance(np.sqrt(v))).mean() / SMALL_SIZE**2
        for v in (film.variance, noise[..., :3])
    ]
    tolerance = SMALL_ERRORS * np.sqrt(sum(variances)) + (ROUNDING + row.tolerance) * means[1]
    assert abs(means[0] - means[1]) <= tolerance, (means, np.sqrt(variances))


def describe(case: Case) -> str:
    """One line about a case."""
    check = case.check
    worst = np.abs(check.tile_z).max()
    return (
        f"{case.name}: {check.mean_ratio:.4f} +- {check.mean_ratio_sigma:.4f}, "
        f"{check.share_within_3:.1%} of tiles, worst {worst:.1f} sigma"
    )


def table_line(case: Case) -> str:
    """One line of agreement.md."""
    check = case.check
    ratio = f"{check.mean_ratio:.4f} ± {check.mean_ratio_sigma:.4f}"
    mark = "" if case.agrees else "**no** "
    return f"| {case.name} | {ratio} | {check.share_within_3:.1%} | {mark}{case.reason} |"


def read_table() -> dict[str, str]:
    """The lines of agreement.md that are about a feature, by its name."""
    lines = TABLE.read_text(encoding="utf-8").splitlines() if TABLE.exists() else []
    return {line.split(" | ")[0].removeprefix("| "): line for line in lines if " ± " in line}


def write_table(cases: list[Case], is_whole: bool, seconds: float) -> None:
    """agreement.md of these cases, which keeps other lines unless these are all."""
    known = {} if is_whole else read_table()
    known |= {case.name: table_line(case) for case in cases}
    names = [f"{row.name}{end}" for row in ROWS for end in ("", ", alpha")]
    names += [f"{name}, {camera}" for name, camera in CITIES]
    lines = [
        "# Do the engines agree?",
        "",
        f"Blender {bpy.app.version_string}, {sys.platform}. Made by",
        f"`python tests/test_agreement.py --write --seconds {seconds:g}`: for each feature a small "
        "scene",
        f"(`tests/agreement_rows.py`), rendered {NUM_SEEDS} times {seconds:g} s by each engine at "
        f"{SIZE} x {SIZE} px;",
        "cities of 1,000 and 10,000 lights "
        + ", ".join(f"{CITY_SEEDS} times {s} s by {name}" for name, s in CITY_ENGINES.items())
        + ".",
        "Mean: brightness of LightTree's image over that of Cycles', with its standard error.",
        "Tiles: share of 16 x 16 px tiles that differ by at most 3 standard errors.",
        "",
        "| Feature | Mean | Tiles | |",
        "|---|---|---|---|",
        *(known[name] for name in names if name in known),
        "",
    ]
    TABLE.write_text("\n".join(lines), encoding="utf-8")


def compare_chosen(names: list[str], folder: Path, seconds: float) -> Iterator[Case]:
    """Rows and cities whose name contains one of `names`, all if there are none."""

    def is_chosen(name: str) -> bool:
        return not names or any(part in name for part in names)

    for row in ROWS:
        if is_chosen(row.name):
            yield from compare_row(row, folder, seconds=seconds)
    for name, camera in CITIES:
        if is_chosen(f"{name}, {camera}"):
            yield compare_city(name, camera, folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="rows whose name contains one of these")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.name}")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of one render")
    chosen = parser.parse_args()
    lighttree_addon.register()
    cases = []
    with tempfile.TemporaryDirectory() as folder:
        for case in compare_chosen(chosen.names, Path(folder), chosen.seconds):
            print(describe(case), "" if case.agrees else "<-- differs", flush=True)
            cases.append(case)
    if chosen.write:
        write_table(cases, not chosen.names, chosen.seconds)
    lighttree_addon.unregister()  # or 4.5 hangs when Python exits


if __name__ == "__main__":
    main()
