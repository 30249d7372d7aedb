"""Render one unit of a batch, for a render manager that gives units to machines.

Many do so at a time in one folder that they share. So each renders in a folder of its own, which no
other sees, has a log of its own, and an image takes its place at once, as a whole.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import nullcontext
from pathlib import Path

from filelock import FileLock

from .facts import UNREADABLE, describe_machine, describe_renderers, load_facts, still_hold
from .images import replacing
from .jobs import Job
from .local_crew import LocalCrew
from .methods import InputError
from .plan import ScenePlan, Unit, name_scenes, plan_scene
from .process import Progress, RenderError


def render_unit(job: Job, key: str, progress: Progress) -> tuple[Path, bool]:
    """The image of the unit whose key begins with `key`, and whether it was rendered just now."""
    plan, unit = find_unit(job, key)
    # Alone among the units of this machine, even those that a killed job left running.
    with FileLock(_lock_file()) if unit.is_timed else nullcontext():
        if unit.read_done():
            return unit.path, False
        _refuse_other_machine(plan, unit)
        _render(plan, unit, progress)
    return unit.path, True


def _render(plan: ScenePlan, unit: Unit, progress: Progress) -> None:
    log = unit.path.with_suffix(".log")
    log.parent.mkdir(parents=True, exist_ok=True)
    log.unlink(missing_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix="lighttree-") as workspace,
        LocalCrew(1, Path(workspace), log) as crew,
    ):
        (worker,) = crew.find_new()
        worker.render_file(plan.file, unit.header, progress)
        _refuse_other_machine(plan, unit)  # another machine may have been faster
        with replacing(unit.path) as temp:
            shutil.copyfile(worker.unfinished, temp)
    log.unlink(missing_ok=True)


def _lock_file() -> Path:
    return Path(tempfile.gettempdir(), f"lighttree-{getattr(os, 'getuid', int)()}.lock")


def find_unit(job: Job, key: str) -> tuple[ScenePlan, Unit]:
    """A unit by the beginning of its key, and its plan; its scene must be as it was inspected."""
    found = []
    for name, source in name_scenes(job.sources)[0].items():
        try:
            facts = load_facts(job.out / name)
            plan = plan_scene(source, facts, job.out, job.options)
            units = [unit for unit in plan.units if unit.header["key"].startswith(key)]
            if units and not still_hold(facts, source):
                raise _changed(source.file, facts)
        except UNREADABLE:
            continue
        found += [(plan, unit) for unit in units]
    if len(found) > 1:
        raise InputError(f"{len(found)} units have keys that begin with '{key}'; give more of it.")
    if not found:
        raise InputError(
            f"No unit has a key that begins with '{key}', as far as scenes were inspected; submit "
            "the batch again with --flamenco."
        )
    return found[0]


def _changed(file: str | Path, facts: dict) -> RenderError:
    ours = describe_renderers()
    if facts["renderers"] != ours:
        told, ours = (" and ".join(renderers.values()) for renderers in (facts["renderers"], ours))
        return RenderError(f"{file} is to be rendered with {told}; this machine has {ours}.")
    return RenderError(
        f"{file} has changed since it was inspected, or is another file on this machine; submit "
        "the batch again with --flamenco."
    )


def _refuse_other_machine(plan: ScenePlan, unit: Unit) -> None:
    """Refuse what would not be comparable with the scene's other images."""
    machine = describe_machine()
    if unit.is_timed and machine["cores"] < unit.header["threads"]:
        raise RenderError(
            f"This machine has {machine['cores']} cores, and the batch is timed with "
            f"{unit.header['threads']} threads."
        )
    if unit.is_chunk:
        return
    for header in filter(None, (other.read_done() for other in plan.renders)):
        cpu = header.get("machine", machine)["cpu"]
        if cpu != machine["cpu"]:
            raise RenderError(
                f"The other images of {plan.entry['name']} were made by another CPU, {cpu}; this "
                f"is {machine['cpu']}."
            )
        return
