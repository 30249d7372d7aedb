"""Batches by way of Flamenco: its job type, what is submitted to a Manager, units one by one."""

import json
import re
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import dukpy
import numpy as np
import pytest
from filelock import FileLock
from shot_batch import assert_same_images, find_images, prepare

from lighttree_batch import facts, farm, one_unit
from lighttree_batch.__main__ import main
from lighttree_batch.images import read_exr, write_exr
from lighttree_batch.jobs import read_job
from lighttree_batch.local_crew import LocalWorker
from lighttree_batch.methods import InputError
from lighttree_batch.plan import plan_scene
from lighttree_batch.process import RenderError

# What Flamenco gives to job types, as far as ours uses it.
AUTHOR = """
function addTo(key) { return function (item) { this[key].push(item); }; }
var author = {
    Task: function (name, type) {
        return { name: name, type: type, commands: [], dependencies: [],
                 addCommand: addTo("commands"), addDependency: addTo("dependencies") };
    },
    Command: function (name, parameters) { return { name: name, parameters: parameters }; },
};
"""
COMPILE = """
var job = { settings: dukpy.settings, tasks: [], addTask: addTo("tasks") };
compileJob(job);
job.tasks;
"""


def run_job_type(*more, **given):
    """What the last of some scripts comes to after the job type's own."""
    script = farm.JOB_TYPE.read_text()
    return dukpy.evaljs(["'use strict';" + AUTHOR + script, *more], **given)


