"""The thesis' evaluation, repeated small: both tables, their files, and what they say."""

import csv
import io
from contextlib import redirect_stdout

import numpy as np
import pytest
from core_scenes import floor_scene, random_lamps
from result_folder import REFERENCE_NOISE, write_result_folder

from lighttree_batch import metrics, plan, single, thesis
from lighttree_batch.__main__ import main
from lighttree_batch.methods import METHODS, tree_options
from lighttree_batch.thesis import DEFAULTS, SCENES, build_scenes, collect_errors, time_builds
from lighttree_core.light_tree.options import TreeOptions
from lighttree_core.lights import bound_lights, build_lights

FEW = ("thesis-random-points", "thesis-three-spheres")
COMMAND = "compare --thesis --seconds 0.1 --max-lights 60 --resolution 32x18 --seeds 1 --bounces 1"
MEASURED = [
    ("as shipped", "saoh", str(TreeOptions().buckets)),
    ("thesis' options", "middle", "one cut"),
    ("thesis' options", "equal", "one cut"),
    ("thesis' options", "sah", "1000"),
    ("thesis' options", "saoh", "1000"),
    ("thesis' options", "sah", "all cuts"),
    ("thesis' options", "saoh", "all cuts"),
]
QUOTED = [(43, "1000"), (3 * 3600, "all cuts")]


def be_still(fraction, text):
    """Nobody watches the progress."""


def read_csv(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder that a comparison of two of the scenes left, and what was printed."""
    folder = tmp_path_factory.mktemp("thesis")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as printed:
        patch.setattr(thesis, "SCENES", {name: SCENES[name] for name in FEW})
        patch.setattr(plan, "REFERENCE_CHUNKS", 2)
        assert main([*COMMAND.split(), "--out", str(folder)]) == 0
    return folder, printed.getvalue()


@pytest.mark.blender
def test_both_tables_are_printed_and_written(finished):
    folder, printed = finished
    errors, builds = read_csv(folder / "thesis.csv"), read_csv(folder / "thesis-build.csv")
    assert [row["scene"] for row in errors] == [f"{name}-60" for name in FEW]
    for row in errors:
        assert 40 < int(row["lights"]) < 70 and row["budget"] == "0.1s"
        numbers = [*DEFAULTS["methods"], *thesis.RATIOS, "reference_noise"]
        assert all(float(row[name]) > 0 for name in numbers)
        assert row["scene"].removeprefix("thesis-") in printed
    assert [(row["tree"], row["split"], row["buckets"]) for row in builds[:7]] == MEASURED
    for row in builds[:7]:
        assert float(row["seconds"]) > 0 and 50 < int(row["lights"]) < 70
    assert printed.count("QUOTED from the thesis") == 2 and "i7-4770K" in printed
    assert "LightTree alone, 1 s" in " ".join(printed.split())
    assert printed.splitlines()[-1] == str(folder / "report.html")


@pytest.mark.blender
def test_no_cycles_is_rendered(finished):
    folder, _ = finished
    run = metrics.read_run(folder)
    assert run["references"] == ["lighttree"] and run["methods"] == list(DEFAULTS["methods"])
    images = {path.name for path in folder.rglob("*.exr")}
    assert "reference-lighttree.exr" in images and not any("cycles" in name for name in images)
    assert "A long render of LightTree alone" in (folder / "report.html").read_text("utf-8")


@pytest.mark.blender
def test_the_thesis_sampler_is_its_tree(finished):
    folder, _ = finished
    _, header = metrics.read_rgb(folder / f"{FEW[0]}-60/lighttree-thesis-0.1s-seed1.exr")
    for name, value in METHODS["lighttree-thesis"].overrides.items():
        assert header["engine_settings"][name] == value
    assert tree_options(header["overrides"]).width == 2


def test_scenes_are_built_once_and_no_larger_than_asked_for(tmp_path, monkeypatch):
    built = {}

    def build(name, out, num_lights, seed, progress):
        built[out.name] = num_lights
        out.touch()

    monkeypatch.setattr(single, "build_blend", build)
    few = build_scenes(tmp_path, 2_000, be_still)
    assert len(few) == len(built) == 8
    assert built["thesis-spots-20.blend"] == 20
    assert built["thesis-ceiling-points-2000.blend"] == 2_000
    assert build_scenes(tmp_path, 2_000, be_still) == few and len(built) == 8
    build_scenes(tmp_path, None, be_still)
    assert built["thesis-ceiling-points.blend"] == 1_600_000
    build_scenes(tmp_path / "least", 1, be_still)
    assert built["thesis-mixed-84.blend"] == 84


def test_errors_and_ratios_are_those_of_the_images(tmp_path, monkeypatch):
    monkeypatch.setattr(metrics, "flip", lambda image, reference: (0.25, image[..., 0]))
    speed = dict(zip(DEFAULTS["methods"], (20, 10, 5, 2), strict=True))
    write_result_folder(tmp_path, speed=speed)
    (row,) = collect_errors(tmp_path)
    assert (row["lights"], row["budget"]) == (1000, "8s")
    # 3072 spiky pixels and two seeds.
    assert row["lighttree"] == pytest.approx(8 / (8 * 20), rel=0.15)
    assert row["power_over_tree"] == pytest.approx(10, rel=0.15)
    assert row["single_over_split"] == pytest.approx(2, rel=0.15)
    assert row["power_over_thesis"] == pytest.approx(2.5, rel=0.15)
    assert row["reference_noise"] == pytest.approx(REFERENCE_NOISE, rel=0.15)

    for path in tmp_path.rglob("lighttree-power-*.exr"):
        path.unlink()
    (row,) = collect_errors(tmp_path)
    assert np.isnan([row[name] for name in ("lighttree-power", "power_over_tree")]).all()
    assert row["single_over_split"] == pytest.approx(2, rel=0.15)


def test_builds_are_told_from_those_that_are_quoted():
    lights, *_ = build_lights(floor_scene(random_lamps(np.random.default_rng(7), 300)))
    rows = time_builds(bound_lights(lights), 1, "this machine", be_still)
    assert [(row["tree"], row["split"], row["buckets"]) for row in rows[:7]] == MEASURED
    assert {(row["lights"], row["machine"], row["threads"]) for row in rows[:7]} == {
        (300, "this machine", 1)
    }
    assert [(row["seconds"], row["buckets"]) for row in rows[7:]] == QUOTED
    assert all(
        row["tree"] == "QUOTED from the thesis" and row["lights"] == 10**6 for row in rows[7:]
    )
