"""Workers on this machine.

Each is a pair of processes, one for each engine, so that neither's memory counts as the other's.
A process that dies is started again; a unit that keeps killing its process has failed.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .facts import describe_machine
from .methods import CYCLES, LIGHTTREE
from .plan import ScenePlan, Unit
from .process import ProcessDied, RenderProcess
from .schedule import RETRIES, Advance


class LocalWorker:
    """A pair of processes, and where their unfinished image goes."""

    machine = "here"

    def __init__(self, number: int, workspace: Path, log: Path):
        self.cpu = describe_machine()["cpu"]
        self.unfinished = workspace / f"unit-{number}.exr"
        self.processes = {engine: RenderProcess(log) for engine in (LIGHTTREE, CYCLES)}

    def render(self, plan: ScenePlan, unit: Unit, advance: Advance) -> None:
        self.render_file(plan.file, unit.header, advance)
        unit.path.parent.mkdir(parents=True, exist_ok=True)
        os.replace(self.unfinished, unit.path)

    def render_file(self, file: str, header: dict, advance: Advance) -> None:
        """Render to `unfinished`."""
        job = {"do": "render", "file": file, "header": header}
        job |= {"out": str(self.unfinished.absolute())}
        process = self.processes[header["settings"]["engine"]]
        ask_again(process, job, advance, header["budget"].get("seconds", 0))

    def close(self) -> None:
        """End the processes, whatever they are doing."""
        for process in self.processes.values():
            process.close()


class LocalCrew:
    """So many workers, from the beginning to the end."""

    patience_s = 0.0

    def __init__(self, size: int, workspace: Path, log: Path):
        self.workers = [LocalWorker(number, workspace, log) for number in range(size)]
        self.new = self.workers

    def __enter__(self) -> LocalCrew:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.workers:
            worker.close()

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
