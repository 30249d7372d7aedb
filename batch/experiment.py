"""Run a batch: render what a folder still lacks of it, average references, write the report.

Errors are measured by the report, not here.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from .facts import describe_machine, is_since_inspection, read_facts, save_facts
from .images import replacing
from .local_crew import LocalCrew, ask_again
from .methods import InputError
from .plan import Options, ScenePlan, Source, name_scenes, plan_scene
from .process import Progress, RenderError, RenderProcess
from .report import write_report
from .schedule import Crew, Schedule
from .views import View


@dataclass(frozen=True)
class Outcome:
    """What a batch came to. failed: a sentence for each unit that could not be rendered."""

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
    sources = [
        Source(file, camera, frame, scene=options.scene, view_layer=options.view_layer)
        for file in files
        for camera in options.cameras or (None,)
        for frame in options.frames or (None,)
    ]
    return run_batch(sources, out_dir, options, progress, command)


def run_batch(
    sources: Sequence[Source],
    out_dir: str | Path,
    options: Options,
    progress: Progress | None = None,
    command: str = "",
    cluster: Crew | None = None,
) -> Outcome:
    """Render what a batch still lacks in `out_dir`, here or by a cluster, and write its report."""
    progress = progress or (lambda fraction, text: None)
    out_dir = Path(out_dir)
    log = out_dir / "log.txt"
    scenes, mistakes = name_scenes(sources)
    _refuse(mistakes)
    with _workspace(out_dir) as workspace:
        plans, versions = _inspect(scenes, out_dir, options, workspace, log, progress)
        run = _describe_run(options, command, versions) | {"is_cluster": cluster is not None}
        run["scenes"] = [plan.entry for plan in plans]

        def save_run() -> None:
            with replacing(out_dir / "run.json") as temp:
                temp.write_text(json.dumps(run, indent=1), encoding="utf-8")

        units = [unit for plan in plans for unit in plan.units]
        done = {unit.path: header for unit in units if (header := unit.read_done())}
        todo = [unit for unit in units if unit.path not in done]
        for unit in todo:  # what another run left under this name must not get into the report
            unit.path.unlink(missing_ok=True)
        save_run()
        crew = cluster or LocalCrew(options.workers, workspace, log)
        Schedule(plans, todo, find_cpus(plans, done), crew, progress, save_run).run()
        if options.probe:
            _probe(plans, options, progress)
            save_run()
    failed = [f"{plan.entry['name']} {text}" for plan in plans for text in plan.entry["failed"]]
    num_missing = sum(not unit.path.exists() for unit in todo)
    return Outcome(
        report=write_report(out_dir, progress),
        num_rendered=len(todo) - num_missing,
        num_kept=len(units) - len(todo),
        failed=failed,
    )


def plan_batch(
    sources: Sequence[Source], out_dir: Path, options: Options, progress: Progress
) -> list[ScenePlan]:
    """The plans of a batch's scenes, those looked into that nobody has looked into yet."""
    scenes, mistakes = name_scenes(sources)
    _refuse(mistakes)
    with _workspace(out_dir) as workspace:
        return _inspect(scenes, out_dir, options, workspace, out_dir / "log.txt", progress)[0]


def find_cpus(plans: Sequence[ScenePlan], done: dict[Path, dict]) -> dict[Path, str]:
    """Which CPU made the renders of each scene, by folder; done: headers by path."""
    return {
        plan.folder: done[unit.path]["machine"]["cpu"]
        for plan in plans
        for unit in plan.renders
        if "machine" in done.get(unit.path, ())
    }


def _refuse(mistakes: Sequence[tuple[Source, str]]) -> None:
    if mistakes:
        raise InputError("\n".join(source.locate(sentence) for source, sentence in mistakes))