class FakeManager(ThreadingHTTPServer):
    """A Flamenco Manager: answers by path, and the jobs that came in, compiled."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.url = f"http://127.0.0.1:{self.server_port}"
        self.jobs = []
        self.answers = {
            "jobs/type/lighttree-batch": (200, {"etag": "e1"}),
            "worker-mgt/tags": (200, {"tags": [{"name": "fast", "id": "id of fast"}]}),
        }
        for system in ("linux", "windows", "darwin"):
            self.answers[f"configuration/variables/workers/{system}"] = 200, {"blender": {}}

    def compile(self, job):
        self.jobs.append(job)
        try:
            job["tasks"] = run_job_type(COMPILE, settings=job["settings"])
        except dukpy.JSRuntimeError as error:
            return 400, {"code": 400, "message": str(error)}
        return 200, {"id": f"job{len(self.jobs)}"}


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        unknown = 404, {"code": 404, "message": "not found"}
        self.answer(*self.server.answers.get(self.path.removeprefix("/api/v3/"), unknown))

    def do_POST(self):
        assert self.headers["Content-Type"] == "application/json"
        job = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.answer(*self.server.answers.get("jobs") or self.server.compile(job))

    def answer(self, status, content):
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def manager():
    with FakeManager() as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        yield server
        server.shutdown()


def run_task(task):
    """Do what a task says as a Worker would: the exit status."""
    (command,) = task["commands"]
    assert command["name"] == "exec"
    exe, args = command["parameters"]["exe"], command["parameters"]["args"]
    assert exe == "{lighttree}"
    return subprocess.run([sys.executable, "-m", "lighttree_batch", *args]).returncode


@pytest.mark.blender
def test_tasks_run_side_by_side_come_to_what_an_undisturbed_batch_does(shot, tmp_path, manager):
    calm, farmed = tmp_path / "calm", tmp_path / "farmed"
    command = prepare(calm, shot)
    text = (calm / "jobs.toml").read_text().replace("[16, 256]", "[16]").replace("[1, 10]", "[1]")
    (calm / "jobs.toml").write_text(text)
    subprocess.run(command, check=True)
    # Of the other only a few images are to do, and nothing that is made of them is there.
    shutil.copytree(calm, farmed)
    results = farmed / "results"
    missing = ["shot-f1/lighttree-16spp-seed1", "shot-f1/cycles-16spp-seed1"]
    missing += [f"shot-f1/reference-chunks/{name}" for name in ("lighttree-2", "cycles-7")]
    for path in (*(results / f"{name}.exr" for name in missing), *results.rglob("reference*.exr")):
        path.unlink()
    for name in ("report.html", "run.json", "results.csv"):
        (results / name).unlink()

    manager.answers["configuration/variables/workers/linux"] = 200, {"lighttree": {}}
    submit = [*command[:-1], str(farmed / "jobs.toml"), "--flamenco", manager.url]
    told = subprocess.run(submit, check=True, capture_output=True, text=True)
    assert told.stdout == f"{manager.url}/app/jobs/job1\n"
    assert "Submitted 4 images." in told.stderr
    *tasks, last = manager.jobs[0]["tasks"]
    assert {task["name"] for task in tasks} == set(missing)
    assert [task["name"] for task in last["dependencies"]] == [task["name"] for task in tasks]

    with ThreadPoolExecutor(2) as workers:
        assert list(workers.map(run_task, tasks)) == [0] * 4
    assert not (results / "run.json").exists() and not (results / "report.html").exists()
    assert not list(results.rglob("*.log"))
    assert run_task(last) == 0
    assert_same_images(calm, farmed)
    assert (results / "report.html").exists()
    again = subprocess.run(submit, check=True, capture_output=True, text=True)
    assert "Nothing is left to render; `lighttree batch" in again.stderr
    assert len(manager.jobs) == 1


def test_the_job_type_says_what_its_settings_are():
    told = run_job_type("JOB_TYPE")
    assert told["label"] and told["description"]
    for setting in told["settings"]:
        assert setting["key"] and setting["type"] == "string" and setting["required"]
        assert setting.get("visible", "visible") in ("visible", "hidden", "submission", "web")


def test_a_job_without_units_is_refused_by_the_job_type():
    for settings in ({}, {"job_file": "j.toml"}, {"job_file": "j.toml", "units": " \n"}):
        with pytest.raises(dukpy.JSRuntimeError, match="submit it with: lighttree batch JOBS"):
            run_job_type(COMPILE, settings=settings)
    settings = {"job_file": "j.toml", "units": "\nab s/x\n\ncd s/y z\n", "lighttree": ""}
    *tasks, _ = run_job_type(COMPILE, settings=settings)
    assert [task["name"] for task in tasks] == ["s/x", "s/y z"]
    assert tasks[1]["commands"][0]["parameters"] == {
        "exe": "lighttree",
        "args": ["batch", "j.toml", "--unit", "cd"],
    }


JOB = """
methods = ["lighttree", "cycles"]
seconds = [1, 4]
seeds = 1
resolution = [12, 8]
threads = 1
[[scene]]
files = ["a.blend", "b.blend"]
"""


@pytest.fixture
def job(tmp_path, monkeypatch):
    """A job of two scenes that were inspected; renders take 50 ms, and are of noise."""
    monkeypatch.setattr(one_unit.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(LocalWorker, "render_file", render_noise)
    monkeypatch.setattr(facts, "are_kernels_compiled", lambda: True)
    for name in ("a", "b"):
        (tmp_path / f"{name}.blend").write_text(name)
    (tmp_path / "jobs.toml").write_text(JOB)
    job = read_job(tmp_path / "jobs.toml")
    for source in job.sources:
        found = {"camera": "c", "frame": 1, "lights": {}, "triangles": 0, "not_modelled": []}
        found |= {"files": [], "fixed_files": [], "file_sha256": facts.hash_files([source.file])}
        found |= {"renderers": facts.describe_renderers(), "versions": facts.describe_packages()}
        (job.out / source.name).mkdir(parents=True)
        facts.save_facts(found, source, job.out / source.name)
    return job


at_work: list[dict] = []


def render_noise(worker, file, header, advance):
    assert not at_work, "another render beside a timed one"
    at_work.append(header)
    time.sleep(0.05)
    pixels = np.random.default_rng(header["seed"]).random((3, 8, 12), np.float32)
    told = {"machine": facts.describe_machine()}
    write_exr(worker.unfinished, dict(zip("RGB", pixels, strict=True)), header | told)
    at_work.remove(header)


def list_units(job):
    return [
        unit
        for source in job.sources
        for unit in plan_scene(
            source, facts.load_facts(job.out / source.name), job.out, job.options
        ).units
    ]


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
        Path(worker.processes["CYCLES"]._log).write_text("what Blender printed")
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


def submit(job, manager, *options):
    path = job.out.parent / "jobs.toml"
    return main(["batch", str(path), "--flamenco", manager.url, *options])


def test_what_is_to_do_is_submitted_in_the_order_of_the_plan(job, manager, capsys):
    units = list_units(job)
    render(job, units[1])
    assert submit(job, manager, "--worker-tag", "fast") == 0
    (submitted,) = manager.jobs
    assert (submitted["name"], submitted["type"]) == ("LightTree jobs", "lighttree-batch")
    assert (submitted["type_etag"], submitted["worker_tag"]) == ("e1", "id of fast")
    assert submitted["submitter_platform"] in ("linux", "windows", "darwin")
    assert submitted["settings"]["job_file"] == str(job.out.parent / "jobs.toml")
    assert submitted["settings"]["lighttree"] == "lighttree"
    keys = [task["commands"][0]["parameters"]["args"][-1] for task in submitted["tasks"][:-1]]
    assert keys == [unit.header["key"][:16] for unit in units if unit is not units[1]]
    assert find_images(job.out) == {str(units[1].path.relative_to(job.out))}
    assert capsys.readouterr().out == f"{manager.url}/app/jobs/job1\n"


@pytest.mark.parametrize(
    ("path", "answer", "sentence"),
    [
        ("jobs/type/lighttree-batch", None, r"no job type .*: copy .*batch\.js into the folder"),
        ("jobs/type/lighttree-batch", (200, b"<html>"), "is no Flamenco Manager"),
        ("jobs/type/lighttree-batch", (200, []), "is no Flamenco Manager"),
        ("jobs/type/lighttree-batch", (404, b"<html>"), "is no Flamenco Manager"),
        ("jobs/type/lighttree-batch", (500, {"message": "on fire"}), "refuses: on fire"),
        ("jobs", (412, {"code": 412, "message": "outdated"}), "refuses: outdated"),
        ("worker-mgt/tags", (200, {}), "has no worker tag 'fast'; there are none"),
    ],
)
def test_what_a_manager_cannot_do_is_told_in_a_sentence(
    job, manager, capsys, path, answer, sentence
):
    manager.answers[path] = answer or (404, {"code": 404, "message": "no such job type known"})
    assert submit(job, manager, "--worker-tag", "fast") == 2
    (told,) = capsys.readouterr().err.splitlines()
    assert re.match(f"lighttree: {manager.url} .*{sentence}", told)


@pytest.mark.parametrize("address", ["ftp://host", "http://", "http://[", "http://x:y"])
def test_what_is_no_address_is_refused(job, address):
    with pytest.raises(InputError, match="is no address of a Manager; one is http://"):
        farm.submit(job, job.out, address, "", None)


def test_managers_that_do_not_answer_and_batches_of_any_cores_are_refused(
    job, manager, capsys, monkeypatch
):
    monkeypatch.setattr(farm, "TIMEOUT_S", 0.2)
    with silence() as silent:
        assert submit(job, silent) == 2
    assert "no Flamenco Manager can be reached (timed out)" in capsys.readouterr().err
    path = job.out.parent / "jobs.toml"
    assert main(["batch", str(path), "--worker-tag", "x"]) == 2
    path.write_text(JOB.replace("threads = 1", ""))
    assert submit(job, manager) == 2
    assert "say how many threads all use, like threads = 8" in capsys.readouterr().err
    assert not manager.jobs


@contextmanager
def silence():
    """A server that accepts and never says a word."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.url = f"127.0.0.1:{server.server_port}"
    with server:
        yield server
