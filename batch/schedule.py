"""Render the units of a batch with a crew of workers, here or on other machines.

A worker renders one unit at a time. What it renders, and when, follows from two rules, so that
seconds can be compared: a timed unit has its machine for itself, and all renders of a scene are
made by one kind of CPU; parts of references may be made by any. A unit that fails is noted, and the
batch goes on.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple, Protocol

from .images import ImageError
from .methods import InputError
from .plan import ScenePlan, Unit
from .process import Progress, RenderError
from .references import write_references

RETRIES = 2
LOOK_S = 1.0  # how often to look for new workers

Advance = Callable[[float, str], None]


class WorkerLost(Exception):
    """A worker that can render no more; what it had in hand is for another one."""


class Worker(Protocol):
    """What renders. machine: those of one machine share its cores. cpu: the model of these."""

    machine: str
    cpu: str

    def render(self, plan: ScenePlan, unit: Unit, advance: Advance) -> None:
        """Leave the unit's image in its place; `advance`, called often, ends it by raising."""


class Crew(AbstractContextManager, Protocol):
    """Workers who may come and go. patience_s: how long to wait for one that suits."""

    patience_s: float

    def find_new(self) -> Sequence[Worker]:
        """Those that came since it was last asked."""


class Task(NamedTuple):
    """A unit and the plan it is of."""

    plan: ScenePlan
    unit: Unit


class _Stopped(Exception):
    """Another worker's render cannot be gone on with, or somebody pressed Ctrl-C."""