def _inspect(
    scenes: dict[str, Source],
    out_dir: Path,
    options: Options,
    workspace: Path,
    log: Path,
    progress: Progress,
) -> tuple[list[ScenePlan], dict[str, str]]:
    """Plan every scene, and tell what renders; the process ends, and with it what it compiled.

    Scenes of ours that are not there yet are built first. All that cannot be rendered are refused
    at once; one that keeps killing the process has failed.
    """
    plans, mistakes, versions = [], [], {}
    with RenderProcess(log) as process:
        for name, source in scenes.items():
            job = {"do": "inspect", "file": os.path.abspath(source.file)}
            job |= {"view": source.view._asdict(), "common": options.common}
            try:
                if source.recipe and not os.path.exists(source.file):
                    _build(source, workspace, log, progress)
                facts = read_facts(source, out_dir / name)
                if facts is None:
                    facts = ask_again(process, job, progress) | {"versions": process.versions}
                    save_facts(facts, source, out_dir / name)
            except InputError as error:
                mistakes.append((source, str(error)))
                continue
            except RenderError as error:
                plans.append(_plan_nothing(source, out_dir, str(error)))
                continue
            if options.strict and facts["not_modelled"]:
                sentence = f"{source.file}: {facts['not_modelled'][0]} (refused by --strict)"
                mistakes.append((source, sentence))
            versions = facts["versions"]
            plans.append(plan_scene(source, facts, out_dir, options))
    _refuse(mistakes)
    return plans, versions


def _probe(plans: Sequence[ScenePlan], options: Options, progress: Progress) -> None:
    """Judge the choice of lights in each scene, unless that was done since it was inspected."""
    from . import probe, probe_report

    for plan in plans:
        if not plan.renders or is_since_inspection(plan.folder / "probe.csv"):
            continue
        name, view = plan.entry["name"], View(*(plan.entry[key] for key in View._fields))

        def tell(fraction: float, text: str, name: str = name) -> None:
            progress(fraction, f"{name} probe: {text}")

        try:
            found = probe.run_probe(
                Path(plan.file), probe.NUM_POINTS, 0, (), options.threads, tell, view
            )
        except (InputError, RenderError) as error:
            plan.entry["failed"].append(f"probe: {error}")
        else:
            probe_report.write_files(found, plan.folder)


def _build(source: Source, workspace: Path, log: Path, progress: Progress) -> None:
    name, lights, seed = source.recipe
    unfinished = (workspace / "scene.blend").absolute()
    job = {"do": "build", "name": name, "num_lights": lights, "seed": seed, "out": str(unfinished)}
    with RenderProcess(log) as process:
        ask_again(process, job, progress)
    os.replace(unfinished, source.file)


def _plan_nothing(source: Source, out_dir: Path, failure: str) -> ScenePlan:
    entry = {"name": source.name, "file": str(source.file), "failed": [failure]}
    entry |= source.view._asdict() | {"camera": source.camera or "unknown", "lights": {}}
    entry |= {"triangles": 0, "not_modelled": []}
    return ScenePlan(entry, "", [], [], out_dir / source.name, {}, {}, [])


@contextmanager
def _workspace(out_dir: Path) -> Iterator[Path]:
    """A folder for unfinished files inside `out_dir`, empty at first, gone at the end.

    It has a new name each time: what a killed batch left running must not write into it. Nobody
    else can have one meanwhile.
    """
    folder, lock = out_dir / ".unfinished", FileLock(out_dir / ".lock")
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        with suppress(NotImplementedError):  # by some network shares
            lock.acquire(timeout=0)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        for pattern in (".*.tmp", "*/.*.tmp", "*/*/.*.tmp"):  # of `images.replacing`
            for path in out_dir.glob(pattern):
                path.unlink()
        (out_dir / "log.txt").unlink(missing_ok=True)
        workspace = Path(tempfile.mkdtemp(dir=folder))
    except Timeout:
        raise InputError(
            f"{out_dir}: another batch is at work there; wait for its end, or name another folder."
        ) from None
    except OSError as error:
        raise InputError(
            f"{out_dir}: no results can be written there ({error.strerror})."
        ) from error
    try:
        yield workspace
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        lock.release()


def _describe_run(options: Options, command: str, versions: dict[str, str]) -> dict:
    return {
        "format": 1,
        "command": command,
        "started": datetime.now().isoformat(timespec="seconds"),
        "versions": versions,
        "machine": describe_machine(),
        **options.common,
        "budget_kind": options.budget_kind,
        "budgets": list(options.budgets),
        "methods": list(options.methods),
        "seeds": options.seeds,
        "references": list(options.references),
        "reference_seconds": options.resolved_reference_seconds,
        "reference_samples": options.reference_samples,
        "workers": options.workers,
    }
