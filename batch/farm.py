"""Submit a batch to Flamenco, the render manager: one task for each image that is still to do.

The Manager compiles the job with `flamenco/lighttree-batch.js`, which must be among its scripts.
"""

from __future__ import annotations

import json
import os
import platform
from http.client import HTTPException
from pathlib import Path
from typing import Any, NamedTuple
from urllib.error import HTTPError
from urllib.parse import quote, urlsplit
from urllib.request import ProxyHandler, Request, build_opener

from .experiment import plan_batch
from .jobs import Job
from .methods import InputError
from .process import Progress

JOB_TYPE = Path(__file__).with_name("flamenco") / "lighttree-batch.js"
PROGRAM = "lighttree"  # what Workers start, or the Manager's variable that says what
KEY_CHARACTERS = 16
TIMEOUT_S = 10
COMPILE_TIMEOUT_S = 60  # of jobs with many thousands of tasks
NOT_FOUND = 404


class Submission(NamedTuple):
    """What came of it. page: where the job is shown. failed: a sentence for each bad scene."""

    page: str
    num_units: int
    failed: list[str]


def submit(job: Job, file: Path, manager: str, tag: str, progress: Progress) -> Submission:
    """Have the Workers of a Manager, those with a tag if one is given, render a batch.

    Scenes are inspected here and now. Without a unit to do nothing is submitted.
    """
    is_timed = job.options.budget_kind == "seconds" or "seconds" in job.options.chunk_budget
    if is_timed and not job.options.threads:
        raise InputError(
            f"{file}: several machines will be timed, which may differ in cores; say how many "
            "threads all use, like threads = 8."
        )
    flamenco = _Flamenco(manager)
    submitted = flamenco.describe_job(tag)
    plans = plan_batch(job.sources, job.out, job.options, progress)
    failed = [f"{plan.entry['name']} {text}" for plan in plans for text in plan.entry["failed"]]
    units = [unit for plan in plans for unit in plan.units if unit.read_done() is None]
    if not units:
        return Submission("", 0, failed)
    lines = (
        f"{unit.header['key'][:KEY_CHARACTERS]} "
        f"{unit.path.relative_to(job.out).with_suffix('').as_posix()}"
        for unit in units
    )
    submitted["settings"] |= {"job_file": os.path.abspath(file), "units": "\n".join(lines)}
    answer = flamenco.ask("jobs", submitted | {"name": f"LightTree {file.stem}"})
    return Submission(f"{flamenco.url}/app/jobs/{answer['id']}", len(units), failed)


class _Flamenco:
    """A Manager; every question has an answer, or a sentence that tells why not."""

    def __init__(self, url: str):
        self.url = (url if "://" in url else f"http://{url}").rstrip("/")
        # A Manager is in the house, where a proxy for the world outside does not lead.
        self.opener = build_opener(ProxyHandler({}))
        try:
            parts = urlsplit(self.url)
            is_address = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
        except ValueError:
            is_address = False
        if not is_address:
            raise InputError(f"'{url}' is no address of a Manager; one is http://10.0.0.1:8080.")

    def describe_job(self, tag: str) -> dict:
        """A job without name and units, for this Manager as it is set up."""
        system = platform.system().lower()
        try:
            etag = self.ask(f"jobs/type/{JOB_TYPE.stem}")["etag"]
        except _NotFound:
            raise InputError(
                f"{self.url} has no job type {JOB_TYPE.stem}: copy {JOB_TYPE} into the folder "
                "'scripts' beside the program flamenco-manager; if that is new, start it again."
            ) from None
        has_variable = PROGRAM in self.ask(f"configuration/variables/workers/{system}")
        job = {"type": JOB_TYPE.stem, "type_etag": etag, "priority": 50}
        job |= {"submitter_platform": system}
        job |= {"settings": {"lighttree": f"{{{PROGRAM}}}" if has_variable else PROGRAM}}
        return job | ({"worker_tag": self.find_tag(tag)} if tag else {})

    def find_tag(self, name: str) -> str:
        """The id of a tag."""
        tags = {tag["name"]: tag["id"] for tag in self.ask("worker-mgt/tags").get("tags") or ()}
        if name not in tags:
            known = f"there are {', '.join(sorted(tags))}" if tags else "there are none"
            raise InputError(f"{self.url} has no worker tag '{name}'; {known}.")
        return tags[name]

    def ask(self, path: str, content: Any = None) -> Any:
        """What the Manager answers to a question, or to a job."""
        request = Request(f"{self.url}/api/v3/{quote(path)}")
        if content is not None:
            request.data = json.dumps(content).encode()
            request.add_header("Content-Type", "application/json")
        timeout_s = TIMEOUT_S if content is None else COMPILE_TIMEOUT_S
        try:
            with self.opener.open(request, timeout=timeout_s) as response:
                answer = json.load(response)
            if not isinstance(answer, dict):
                raise ValueError("it answers something else")
            return answer
        except HTTPError as error:
            try:
                sentence = json.load(error)["message"]
            except (OSError, HTTPException, ValueError, KeyError, TypeError):
                raise InputError(f"{self.url} is no Flamenco Manager ({error}).") from error
            kind = _NotFound if error.code == NOT_FOUND else InputError
            raise kind(f"{self.url} refuses: {sentence}") from error
        except (OSError, HTTPException) as error:
            why = getattr(error, "reason", error)
            raise InputError(f"{self.url}: no Flamenco Manager can be reached ({why}).") from error
        except ValueError as error:
            raise InputError(f"{self.url} is no Flamenco Manager ({error}).") from error


class _NotFound(InputError):
    """The Manager knows no such thing."""
