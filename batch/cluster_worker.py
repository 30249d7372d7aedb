"""What a batch has done on a worker of dask.distributed's; see `cluster.py` for the other end."""

from __future__ import annotations

import platform
import time
from datetime import datetime
from pathlib import Path

from distributed import get_worker
from distributed.worker import Worker

from .facts import describe_machine, describe_renderers, hash_files
from .local_crew import LocalWorker

TELL_S = 0.25
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Cancelled(Exception):
    """Nobody waits for the render any more."""


def introduce() -> dict:
    """What tells whether a worker suits: its machine, and what it renders with."""
    # Of the machine, not of a container on it: it is for its cores.
    machine = BOOT_ID.read_text().strip() if BOOT_ID.exists() else platform.node()
    return {"machine": machine, "renderers": describe_renderers(), **describe_machine()}


def find_shared(files: list[str], sha256: str) -> str | None:
    """The first of the files, which is the scene, if they are all here as they were hashed."""
    return files[0] if hash_files(files) == sha256 else None


def receive(sha256: str, name: str, offset: int, piece: bytes) -> None:
    """Write a piece of a file of a scene that is sent; name: with its folders."""
    path = _folder(sha256) / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "ab" if offset else "wb") as file:
        file.write(piece)


def find_sent(names: list[str], sha256: str) -> str:
    """Where the scene lies whose files were sent; the first of them is the scene."""
    files = [str(_folder(sha256) / name) for name in names]
    if hash_files(files) != sha256:
        raise OSError("a scene did not arrive as it was sent")
    return files[0]


def _folder(sha256: str) -> Path:
    """For the files of a scene; it is gone when the worker is."""
    return Path(get_worker().local_directory, "scenes", sha256)


def render(file: str, header: dict, topic: str) -> bytes:
    """The EXR of a unit; ends early when its future is cancelled or forgotten."""
    worker = get_worker()
    folder, key, told_at = Path(worker.local_directory), worker.get_current_task(), 0.0

    def advance(fraction: float, text: str) -> None:
        nonlocal told_at
        if _is_cancelled(worker, key):
            raise Cancelled
        if time.monotonic() - told_at >= TELL_S:
            told_at = time.monotonic()
            message = {"worker": worker.address, "fraction": fraction, "text": text}
            worker.log_event(topic, message)

    # For whoever started the worker.
    scene, method, seed = header["scene"], header["method"], header["seed"]
    print(f"{datetime.now():%H:%M:%S} {scene} {method} seed {seed}", flush=True)
    renders = LocalWorker(0, folder, folder / "log.txt")
    renders.render_file(file, header, advance)
    return renders.unfinished.read_bytes()


def _is_cancelled(worker: Worker, key: str) -> bool:
    task = worker.state.tasks.get(key)
    return task is None or task.state == "cancelled"
