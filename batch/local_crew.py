"""Workers on this machine.

Each unit is rendered by a process of its own, so nothing that one leaves behind, in memory or in
Blender, is there when the next is measured. A process that dies is started again; a unit that keeps
killing its process has failed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .facts import describe_machine
from .plan import ScenePlan, Unit
from .process import ProcessDied, RenderProcess
from .schedule import RETRIES, Advance


class LocalWorker:
    """A process at a time, and where its unfinished image goes."""

    machine = "here"

    def __init__(self, number: int, workspace: Path, log: Path):
        self.cpu = describe_machine()["cpu"]
        self.unfinished = workspace / f"unit-{number}.exr"
        self.process = RenderProcess(log)

    def render(self, plan: ScenePlan, unit: Unit, advance: Advance) -> None:
        self.render_file(plan.file, unit.header, advance)
        unit.path.parent.mkdir(parents=True, exist_ok=True)
        os.replace(self.unfinished, unit.path)

    def render_file(self, file: str, header: dict, advance: Advance) -> None:
        """Render to `unfinished`."""
        job = {"do": "render", "file": file, "header": header, "asked_at": time.time()}
        job |= {"out": str(self.unfinished.absolute())}
        with self.process:
            ask_again(self.process, job, advance, header["budget"].get("seconds", 0))


class LocalCrew:
    """So many workers, from the beginning to the end."""

    patience_s = 0.0

    def __init__(self, size: int, workspace: Path, log: Path):
        self.workers = [LocalWorker(number, workspace, log) for number in range(size)]
        self.new = self.workers

    def __enter__(self) -> LocalCrew:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing: each process has ended with its unit."""

    def find_new(self) -> Sequence[LocalWorker]:
        new, self.new = self.new, []
        return new


def ask_again(process: RenderProcess, *job: Any) -> Any:
    """What `process` answers; if it dies, it is asked again twice."""
    for _ in range(RETRIES):
        try:
            return process.ask(*job)
        except ProcessDied:
            continue
    return process.ask(*job)
