"""Comparisons from end to end: both engines on a tiny city, resuming, failures, references."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from lighttree_batch import local_crew, plan
from lighttree_batch.experiment import run_comparison
from lighttree_batch.images import read_exr, write_exr
from lighttree_batch.methods import METHODS, InputError
from lighttree_batch.metrics import collect_results
from lighttree_batch.plan import Options, Source
from lighttree_batch.process import RenderProcess
from lighttree_batch.references import average_chunks, write_references

OPTIONS = Options(
    methods=("lighttree", "cycles"),
    budget_kind="samples",
    budgets=(1, 4),
    seeds=1,
    resolution=(64, 36),
    bounces=1,
    reference_seconds=0.6,
)
NUM_RENDERS, NUM_CHUNKS = 4, 2
NUM_UNITS = NUM_RENDERS + 2 * NUM_CHUNKS


@pytest.fixture(scope="module", autouse=True)
def few_chunks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "REFERENCE_CHUNKS", NUM_CHUNKS)
        yield


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    path = tmp_path_factory.mktemp("city") / "tiny.blend"
    command = [sys.executable, "-m", "lighttree_batch", "scene", "city-small", "-o", str(path)]
    subprocess.run([*command, "--lights", "200"], check=True)
    return path


@pytest.fixture(scope="module")
def finished(city, tmp_path_factory):
    """A finished comparison, and what it came to; tests work on copies."""
    folder = tmp_path_factory.mktemp("finished")
    return folder, run_comparison([city], folder, OPTIONS, command="lighttree compare ...")


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished[0], tmp_path / "run")


def header(folder, name):
    return read_exr(folder / "tiny" / f"{name}.exr")[1]


@pytest.mark.blender
def test_compare_renders_both_engines_and_writes_a_report(finished, city):
    folder, outcome = finished
    assert outcome.failed == []
    assert (outcome.num_rendered, outcome.num_kept) == (NUM_UNITS, 0)
    assert outcome.report.exists() and (folder / "results.csv").exists()
    assert not (folder / ".unfinished").exists()
    assert len(collect_results(folder)[0]) == NUM_RENDERS

    run = json.loads((folder / "run.json").read_text())
    assert run["methods"] == ["lighttree", "cycles"] and run["budgets"] == [1, 4]
    assert {"lighttree", "blender", "python", "numba", "embreex", "numpy"} <= set(run["versions"])
    (scene,) = run["scenes"]
    assert scene["camera"] == "street" and scene["triangles"] > 0 and scene["failed"] == []
    assert 190 < sum(scene["lights"].values()) < 800  # windows are two triangles each


@pytest.mark.blender
def test_headers_tell_how_an_image_was_made(finished):
    folder, _ = finished
    for method in OPTIONS.methods:
        facts = header(folder, f"{method}-4spp-seed1")
        assert facts["samples"] == 4 and facts["budget"] == {"samples": 4}
        assert facts["resolution"] == [64, 36] and facts["bounces"] == 1
        assert facts["seconds_render"] > 0 and facts["seconds_setup"] > 0
        # Each image is rendered by a process of its own, which has kernels to load.
        assert (facts["seconds_compile"] > 0) == (method == "lighttree")
        assert facts["peak_mib"] is None or 50 < facts["peak_mib"] < 5000
        assert len(facts["settings"]["file_sha256"]) == 64
    cycles = header(folder, "cycles-4spp-seed1")["engine_settings"]
    assert cycles["use_light_tree"] and cycles["pixel_filter_type"] == "BOX"
    assert cycles["sample_clamp_indirect"] == cycles["light_sampling_threshold"] == 0
    assert not cycles["use_adaptive_sampling"] and not cycles["use_denoising"]
    assert header(folder, "lighttree-4spp-seed1")["engine_settings"]["filter"] == "box"


@pytest.mark.blender
def test_references_agree_and_weigh_the_less_noisy_engine_more(finished):
    folder, _ = finished
    means, variances = {}, {}
    for engine in ("lighttree", "cycles"):
        channels, facts = read_exr(folder / "tiny" / f"reference-{engine}.exr")
        assert facts["chunks"] == NUM_CHUNKS and facts["seconds_render"] > 0.2
        means[engine] = channels["G"].mean()
        variances[engine] = np.mean([channels[f"variance.{c}"] for c in "RGB"])
    # Two noisy pictures of the same city; a factor of 2 would be a wrong unit.
    assert 0.5 < means["lighttree"] / means["cycles"] < 2
    weight = variances["cycles"] / (variances["lighttree"] + variances["cycles"])
    assert header(folder, "reference")["weight_lighttree"] == pytest.approx(weight, rel=1e-3)


@pytest.mark.blender
def test_a_second_run_renders_nothing(folder, city):
    outcome = run_comparison([city], folder, OPTIONS)
    assert (outcome.num_rendered, outcome.num_kept) == (0, NUM_UNITS)


@pytest.mark.blender
def test_damaged_and_missing_images_are_rendered_again(folder, city):
    whole = (folder / "tiny/cycles-1spp-seed1.exr").read_bytes()
    (folder / "tiny/cycles-1spp-seed1.exr").write_bytes(whole[: len(whole) // 2])
    (folder / "tiny/reference-chunks/lighttree-1.exr").unlink()
    outcome = run_comparison([city], folder, OPTIONS)
    assert (outcome.num_rendered, outcome.num_kept) == (2, NUM_UNITS - 2)
    assert header(folder, "reference-lighttree")["chunks"] == NUM_CHUNKS


@pytest.mark.blender
def test_a_changed_setting_renders_all_that_it_changes(folder, city):
    more_seeds = replace(OPTIONS, seeds=2, methods=("lighttree",))
    outcome = run_comparison([city], folder, more_seeds)
    assert (outcome.num_rendered, outcome.num_kept) == (2, 2 + 2 * NUM_CHUNKS)
    outcome = run_comparison([city], folder, replace(more_seeds, bounces=0))
    assert (outcome.num_rendered, outcome.num_kept) == (4 + 2 * NUM_CHUNKS, 0)
    assert header(folder, "lighttree-4spp-seed2")["bounces"] == 0


@pytest.mark.blender
def test_options_of_the_tree_change_lighttree_s_renders_and_no_reference(folder, city):
    other_tree = replace(OPTIONS, tree={"tree_width": 2})
    outcome = run_comparison([city], folder, other_tree)
    assert (outcome.num_rendered, outcome.num_kept) == (2, NUM_UNITS - 2)
    assert header(folder, "lighttree-4spp-seed1")["engine_settings"]["tree_width"] == 2
    assert header(folder, "lighttree-4spp-seed1")["overrides"] == {"tree_width": 2}


@pytest.mark.blender
def test_a_probe_is_made_once_and_shown_in_the_report(folder, city, monkeypatch):
    from lighttree_batch import probe

    monkeypatch.setattr(probe, "NUM_POINTS", 20)
    asked = replace(OPTIONS, probe=True)
    outcome = run_comparison([city], folder, asked)
    assert (outcome.num_rendered, outcome.failed) == (0, [])
    page = outcome.report.read_text()
    assert "Choosing lights alone" in page and "at 40 points that the camera sees" in page
    made = (folder / "tiny/probe.csv").stat().st_mtime_ns
    run_comparison([city], folder, asked)
    assert (folder / "tiny/probe.csv").stat().st_mtime_ns == made


FACTS = {"renderers": {"LIGHTTREE": "L", "CYCLES": "C"}, "camera": "c", "frame": 1}
FACTS |= {
    "scene": "Scene",
    "view_layer": "ViewLayer",
    "files": [],
    "fixed_files": [],
    "file_sha256": "0",
    "lights": {},
    "triangles": 0,
    "not_modelled": [],
}


def plan_nothing(folder, **changes):
    """The plan of a scene that nobody looked at."""
    return plan.plan_scene(Source("s.blend"), FACTS, folder, replace(OPTIONS, **changes))


def test_a_method_s_own_tree_stays_as_it_is(tmp_path):
    methods = ("lighttree", "lighttree-thesis", "cycles")
    tree = {"tree_width": 4, "tree_split_threshold": 0.5}
    units = plan_nothing(tmp_path, methods=methods, tree=tree, budgets=(1,)).renders
    ours, thesis, cycles = (unit.header["overrides"] for unit in units)
    assert ours == tree
    assert thesis == METHODS["lighttree-thesis"].overrides | {"tree_split_threshold": 0.5}
    assert cycles == METHODS["cycles"].overrides


def test_a_key_is_of_all_that_determines_an_image(tmp_path):
    def find_keys(facts=FACTS, **changes):
        options = replace(OPTIONS, seeds=2, **changes)
        units = plan.plan_scene(Source("s.blend"), facts, tmp_path, options).units
        return {unit.header["key"] for unit in units}

    keys = find_keys()
    assert len(keys) == 2 * NUM_CHUNKS + 2 * NUM_RENDERS
    renderers = {"LIGHTTREE": "L2", "CYCLES": "C2"}
    for change in ({"camera": "d"}, {"frame": 2}, {"file_sha256": "1"}, {"renderers": renderers}):
        assert not keys & find_keys(facts=FACTS | change)
    assert not keys & find_keys(bounces=2)
    assert not keys & find_keys(resolution=(64, 37))
    # Cycles' renders and the references stay; what is timed depends on the number of threads.
    assert len(keys & find_keys(tree={"tree_width": 2})) == len(keys) - NUM_RENDERS
    assert len(keys & find_keys(threads=7)) == 2 * NUM_RENDERS


def test_references_of_one_engine_can_be_asked_for(tmp_path):
    chunks = plan_nothing(tmp_path, references=("lighttree",)).all_chunks
    assert [unit.header["method"] for unit in chunks] == ["lighttree"] * NUM_CHUNKS


@pytest.mark.blender
def test_an_interrupted_run_leaves_whole_files_and_goes_on(city, tmp_path):
    def interrupt(fraction, text):
        if text.startswith("tiny cycles-1: "):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_comparison([city], tmp_path, OPTIONS, interrupt)
    images = list(tmp_path.rglob("*.exr"))
    assert images and all(read_exr(path) for path in images)
    assert not (tmp_path / ".unfinished").exists()

    outcome = run_comparison([city], tmp_path, OPTIONS)
    assert (outcome.num_kept, outcome.failed) == (len(images), [])
    assert outcome.num_rendered == NUM_UNITS - len(images)


@pytest.mark.blender
def test_a_process_that_dies_is_replaced_and_one_that_always_dies_costs_one_image(
    folder, city, monkeypatch
):
    running, kills = [], []

    class Watched(RenderProcess):
        def ask(self, job, *rest):
            running[:] = [self]
            return super().ask(job, *rest)

    def kill(fraction, text):
        unit, _, doing = text.removeprefix("tiny ").partition(": ")
        is_next = unit == "lighttree-1spp-seed1" or (unit == "cycles-1spp-seed1" and not kills)
        if doing == "Rendering" and is_next:
            kills.append(unit)
            running[0]._process.kill()

    monkeypatch.setattr(local_crew, "RenderProcess", Watched)
    for name in ("cycles-1spp", "lighttree-1spp", "lighttree-4spp"):
        (folder / f"tiny/{name}-seed1.exr").unlink()
    one_seed = replace(OPTIONS, methods=("cycles", "lighttree"))
    outcome = run_comparison([city], folder, one_seed, kill)
    assert kills == ["cycles-1spp-seed1"] + ["lighttree-1spp-seed1"] * 3
    assert outcome.num_rendered == 2
    (failure,) = outcome.failed
    assert "lighttree-1spp-seed1" in failure and "was killed (SIGKILL), perhaps for" in failure
    assert json.loads((folder / "run.json").read_text())["scenes"][0]["failed"]


@pytest.mark.blender
def test_a_time_limit_holds_for_every_method(city, tmp_path):
    options = replace(
        OPTIONS, methods=tuple(METHODS), budget_kind="seconds", budgets=(0.5,), bounces=0
    )
    outcome = run_comparison([city], tmp_path, options)
    assert outcome.failed == []
    for method in METHODS:
        facts = header(tmp_path, f"{method}-0.5s-seed1")
        assert facts["samples"] >= 1
        # Neither engine stops in the middle of a sample; guiding trains in batches.
        assert 0.1 < facts["seconds_render"] < 3, method


@pytest.mark.blender
def test_cameras_make_scenes_of_their_own(city, tmp_path):
    options = replace(OPTIONS, methods=("cycles",), budgets=(1,), cameras=("roof", "alley"))
    outcome = run_comparison([city], tmp_path, options)
    assert outcome.failed == []
    images = [read_exr(tmp_path / f"tiny-{c}/cycles-1spp-seed1.exr") for c in ("roof", "alley")]
    assert [facts["settings"]["camera"] for _, facts in images] == ["roof", "alley"]
    assert not np.array_equal(images[0][0]["R"], images[1][0]["R"])


def test_average_of_chunks_is_weighted_by_samples_and_its_variance_is_right(tmp_path):
    # 2000 pixels of mean 1 and, for one sample, variance 4; chunks of unequal length.
    rng, samples = np.random.default_rng(7), np.array([1, 2, 3, 10])
    paths = [tmp_path / f"{i}.exr" for i in range(4)]
    for path, n in zip(paths, samples, strict=True):
        image = rng.normal(1, 2 / np.sqrt(n), (40, 50)).astype(np.float32)
        facts = {"samples": int(n), "seconds_render": 1.0, "seconds_setup": 0.5}
        write_exr(path, dict.fromkeys("RGB", image), facts)
    mean, variance, facts = average_chunks(paths)
    seconds = {"seconds_render": 4.0, "seconds_setup": 2.0, "seconds_compile": 0.0}
    assert facts == {"samples": 16, "chunks": 4} | seconds
    # Variance of the mean: 4 / 16. Both estimates of it, from 2000 pixels with 1 and with 3
    # degrees of freedom, have a relative deviation of sqrt(2 / (2000 k)), 3.2 % and 1.8 %.
    assert mean[..., 0].var() == pytest.approx(0.25, rel=0.13)
    assert variance[..., 0].mean() == pytest.approx(0.25, rel=0.08)


def test_a_reference_of_one_engine_is_used_alone(tmp_path):
    facts = {"samples": 4, "seconds_render": 1.0, "seconds_setup": 0.5}
    paths = [tmp_path / "0.exr", tmp_path / "1.exr"]
    for i, path in enumerate(paths):
        write_exr(path, dict.fromkeys("RGB", np.full((4, 4), 1.0 + i, np.float32)), facts)
    write_references(tmp_path, {"scene": "s"}, {"lighttree": paths[:1], "cycles": paths})
    channels, found = read_exr(tmp_path / "reference.exr")
    assert found["weight_lighttree"] == 0 and channels["R"][0, 0] == 1.5
    assert not (tmp_path / "reference-lighttree.exr").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"methods": ("cyclees",)}, "no method called 'cyclees'"),
        ({"budgets": (-1,)}, "must be 0.001 to"),
        ({"budgets": (float("nan"),)}, "not nan"),
        ({"budgets": ()}, "number of budgets"),
        ({"resolution": (0, 0)}, "width in pixels must be 4"),
        ({"seeds": 0}, "number of seeds"),
        ({"bounces": -1}, "number of bounces"),
    ],
)
def test_options_refuse_what_makes_no_sense(change, sentence):
    with pytest.raises(InputError, match=sentence):
        replace(OPTIONS, **change)


def test_two_files_of_one_name_are_refused(tmp_path):
    for name in ("a/city.blend", "b/city.blend"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    with pytest.raises(InputError, match="the scene name 'city' is taken"):
        run_comparison([tmp_path / "a/city.blend", tmp_path / "b/city.blend"], tmp_path, OPTIONS)
