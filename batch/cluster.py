"""A crew on other machines: one worker for each worker of a dask.distributed scheduler.

Units go to the machines one by one, as `schedule.py` chooses, and images come back as the bytes of
their files. A scene is read where it is if a worker finds the same files under the same paths, in a
shared folder; if not, it is sent, once to each worker.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import Client, KilledWorker, Security
from distributed.comm import CommClosedError

from . import cluster_worker
from .facts import describe_renderers
from .images import replacing
from .methods import InputError
from .plan import ScenePlan, Unit
from .process import TICK_S, RenderError
from .schedule import Advance, WorkerLost

CONNECT_S = 10
PIECE_BYTES = 2**25


class ClusterCrew:
    """The workers of a scheduler, who may come and go.

    num_threads: what renders may use; a machine with fewer cores is left out. tell: is told of
    workers that are left out.
    """

    patience_s = 60.0

    def __init__(
        self, address: str, security: Security, num_threads: int, tell: Callable[[str], None]
    ):
        self.address, self.security = address, security
        self.num_threads, self.tell = num_threads, tell
        self.present: set[str] = set()
        self.workers: dict[str, RemoteWorker] = {}

    def __enter__(self) -> ClusterCrew:
        try:
            self.client = Client(
                self.address, security=self.security, timeout=CONNECT_S, set_as_default=False
            )
        except OSError as error:
            raise InputError(
                f"{self.address}: no scheduler answers there; start it with `lighttree scheduler`, "
                "and give the same certificates to all, if any."
            ) from error
        # Of this crew alone, so that several batches do not hear of each other.
        self.topic = f"lighttree-{uuid.uuid4()}"
        self.client.subscribe_topic(self.topic, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()

    def find_new(self) -> Sequence[RemoteWorker]:
        if self.client.status != "running":
            raise RenderError(f"{self.address}: the scheduler is gone; run the same command again.")
        before = self.present
        self.present = set(self.client.scheduler_info(n_workers=-1)["workers"])
        new = [worker for address in self.present - before if (worker := self._meet(address))]
        self.workers |= {worker.address: worker for worker in new}
        return new

    def _meet(self, address: str) -> RemoteWorker | None:
        """A worker that can do this batch's renders exactly as this machine would."""
        try:
            found = self.client.run(cluster_worker.introduce, workers=[address])[address]
        except Exception as error:  # whatever its LightTree has to say, or that it has none
            self.tell(f"{address} is left out: no LightTree answers there ({error}).")
            return None
        theirs, ours = found["renderers"], describe_renderers()
        if theirs != ours:
            theirs, ours = (" and ".join(names.values()) for names in (theirs, ours))
            self.tell(f"{address} is left out: it renders with {theirs}, not with {ours}.")
        elif found["cores"] < self.num_threads:
            self.tell(
                f"{address} is left out: it has {found['cores']} cores, and renders use "
                f"{self.num_threads} threads; give fewer."
            )
        else:
            return RemoteWorker(self, address, found)
        return None

    def _hear(self, event: tuple[float, dict]) -> None:
        _, message = event
        if worker := self.workers.get(message["worker"]):
            worker.heard = message["fraction"], message["text"]


class RemoteWorker:
    """A worker of the scheduler's, which does one thing at a time."""

    def __init__(self, crew: ClusterCrew, address: str, found: dict):
        self.crew, self.address = crew, address
        self.machine, self.cpu = found["machine"], found["cpu"]
        self.heard = 0.0, ""
        self.scenes: dict[str, str] = {}  # where it has them, by hash

    def render(self, plan: ScenePlan, unit: Unit, advance: Advance) -> None:
        self.heard = 0.0, "Waiting"
        file = self._find_scene(plan, unit.header["settings"]["file_sha256"], advance)
        self.heard = 0.0, "Starting"
        image = self._ask(advance, cluster_worker.render, file, unit.header, self.crew.topic)
        unit.path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(unit.path) as temp:
            temp.write_bytes(image)

    def _find_scene(self, plan: ScenePlan, sha256: str, advance: Advance) -> str:
        """Where the worker has the scene, which is sent to it if it has it nowhere."""
        if sha256 not in self.scenes:
            files = [plan.file, *plan.files]
            where = self._ask(advance, cluster_worker.find_shared, files, sha256)
            self.scenes[sha256] = where or self._send(plan, sha256, advance)
        return self.scenes[sha256]

    def _send(self, plan: ScenePlan, sha256: str, advance: Advance) -> str:
        if plan.fixed_files:
            raise InputError(
                f"{plan.file} uses {plan.fixed_files[0]} by an absolute path, so it cannot be sent "
                "to other machines: make its paths relative in Blender (File > External Data), or "
                "put it into a folder that all machines share."
            )
        paths = [Path(path) for path in (plan.file, *plan.files) if os.path.isfile(path)]
        root = os.path.commonpath([path.parent for path in paths])
        names = [path.relative_to(root).as_posix() for path in paths]
        size, sent = sum(path.stat().st_size for path in paths), 0
        for name, path in zip(names, paths, strict=True):
            for offset, piece in _cut(path):
                self.heard = 0.0, f"Sending the scene, {sent / max(size, 1):.0%}"
                self._ask(advance, cluster_worker.receive, sha256, name, offset, piece)
                sent += len(piece)
        return self._ask(advance, cluster_worker.find_sent, names, sha256)

    def _ask(self, advance: Advance, function: Callable[..., Any], *args: Any) -> Any:
        """What a function returns on the worker; raises as it does, or WorkerLost."""
        future = self.crew.client.submit(
            function, *args, workers=[self.address], allow_other_workers=False, pure=False
        )
        lost = WorkerLost(f"{self.address}: the worker is gone.")
        try:
            while True:
                with suppress(TimeoutError):
                    return future.result(TICK_S)
                if self.address not in self.crew.present:
                    raise lost
                advance(*self.heard)
        except (CancelledError, CommClosedError, KilledWorker):
            raise lost from None
        except OSError as error:  # of its disk, which is not ours
            raise WorkerLost(f"{self.address}: {error}") from error
        finally:
            future.cancel()  # which also ends it if it is under way


def _cut(path: Path) -> Iterator[tuple[int, bytes]]:
    """A file in pieces, each with its offset."""
    with open(path, "rb") as content:
        while piece := content.read(PIECE_BYTES):
            yield content.tell() - len(piece), piece