class Schedule:
    """Renders those units of the plans that are to do, and averages the references.

    cpus: what made the renders that scenes have already, by folder. note: is told when a failure
    was added to a plan's entry.
    """

    def __init__(
        self,
        plans: Sequence[ScenePlan],
        todo: Sequence[Unit],
        cpus: dict[Path, str],
        crew: Crew,
        progress: Progress,
        note: Callable[[], None],
    ):
        self.plans, self.crew, self.progress, self.note = plans, crew, progress, note
        paths = {unit.path for unit in todo}
        tasks = [Task(plan, unit) for plan in plans for unit in plan.units if unit.path in paths]
        # What can be rendered side by side comes first, so workers seldom wait for a machine.
        self.tasks = deque(sorted(tasks, key=lambda task: task.unit.is_timed))
        self.cpus, self.losses = dict(cpus), Counter()
        self.seconds_done, self.seconds_all = 0.0, sum(unit.seconds for unit in todo)
        # The chunks that each scene's references still wait for.
        self.awaited = {
            plan.folder: paths & {unit.path for unit in plan.all_chunks} for plan in plans
        }
        self.workers: set[Worker] = set()
        self.running: dict[Worker, Unit] = {}
        self.seconds_running: dict[Worker, float] = {}  # how much of each worker's unit is done
        self.changed, self.error = threading.Condition(), None

    def run(self) -> None:
        """Render everything; raises what no other unit could go on after, like a full disk."""
        for plan in self.plans:
            if not self.awaited[plan.folder]:
                self._average(plan)
        if not self.tasks:
            return
        threads: list[threading.Thread] = []
        with self.crew:
            try:
                self._watch(threads)
            except BaseException as error:
                self.error = self.error or error
            with self.changed:
                self.changed.notify_all()
            for thread in threads:
                thread.join()
        if self.error:
            raise self.error

    def _watch(self, threads: list[threading.Thread]) -> None:
        """Put new workers to work, each in a thread, until all is done or nothing goes on."""
        stuck_since = None
        while (self.tasks or self.running) and not self.error:
            for worker in self.crew.find_new():
                self.workers.add(worker)
                threads.append(threading.Thread(target=self._work, args=(worker,)))
                threads[-1].start()
            with self.changed:
                if not self.error:
                    self.changed.wait(LOOK_S)
            stuck_since = (stuck_since or time.monotonic()) if self._is_stuck() else None
            if stuck_since and time.monotonic() - stuck_since >= self.crew.patience_s:
                self._give_up()

    def _work(self, worker: Worker) -> None:
        try:
            while task := self._take(worker):
                self._render(worker, task)
        except (WorkerLost, _Stopped):
            pass
        except BaseException as error:  # of whatever kind, it is for the main thread
            self.error = self.error or error
        finally:
            with self.changed:
                self.workers.discard(worker)
                self.changed.notify_all()

    def _take(self, worker: Worker) -> Task | None:
        """The next task that suits a worker; None once nothing is left to do."""
        with self.changed:
            while not self.error and (self.tasks or self.running):
                for number, task in enumerate(self.tasks):
                    if self._suits(worker, task):
                        del self.tasks[number]
                        self.running[worker] = task.unit
                        if not task.unit.is_chunk:
                            self.cpus[task.plan.folder] = worker.cpu
                        return task
                self.changed.wait()
        return None

    def _suits(self, worker: Worker, task: Task) -> bool:
        beside = [u for other, u in self.running.items() if other.machine == worker.machine]
        is_free = not beside if task.unit.is_timed else not any(unit.is_timed for unit in beside)
        cpu = worker.cpu if task.unit.is_chunk else self.cpus.get(task.plan.folder, worker.cpu)
        return is_free and cpu == worker.cpu

    def _render(self, worker: Worker, task: Task) -> None:
        plan, unit = task

        def advance(fraction: float, text: str) -> None:
            if self.error:
                raise _Stopped
            self.seconds_running[worker] = fraction * unit.seconds
            # A list is made at once; others come and go while a sum is.
            seconds = self.seconds_done + sum(list(self.seconds_running.values()))
            name = f"{plan.entry['name']} {unit.path.stem}"
            self.progress(seconds / self.seconds_all, f"{name}: {text}")

        try:
            with self._noting_failure(plan, unit.path.stem):
                worker.render(plan, unit, advance)
        except WorkerLost as loss:
            self._give_back(task, loss)
            raise
        else:
            self._finish(task)
        finally:
            with self.changed:
                self.seconds_running.pop(worker, None)
                del self.running[worker]
                self.changed.notify_all()

    def _give_back(self, task: Task, loss: WorkerLost) -> None:
        """Let another worker try; a unit that takes its worker along each time has failed."""
        self.losses[task.unit.path] += 1
        if self.losses[task.unit.path] > RETRIES:
            with self._noting_failure(task.plan, task.unit.path.stem):
                raise RenderError(str(loss))
            self._finish(task)
            return
        with self.changed:
            self.tasks.appendleft(task)
            at_work = {unit.path for unit in self.running.values()} - {task.unit.path}
            if not any(u.path in at_work or u.path.exists() for u in task.plan.renders):
                self.cpus.pop(task.plan.folder, None)  # no image binds the scene to it as yet

    def _finish(self, task: Task) -> None:
        """Count a unit as done, for better or worse; the last of its chunks makes a reference."""
        with self.changed:
            self.seconds_done += task.unit.seconds
            awaited = self.awaited[task.plan.folder]
            is_last_chunk = awaited == {task.unit.path}
            awaited.discard(task.unit.path)
        if is_last_chunk:
            self._average(task.plan)

    def _average(self, plan: ScenePlan) -> None:
        """Make the references of whatever chunks there are."""
        with self._noting_failure(plan, "reference"):
            done = {
                engine: [unit.path for unit in units if unit.path.exists()]
                for engine, units in plan.chunks.items()
            }
            write_references(plan.folder, plan.reference_header, done)

    def _is_stuck(self) -> bool:
        """Whether nothing goes on, nor will unless another worker comes."""
        with self.changed:
            return bool(self.tasks) and not any(
                worker in self.running or self._suits(worker, task)
                for worker in self.workers
                for task in self.tasks
            )

    def _give_up(self) -> None:
        """Note all that is left as failed; without a worker, raise."""
        if not self.workers:
            raise RenderError("No worker is left; start one, and run the same command again.")
        with self.changed:
            tasks, self.tasks = list(self.tasks), deque()
        for folder, number in Counter(task.plan.folder for task in tasks).items():
            plan = next(task.plan for task in tasks if task.plan.folder == folder)
            with self._noting_failure(plan, f"{number} renders"):
                raise RenderError(
                    f"The others of this scene were made by another CPU, {self.cpus[folder]}; go "
                    "on there, or choose another folder."
                )
        for task in tasks:
            self._finish(task)

    @contextmanager
    def _noting_failure(self, plan: ScenePlan, name: str) -> Iterator[None]:
        try:
            yield
        except (RenderError, InputError, ImageError) as error:
            with self.changed:
                plan.entry["failed"].append(f"{name}: {error}")
                self.note()
