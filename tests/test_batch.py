"""Batches that are disturbed: killed, out of order, side by side, at several frames."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shot_batch import JOB, assert_same_images, find_images, prepare, save_shot

from lighttree_batch import experiment, local_crew, plan, process
from lighttree_batch.experiment import run_batch
from lighttree_batch.images import read_exr, write_exr
from lighttree_batch.plan import Options, Source
from lighttree_batch.process import ProcessDied
from lighttree_batch.report import write_report
from lighttree_batch.views import AS_SAVED

CITIES = """
methods = [
    "lighttree", "lighttree-single", "lighttree-power", "lighttree-uniform", "cycles",
    "cycles-no-tree",
]
samples = [1]
seeds = 3
resolution = [320, 180]
reference_samples = 8
[[scene]]
generate = "city-small"
cameras = ["street", "roof", "alley"]
[[scene]]
generate = "city"
cameras = ["street", "roof", "alley"]
[[scene]]
generate = "city"
seed = 1
cameras = ["street", "roof", "alley"]
"""
SIZE = (12, 8)


def list_children(pid):
    command = ["ps", "-o", "pid=", "--ppid", str(pid)]
    return subprocess.run(command, capture_output=True, text=True).stdout.split()


@pytest.mark.blender
@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL")
@pytest.mark.parametrize(
    ("job", "num_scenes", "num_renders"),
    [
        pytest.param(JOB, 2, 4, id="a cube at two frames"),
        pytest.param(CITIES, 9, 18, id="three cities from three cameras", marks=pytest.mark.slow),
    ],
)
def test_a_batch_killed_three_times_ends_in_the_images_of_an_undisturbed_one(
    shot, tmp_path, job, num_scenes, num_renders
):
    # One renders serially; the other side by side, with half the threads, and is killed.
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    num_images = num_scenes * (2 * 8 + num_renders)
    subprocess.run(prepare(calm, shot, job), check=True, capture_output=True)
    command, rng = [*prepare(killed, shot, job), "--workers", "2"], np.random.default_rng(7)
    # What Blender saves is never the same file twice, so a scene that is generated is built once.
    (killed / "results").mkdir()
    for built in (calm / "results").glob("*.blend"):
        shutil.copy(built, killed / "results")
    for _ in range(3):
        enough = len(find_images(killed)) + rng.integers(0, num_images // 5)
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        while len(find_images(killed)) < enough or not (children := list_children(process.pid)):
            assert process.poll() is None
            time.sleep(0.02)
        time.sleep(rng.uniform(0, 0.2))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        ended = time.monotonic()
        while any(Path(f"/proc/{pid}").exists() for pid in children):
            assert time.monotonic() - ended < 10, "its render processes live on"
            time.sleep(0.05)
        assert all(read_exr(killed / name) for name in find_images(killed))
    num_kept = sum("reference" not in Path(name).stem for name in find_images(killed))
    assert 0 < num_kept < num_images
    finished = subprocess.run(command, check=True, capture_output=True, text=True)
    assert f"Rendered {num_images - num_kept} images, kept {num_kept}." in finished.stderr

    assert len(find_images(calm)) == num_images + num_scenes * 3
    assert_same_images(calm, killed)
    leftovers = [p.name for p in (killed / "results").rglob(".*")]
    assert leftovers == [".lock"]


@pytest.mark.blender
def test_frames_make_scenes_of_their_own(shot, tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "REFERENCE_CHUNKS", 2)
    monkeypatch.setattr(experiment, "write_report", lambda *_: "")
    save_shot(tmp_path / "saved-at-10.blend", 10)
    options = Options(("lighttree", "cycles"), "samples", (4,), 1, (16, 9), reference_samples=2)
    sources = [Source(shot, None, frame) for frame in (1, 10, None)]
    outcome = run_batch([*sources, Source(tmp_path / "saved-at-10.blend")], tmp_path, options)
    assert outcome.failed == []
    for method in options.methods:
        names = ("shot-f1", "shot-f10", "shot", "saved-at-10")
        found = [read_exr(tmp_path / name / f"{method}-4spp-seed1.exr") for name in names]
        assert [header["settings"]["frame"] for _, header in found] == [1, 10, 1, 10]
        bright, dim, first, last = (channels["G"] for channels, _ in found)
        assert np.array_equal(bright, first) and np.array_equal(dim, last)
        assert bright.max() > 2 * dim.max()


@pytest.mark.blender
def test_a_file_that_was_saved_anew_is_not_rendered_as_the_old_one(shot, tmp_path):
    from lighttree_batch import worker

    shown = AS_SAVED._asdict() | {"file_sha256": "of the old one"}
    header = {"method": "cycles", "overrides": {}, "settings": shown}
    with pytest.raises(plan.InputError, match=r"shot.blend has changed meanwhile; run the"):
        worker.render_unit(lambda **_: None, str(shot), header, 0.0, str(tmp_path / "x.exr"))


class FakeProcess:
    """A render process without Blender that does what a test tells it to."""

    versions = {"blender": "0"}
    running, most = 0, 0

    def __init__(self, log):
        self.log = log

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        pass

    def ask(self, job, progress=None, seconds=0):
        if job["do"] == "inspect":
            self.inspect(job["file"])
            facts = {"camera": "c", "frame": 1, "file_sha256": job["file"], "files": []}
            facts |= {"fixed_files": [], "scene": "Scene", "view_layer": "ViewLayer"}
            facts |= {"renderers": {"LIGHTTREE": "L", "CYCLES": "C"}}
            return facts | {"lights": {}, "triangles": 0, "not_modelled": []}
        header = job["header"]
        type(self).running += 1
        type(self).most = max(self.most, self.running)
        try:
            self.render(header, progress)
        finally:
            type(self).running -= 1
        rng = np.random.default_rng([header["seed"], len(header["method"])])
        pixels = rng.random((3, *header["resolution"][::-1]), np.float32)
        facts = {"samples": 4, "seconds_render": 1.0, "seconds_setup": 0.5, "peak_mib": 1.0}
        write_exr(job["out"], dict(zip("RGB", pixels, strict=True)), header | facts)

    def inspect(self, file):
        pass

    def render(self, header, progress):
        pass


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a batch of two scenes with fake processes."""
    for name in ("a.blend", "b.blend"):
        (tmp_path / name).touch()
    monkeypatch.setattr(plan, "REFERENCE_CHUNKS", 2)
    monkeypatch.setattr(experiment, "write_report", lambda *_: "")

    def run_fake(process, progress=None, **changes):
        for module in (experiment, local_crew):
            monkeypatch.setattr(module, "RenderProcess", process)
        options = Options(("lighttree", "cycles"), "samples", (1, 4), 2, SIZE, reference_samples=2)
        sources = [Source(tmp_path / "a.blend", place=("j", 1)), Source(tmp_path / "b.blend")]
        return run_batch(sources, tmp_path / "out", replace(options, **changes), progress)

    return run_fake


