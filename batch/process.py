"""The parent's end of a render process (`worker.py` is the other): start it, ask it, kill it."""

from __future__ import annotations

import errno
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, TextIO

from .methods import InputError

Progress = Callable[[float, str], None]

TICK_S = 0.25
TAIL_LINES = 16
PATIENCE_S = 0.5  # for a process that was told to end

_running: set[subprocess.Popen] = set()
_starting = threading.Lock()


class RenderError(RuntimeError):
    """A job that went wrong; the message is one sentence."""


class ProcessDied(RenderError):
    """The process ended before its job was done.

    status: as of subprocess.Popen. output: the last lines that it printed.
    """

    def __init__(self, sentence: str, status: int = 0, output: Sequence[str] = ()):
        super().__init__("\n".join([sentence, *(f"  {line}" for line in output)]))
        self.status, self.output = status, output

    @property
    def is_crash(self) -> bool:
        """Whether the program is to blame, and nobody who killed it."""
        return self.status < 0 and self.status != -signal.SIGKILL


class RenderProcess:
    """A child process with Blender in it, started at its first job and again should it die.

    log: where its output goes, without one to a temporary file, and if LIGHTTREE_DEBUG is set, to
    ours.
    """

    def __init__(self, log: Path | None = None):
        self.versions: dict[str, str] = {}
        self._log, self._output, self._doing = log, None, ""
        self._process: subprocess.Popen | None = None
        self._answers: queue.Queue[dict | None] = queue.Queue()

    def __enter__(self) -> RenderProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process and those it started, whatever they are doing."""
        if process := self._process:
            self._process = None
            with suppress(OSError):
                process.stdin.close()  # tells it to end; only it knows its own processes
            with suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
            process.kill()
            process.wait()
            self._output.close()
            _running.discard(process)

    def ask(self, job: dict, progress: Progress | None = None, seconds: float = 0) -> Any:
        """Have a job done and return its result; raise InputError, RenderError or OSError.

        seconds: how long rendering will take, if known; moves progress between the messages.
        Before it, progress is of whatever else takes its time.
        """
        text, fraction, rendering_since = "", 0.0, None
        if self._process is None:
            text = "Starting Blender"
            self._start()
        self._send(job)
        while True:
            message = self._receive(TICK_S)
            self.versions = message.get("ready", self.versions)
            if "done" in message:
                return message["done"]
            if "failed" in message:
                _raise(message)
            text = self._doing = message.get("text", text)
            fraction = message.get("fraction", fraction)
            if "renders" in message:
                rendering_since = time.monotonic()
            if rendering_since and seconds:
                fraction = max(fraction, (time.monotonic() - rendering_since) / seconds)
            if progress:
                progress(min(fraction, 1.0), text)

    def _start(self) -> None:
        self._answers = queue.Queue()
        self._output = self._open_output()
        with _starting:
            is_shown = not self._log and os.environ.get("LIGHTTREE_DEBUG")
            # In a session of its own the child does not see Ctrl-C: it is ours to stop it.
            self._process = subprocess.Popen(
                _command(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=None if is_shown else self._output,
                text=True,
                encoding="utf-8",
                start_new_session=True,
            )
            _running.add(self._process)
        streams = (self._process.stdout, self._answers)
        threading.Thread(target=_read_answers, args=streams, daemon=True).start()

    def _open_output(self) -> TextIO:
        return open(self._log, "a") if self._log else tempfile.TemporaryFile("w+", errors="replace")

    def _send(self, job: dict) -> None:
        try:
            self._process.stdin.write(json.dumps(job) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            self._raise_ended()

    def _receive(self, timeout_s: float) -> dict:
        """The next message, or {} if none comes in time."""
        try:
            message = self._answers.get(timeout=timeout_s)
        except queue.Empty:
            return {}
        if message is None:
            self._raise_ended()
        return message

    def _raise_ended(self) -> None:
        status = self._process.wait()
        tail = [] if self._log else _read_tail(self._output)
        self.close()
        doing = f" while it was at: {self._doing}" if self._doing else ""
        more = f"{self._log} tells more" if self._log else "--debug shows all of its output"
        sentence = f"The render process {_describe_end(status)}{doing}; {more}."
        raise ProcessDied(sentence, status, tail)


def _read_tail(output: TextIO) -> list[str]:
    """The last lines of what a process has printed."""
    output.seek(0)
    lines = [line.rstrip() for line in output if line.strip()]
    # What Python tells of a crash ends with all that it has loaded.
    return [line for line in lines if not line.startswith("Extension modules")][-TAIL_LINES:]


def _describe_end(status: int) -> str:
    if status >= 0:
        return f"ended unexpectedly (exit status {status})"
    try:
        name = signal.Signals(-status).name
    except ValueError:  # one of those without a name
        name = f"signal {-status}"
    if name == "SIGKILL":
        return "was killed (SIGKILL), perhaps for want of memory"
    return f"crashed ({name})"


def kill_all() -> None:
    """Kill every process of a parent that is about to end itself; none can be started any more."""
    _starting.acquire()
    for process in list(_running):
        process.kill()
        process.wait()


def _raise(message: dict) -> None:
    if message["disk_full"]:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), message["failed"])
    raise (InputError if message["bad_input"] else RenderError)(message["failed"])


def running_blender() -> ModuleType | None:
    """bpy, if this Python is inside the program Blender."""
    bpy = sys.modules.get("bpy")
    return bpy if bpy and bpy.app.binary_path else None


def _command() -> list[str]:
    """How to start a worker: with this Python, or where that is Blender's, with Blender."""
    blender = running_blender()
    if blender is None:
        # -P: a module that lies in the user's folder is not for us to run.
        return [sys.executable, "-P", "-m", f"{__package__}.worker"]
    code = f"import sys; sys.path[:0] = {sys.path}; from {__package__}.worker import main; main()"
    options = ["--background", "--factory-startup", "--disable-autoexec"]
    options += ["--python-exit-code", "1"]
    return [blender.app.binary_path, *options, "--python-expr", code]


def _read_answers(stream: TextIO, answers: queue.Queue[dict | None]) -> None:
    with stream:
        for line in stream:
            # Blender greets before the worker runs, and a killed worker leaves half a line.
            if line.startswith("{") and line.endswith("\n"):
                answers.put(json.loads(line))
    answers.put(None)
