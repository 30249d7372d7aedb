"""Render the units of a batch: one after another, or side by side where none is timed.

Every worker is a pair of processes, one for each engine, so that neither's memory counts as the
other's. A process that dies is started again; a unit that keeps killing its process is noted as
failed, and the batch goes on.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

from .images import ImageError
from .methods import CYCLES, LIGHTTREE, InputError
from .plan import ScenePlan, Unit
from .process import ProcessDied, Progress, RenderError, RenderProcess
from .references import write_references

RETRIES = 2


class _Stopped(Exception):
    """Another worker's render cannot be gone on with, or somebody pressed Ctrl-C."""


class Worker:
    """A pair of processes, and where their unfinished image goes."""

    def __init__(self, number: int, workspace: Path, log: Path):
        self.unfinished = workspace / f"unit-{number}.exr"
        self.processes = {engine: RenderProcess(log) for engine in (LIGHTTREE, CYCLES)}
        self.seconds = 0.0  # how much of its unit is done


class Schedule:
    """Renders those units of the plans that are to do, and averages the references.

    note: is told when a failure was added to a plan's entry.
    """

    def __init__(
        self,
        plans: Sequence[ScenePlan],
        todo: Sequence[Unit],
        workers: Sequence[Worker],
        progress: Progress,
        note: Callable[[], None],
    ):
        self.plans, self.workers, self.progress, self.note = plans, workers, progress, note
        self.todo = {unit.path for unit in todo}
        self.seconds_done, self.seconds_all = 0.0, sum(unit.seconds for unit in todo)
        # The chunks that each scene's references still wait for.
        self.awaited = {
            plan.folder: self.todo & {unit.path for unit in plan.all_chunks} for plan in plans
        }
        self.lock, self.stopping = threading.Lock(), False

    def run(self) -> None:
        """Render everything; raises what no other unit could go on after, like a full disk."""
        with ExitStack() as stack:
            for worker in self.workers:
                for process in worker.processes.values():
                    stack.enter_context(process)
            for plan in self.plans:
                if not self.awaited[plan.folder]:
                    self._average(plan)
            tasks = [(p, unit) for p in self.plans for unit in p.units if unit.path in self.todo]
            if len(self.workers) > 1:  # few changes between alone and side by side
                tasks.sort(key=lambda task: not task[1].is_timed)
            for is_timed, group in groupby(tasks, key=lambda task: task[1].is_timed):
                self._run_group(deque(group), self.workers[: 1 if is_timed else None])

    def _run_group(self, tasks: deque[tuple[ScenePlan, Unit]], workers: Sequence[Worker]) -> None:
        def work(worker: Worker) -> None:
            while not self.stopping:
                try:
                    plan, unit = tasks.popleft()
                except IndexError:
                    return
                self._render(worker, plan, unit)

        if len(workers) == 1:
            return work(workers[0])
        with ThreadPoolExecutor(len(workers)) as pool:
            threads = [pool.submit(work, worker) for worker in workers]
            try:
                for thread in as_completed(threads):
                    thread.result()
            except BaseException:
                self.stopping = True
                raise

    def _render(self, worker: Worker, plan: ScenePlan, unit: Unit) -> None:
        def advance(fraction: float, text: str) -> None:
            if self.stopping:
                raise _Stopped
            worker.seconds = fraction * unit.seconds
            seconds = self.seconds_done + sum(other.seconds for other in self.workers)
            name = f"{plan.entry['name']} {unit.path.stem}"
            self.progress(seconds / self.seconds_all, f"{name}: {text}")

        job = {"do": "render", "file": plan.file, "header": unit.header}
        job |= {"out": str(worker.unfinished.absolute())}
        process = worker.processes[unit.header["settings"]["engine"]]
        with self._noting_failure(plan, unit.path.stem):
            ask_again(process, job, advance, unit.header["budget"].get("seconds", 0))
            unit.path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(worker.unfinished, unit.path)
        with self.lock:
            self.seconds_done, worker.seconds = self.seconds_done + unit.seconds, 0.0
            awaited = self.awaited[plan.folder]
            is_last_chunk = awaited == {unit.path}
            awaited.discard(unit.path)
        if is_last_chunk:
            self._average(plan)

    def _average(self, plan: ScenePlan) -> None:
        """Make the references of whatever chunks there are."""
        with self._noting_failure(plan, "reference"):
            done = {
                engine: [unit.path for unit in units if unit.path.exists()]
                for engine, units in plan.chunks.items()
            }
            write_references(plan.folder, plan.reference_header, done)

    @contextmanager
    def _noting_failure(self, plan: ScenePlan, name: str) -> Iterator[None]:
        try:
            yield
        except (RenderError, InputError, ImageError) as error:
            with self.lock:
                plan.entry["failed"].append(f"{name}: {error}")
                self.note()


def ask_again(process: RenderProcess, *job: Any) -> Any:
    """What `process` answers; if it dies, it is asked again twice."""
    for _ in range(RETRIES):
        try:
            return process.ask(*job)
        except ProcessDied:
            continue
    return process.ask(*job)