def test_compiling_moves_the_bar_and_rendering_begins_it_anew(monkeypatch):
    script = """if True:
        import sys, time
        print('{"ready": {}}', flush=True)
        sys.stdin.readline()
        print('{"text": "Compiling kernels", "fraction": 0.9}', flush=True)
        time.sleep(0.3)
        print('{"text": "Rendering", "fraction": 0.0, "renders": true}', flush=True)
        time.sleep(0.6)
        print('{"done": 7}', flush=True)
        sys.stdin.readline()
    """
    monkeypatch.setattr(process, "_command", lambda: [sys.executable, "-c", script])
    told = []
    with process.RenderProcess() as renders:
        assert renders.ask({}, lambda *what: told.append(what), seconds=10) == 7
    compiling = [share for share, text in told if text == "Compiling kernels"]
    rendering = [share for share, text in told if text == "Rendering"]
    assert set(compiling) == {0.9}
    # The clock of the budget starts with rendering, and moves the bar where no message comes.
    assert rendering == sorted(rendering) and rendering[0] < 0.02 < rendering[-1] < 0.2


def test_each_unit_has_a_process_of_its_own(run):
    class Process(FakeProcess):
        num_rendered = 0

        def render(self, header, progress):
            self.num_rendered += 1
            assert self.num_rendered == 1

        def close(self):
            self.num_rendered = 0

    assert run(Process).failed == []


