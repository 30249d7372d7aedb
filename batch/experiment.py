"""Run a comparison: render what a folder still lacks of it, average references, write the report.

Errors are measured by the report, not here.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from .images import ImageError, replacing
from .methods import CYCLES, LIGHTTREE, InputError
from .plan import Options, ScenePlan, Unit, name_scenes, plan_scene
from .process import Progress, RenderError, RenderProcess
from .references import write_references
from .report import write_report


@dataclass(frozen=True)
class Outcome:
    """What a comparison came to. failed: a sentence for each unit that could not be rendered."""

    report: Path
    num_rendered: int
    num_kept: int
    failed: list[str]


def run_comparison(
    files: Sequence[str | Path],
    out_dir: str | Path,
    options: Options,
    progress: Progress | None = None,
    command: str = "",
) -> Outcome:
    """Render what a comparison of `files` still lacks in `out_dir`, and write its report."""
    progress = progress or (lambda fraction, text: None)
    out_dir = Path(out_dir)
    log = out_dir / "log.txt"
    sources = name_scenes(files, options.cameras)
    with _workspace(out_dir) as workspace, ExitStack() as stack:
        plans, versions = _inspect(sources, out_dir, options, log, progress)
        # A process for each engine, so that neither's memory counts as the other's.
        processes = {
            engine: stack.enter_context(RenderProcess(log)) for engine in (LIGHTTREE, CYCLES)
        }
        run = _describe_run(options, command, versions)
        run["scenes"] = [plan.entry for plan in plans]
        units = [unit for plan in plans for unit in plan.units]
        todo = [unit for unit in units if not unit.is_done()]
        for unit in todo:  # what another run left under this name must not get into the report
            unit.path.unlink(missing_ok=True)
        renderer = _Renderer(processes, workspace, todo, progress, run, out_dir / "run.json")
        for plan in plans:
            renderer.render(plan, plan.all_chunks)
            renderer.average(plan)
            renderer.render(plan, plan.renders)
    failed = [f"{plan.entry['name']} {text}" for plan in plans for text in plan.entry["failed"]]
    num_missing = sum(not unit.path.exists() for unit in todo)
    return Outcome(
        report=write_report(out_dir, progress),
        num_rendered=len(todo) - num_missing,
        num_kept=len(units) - len(todo),
        failed=failed,
    )


def _inspect(
    sources: dict[str, tuple[str | Path, str | None]],
    out_dir: Path,
    options: Options,
    log: Path,
    progress: Progress,
) -> tuple[list[ScenePlan], dict[str, str]]:
    """Plan every scene; the process ends, and with it the memory that compiling took."""
    plans = []
    with RenderProcess(log) as process:
        for name, (file, camera) in sources.items():
            job = {"do": "inspect", "file": os.path.abspath(file), "camera": camera}
            facts = process.ask(job | {"common": options.common}, progress)
            if options.strict and facts["not_modelled"]:
                raise InputError(f"{file}: {facts['not_modelled'][0]} (refused by --strict)")
            plans.append(plan_scene(name, file, facts, out_dir / name, options))
        return plans, process.versions


class _Renderer:
    """Renders units that are to do; notes in run.json what goes wrong, and goes on."""

    def __init__(
        self,
        processes: dict[str, RenderProcess],
        workspace: Path,
        todo: list[Unit],
        progress: Progress,
        run: dict,
        run_json: Path,
    ):
        self.processes, self.workspace, self.progress = processes, workspace, progress
        self.run, self.run_json = run, run_json
        self.todo = {unit.path for unit in todo}
        self.seconds_done, self.seconds_all = 0.0, sum(unit.seconds for unit in todo)
        self.save_run()

    def save_run(self) -> None:
        with replacing(self.run_json) as temp:
            temp.write_text(json.dumps(self.run, indent=1), encoding="utf-8")

    def render(self, plan: ScenePlan, units: list[Unit]) -> None:
        for unit in units:
            if unit.path in self.todo:
                with self._noting_failure(plan, unit.path.stem):
                    self._render_unit(plan, unit)
                self.seconds_done += unit.seconds

    def average(self, plan: ScenePlan) -> None:
        """Make the references of whatever chunks there are."""
        with self._noting_failure(plan, "reference"):
            done = {
                engine: [unit.path for unit in units if unit.path.exists()]
                for engine, units in plan.chunks.items()
            }
            write_references(plan.folder, plan.reference_header, done)

    def _render_unit(self, plan: ScenePlan, unit: Unit) -> None:
        def advance(fraction: float, text: str) -> None:
            done = (self.seconds_done + fraction * unit.seconds) / self.seconds_all
            self.progress(done, f"{plan.entry['name']} {unit.path.stem}: {text}")

        unfinished = self.workspace / "unit.exr"
        job = {"do": "render", "file": plan.file, "camera": plan.entry["camera"]}
        job |= {"header": unit.header, "out": str(unfinished.absolute())}
        process = self.processes[unit.header["settings"]["engine"]]
        process.ask(job, advance, unit.header["budget"].get("seconds", 0))
        unit.path.parent.mkdir(parents=True, exist_ok=True)
        os.replace(unfinished, unit.path)

    @contextmanager
    def _noting_failure(self, plan: ScenePlan, name: str) -> Iterator[None]:
        try:
            yield
        except (RenderError, InputError, ImageError) as error:
            plan.entry["failed"].append(f"{name}: {error}")
            self.save_run()


@contextmanager
def _workspace(out_dir: Path) -> Iterator[Path]:
    """A folder for unfinished files inside `out_dir`, empty at first, gone at the end."""
    folder = out_dir / ".unfinished"
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (out_dir / "log.txt").unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{out_dir}: no results can be written there ({error.strerror})."
        ) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _describe_run(options: Options, command: str, versions: dict[str, str]) -> dict:
    return {
        "format": 1,
        "command": command,
        "started": datetime.now().isoformat(timespec="seconds"),
        "versions": versions,
        "machine": _describe_machine(),
        **options.common,
        "budget_kind": options.budget_kind,
        "budgets": list(options.budgets),
        "methods": list(options.methods),
        "seeds": options.seeds,
        "references": list(options.references),
        "reference_seconds": options.resolved_reference_seconds,
    }


def _describe_machine() -> dict:
    cpu, memory_gib = platform.processor(), None
    if (cpuinfo := Path("/proc/cpuinfo")).exists():
        found = re.search(r"^model name\s*: (.+)$", cpuinfo.read_text(), re.MULTILINE)
        cpu = found[1] if found else cpu
    if hasattr(os, "sysconf"):
        memory_gib = round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30, 1)
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "memory_gib": memory_gib,
        "platform": platform.platform(terse=True),
    }
