"""Batches by way of Flamenco: its job type, what is submitted to a Manager, units one by one."""

import json
import re
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import dukpy
import numpy as np
import pytest
from inspected_job import JOB, list_units, write_job
from shot_batch import assert_same_images, find_images, prepare

from lighttree_batch import facts, farm
from lighttree_batch.__main__ import main
from lighttree_batch.images import write_exr
from lighttree_batch.methods import InputError

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
    *tasks, last = run_job_type(COMPILE, settings=settings)
    assert [task["name"] for task in tasks] == ["s/x", "s/y z"]
    assert [task["name"] for task in last["dependencies"]] == ["s/x", "s/y z"]
    assert tasks[1]["commands"][0]["parameters"] == {
        "exe": "lighttree",
        "args": ["batch", "j.toml", "--unit", "cd"],
    }


@pytest.fixture
def job(tmp_path, monkeypatch):
    monkeypatch.setattr(facts, "are_kernels_compiled", lambda: True)
    return write_job(tmp_path)


def submit(job, manager, *options):
    path = job.out.parent / "jobs.toml"
    return main(["batch", str(path), "--flamenco", manager.url, *options])


def test_what_is_to_do_is_submitted_in_the_order_of_the_plan(job, manager, capsys):
    units = list_units(job)
    write_exr(units[16].path, {"Y": np.ones((2, 2))}, units[16].header)
    assert submit(job, manager, "--worker-tag", "fast") == 0
    (submitted,) = manager.jobs
    assert (submitted["name"], submitted["type"]) == ("LightTree jobs", "lighttree-batch")
    assert (submitted["type_etag"], submitted["worker_tag"]) == ("e1", "id of fast")
    assert submitted["submitter_platform"] in ("linux", "windows", "darwin")
    assert submitted["settings"]["job_file"] == str(job.out.parent / "jobs.toml")
    assert submitted["settings"]["lighttree"] == "lighttree"
    keys = [task["commands"][0]["parameters"]["args"][-1] for task in submitted["tasks"][:-1]]
    assert keys == [unit.header["key"][:16] for unit in units if unit is not units[16]]
    assert find_images(job.out) == {str(units[16].path.relative_to(job.out))}
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
    path.write_text(JOB.replace("threads = 1", ""))
    assert submit(job, manager) == 2
    assert "say how many threads all use, like threads = 8" in capsys.readouterr().err
    assert not manager.jobs


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--worker-tag", "x"], "--worker-tag is for --flamenco"),
        (["--flamenco", "x", "--unit", "ab"], "--flamenco and --unit exclude each other"),
        (["--flamenco", "x", "--workers", "2"], "--workers is for this machine alone"),
        (["--unit", ""], "40 units have keys that begin with ''"),
    ],
)
def test_options_that_make_no_sense_are_refused(job, capsys, options, sentence):
    assert main(["batch", str(job.out.parent / "jobs.toml"), *options]) == 2
    assert sentence in capsys.readouterr().err


@contextmanager
def silence():
    """A server that accepts and never says a word."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.url = f"127.0.0.1:{server.server_port}"
    with server:
        yield server