def test_a_scene_that_kills_its_process_costs_no_other(run, tmp_path):
    tries = []

    class Deadly(FakeProcess):
        def inspect(self, file):
            tries.append(file)
            if "a.blend" in file:
                raise ProcessDied("The render process crashed (SIGSEGV).")

        def render(self, header, progress):
            tries.append(header["method"])
            if header["method"] == "cycles" and header["budget"] == {"samples": 4}:
                raise ProcessDied("The render process crashed (SIGSEGV).")

    outcome = run(Deadly, workers=2)
    page = write_report(tmp_path / "out").read_text()
    assert "(2 samples each)" in page and "ran 2 at a time" in page
    assert "not compared: nothing was rendered" in page and "cycles-4spp-seed2" in page
    assert (outcome.num_rendered, outcome.num_kept) == (4 + 8 - 2, 0)
    assert [text.partition(":")[0] for text in outcome.failed] == [
        "a The render process crashed (SIGSEGV).",
        "b cycles-4spp-seed1",
        "b cycles-4spp-seed2",
    ]
    assert len([name for name in tries if "a.blend" in name]) == 3
    assert tries.count("cycles") == 2 + 2 + 3 * 2


@pytest.mark.parametrize("workers", [1, 3])
def test_a_full_disk_stops_the_batch(run, tmp_path, workers):
    asked = []

    class Full(FakeProcess):
        def render(self, header, progress):
            asked.append(header)
            for _ in range(20 if len(asked) > 9 else 0):
                time.sleep(0.01)
                progress(0.5, "Rendering")
            if len(asked) == 9:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "unit.exr")

    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        run(Full, workers=workers)
    assert len(asked) <= 8 + workers
    images = find_images(tmp_path / "out")
    assert 6 <= len([name for name in images if "reference" not in Path(name).stem]) <= 8
    assert not (tmp_path / "out/.unfinished").exists()


def test_only_what_is_not_timed_runs_side_by_side(run):
    threads = set()

    class Slow(FakeProcess):
        def render(self, header, progress):
            time.sleep(0.02)
            if "seconds" in header["budget"]:
                assert self.running == 1
            threads.add((*header["budget"], header["threads"]))

    outcome = run(Slow, workers=3, reference_samples=0)
    assert outcome.failed == [] and Slow.most == 3
    all_threads = Options().num_threads
    assert threads == {("seconds", all_threads), ("samples", max(1, all_threads // 3))}
    # The same images by one worker, so all are kept.
    assert run(FakeProcess, reference_samples=0).num_rendered == 0
    # Timed ones depend on what ran beside them and on the threads.
    assert run(FakeProcess, reference_samples=0, threads=all_threads + 1).num_rendered == 8


def test_ctrl_c_stops_all_workers(run):
    asked = []

    class Endless(FakeProcess):
        def render(self, header, progress):
            asked.append(header)
            while True:
                time.sleep(0.01)
                progress(0.5, "Rendering")

    def interrupt(fraction, text):
        if len(asked) == 3 and text.endswith("Rendering"):
            raise KeyboardInterrupt

    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run(Endless, interrupt, workers=3)
    assert len(asked) == 3 and time.monotonic() - started < 5


def test_a_second_batch_in_the_same_folder_is_refused(run):
    refused = []

    class Second(FakeProcess):
        def render(self, header, progress):
            if not refused:
                with pytest.raises(plan.InputError) as refusal:
                    run(FakeProcess)
                refused.append(str(refusal.value))

    assert run(Second).failed == []
    assert "out: another batch is at work there; wait for its end, or" in refused[0]
    assert run(FakeProcess).num_rendered == 0


def test_mistakes_of_several_scenes_are_told_together(run):
    class Picky(FakeProcess):
        def inspect(self, file):
            raise plan.InputError(f"{Path(file).name}: there is no camera called 'x'.")

    with pytest.raises(plan.InputError) as refused:
        run(Picky)
    assert str(refused.value).splitlines() == [
        "j:1: a.blend: there is no camera called 'x'.",
        "b.blend: there is no camera called 'x'.",
    ]
