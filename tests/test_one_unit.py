"""Units of a batch one by one, as render managers have them done: what is refused, what is left."""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from inspected_job import list_units, write_job

from lighttree_batch import facts, one_unit
from lighttree_batch.__main__ import main
from lighttree_batch.images import read_exr, write_exr
from lighttree_batch.local_crew import LocalWorker
from lighttree_batch.methods import InputError
from lighttree_batch.process import RenderError

at_work: list[dict] = []


@pytest.fixture
def job(tmp_path, monkeypatch):
    """A job whose renders take 50 ms, and are of noise."""
    monkeypatch.setattr(one_unit.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(LocalWorker, "render_file", render_noise)
    return write_job(tmp_path)


def render_noise(worker, file, header, advance):
    assert not at_work, "another render beside a timed one"
    at_work.append(header)
    time.sleep(0.05)
    pixels = np.random.default_rng(header["seed"]).random((3, 8, 12), np.float32)
    told = {"machine": facts.describe_machine()}
    write_exr(worker.unfinished, dict(zip("RGB", pixels, strict=True)), header | told)
    at_work.remove(header)


def render(job, unit, length=16):
    return one_unit.render_unit(job, unit.header["key"][:length], lambda *_: None)


def test_a_unit_is_rendered_once_and_nothing_else_is_touched(job):
    unit = list_units(job)[-1]
    others = [job.out / ".unfinished" / "x", unit.path.parent / ".y.exr.7.tmp"]
    for path in others:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    before = set(job.out.rglob("*"))
    with FileLock(job.out / ".lock"):  # as of a batch that is at work
        before.add(job.out / ".lock")
        assert render(job, unit) == (unit.path, True)
        written = unit.path.stat().st_mtime_ns
        assert render(job, unit, 64) == (unit.path, False)
    assert unit.path.stat().st_mtime_ns == written
    assert read_exr(unit.path)[1]["key"] == unit.header["key"]
    assert set(job.out.rglob("*")) - before == {unit.path}


def test_timed_units_take_turns_on_a_machine(job):
    units = list_units(job)[-4:]
    with ThreadPoolExecutor(4) as workers:
        assert all(is_new for _, is_new in workers.map(lambda unit: render(job, unit), units))


def test_a_unit_that_fails_leaves_its_log(job, monkeypatch):
    def fail(worker, *_):
        Path(worker.process._log).write_text("what Blender printed")
        raise RenderError("It crashed.")

    monkeypatch.setattr(LocalWorker, "render_file", fail)
    unit = list_units(job)[-1]
    with pytest.raises(RenderError, match=r"It crashed\."):
        render(job, unit)
    assert unit.path.with_suffix(".log").read_text() == "what Blender printed"
    assert not unit.path.exists()


def change(job, **changes):
    """Change what was found in the first scene; its units."""
    folder = job.out / job.sources[0].name
    units = list_units(job)[: len(list_units(job)) // 2]
    facts.save_facts(facts.load_facts(folder) | changes, job.sources[0], folder)
    return units


def test_units_of_scenes_that_are_not_as_inspected_are_refused(job):
    last = list_units(job)[-1]
    (unit, *_) = change(job)
    job.sources[0].file.write_text("changed")
    with pytest.raises(RenderError, match=r"a\.blend has changed since it was inspected, or is"):
        render(job, unit)
    assert render(job, last)[1]  # of the other scene
    (job.out / "a/inspected.json").write_text("{")
    with pytest.raises(InputError, match=r"begins with '\w+', as far as scenes were inspected"):
        render(job, unit)
    with pytest.raises(InputError, match="20 units have keys that begin with ''; give more"):
        one_unit.render_unit(job, "", None)


def test_a_machine_that_renders_otherwise_is_refused(job, monkeypatch):
    others = {"CYCLES": "Blender 9", "LIGHTTREE": "LightTree 9"}
    change(job, renderers=others)
    with pytest.raises(
        RenderError, match=r"with Blender 9 and LightTree 9; this machine has Blender \d"
    ):
        render(job, list_units(job)[0])
    few = facts.describe_machine() | {"cores": 0}
    monkeypatch.setattr(one_unit, "describe_machine", lambda: few)
    with pytest.raises(RenderError, match="has 0 cores, and the batch is timed with 1 threads"):
        render(job, list_units(job)[-1])


def test_renders_of_a_scene_stay_with_one_cpu_and_references_do_not(job, monkeypatch, capsys):
    units = list_units(job)
    first, second, *_ = units[16:20]
    assert render(job, first)[1]
    other = facts.describe_machine() | {"cpu": "Other CPU"}
    monkeypatch.setattr(one_unit, "describe_machine", lambda: other)
    assert render(job, units[0])[1]  # part of a reference
    assert render(job, units[-1])[1]  # of another scene
    path = job.out.parent / "jobs.toml"
    assert main(["batch", str(path), "--unit", second.header["key"]]) == 1
    assert "images of a were made by another CPU" in capsys.readouterr().err
    assert not second.path.exists() and not at_work


def test_a_render_that_another_cpu_outran_is_not_kept(job, monkeypatch):
    def be_outrun(worker, file, header, advance):
        told = {"machine": {"cpu": "Fast CPU"}}
        write_exr(first.path, {"Y": np.ones((2, 2))}, first.header | told)
        render_noise(worker, file, header, advance)

    monkeypatch.setattr(LocalWorker, "render_file", be_outrun)
    first, second, *_ = list_units(job)[16:20]
    with pytest.raises(RenderError, match="made by another CPU, Fast CPU; this is"):
        render(job, second)
    assert not second.path.exists()
