"""What a batch has still to do, and about how long that takes; renders nothing, opens no Blender.

What an inspection once found lies in the folder of its scene and holds as long as its files are
the same. Of a scene without it nothing is rendered that still counts.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from statistics import mean
from typing import NamedTuple

from rich.table import Column, Table

from .facts import describe_renderers, read_facts
from .jobs import Job
from .plan import Options, ScenePlan, Unit, name_scenes, plan_scene
from .views import View

UNKNOWN = dict.fromkeys(
    View._fields + ("file_sha256", "lights", "triangles", "not_modelled", "files", "fixed_files"),
    "unknown",
)
# float32 of three channels; a reference has their variance too, and there are one by each engine
# and their mean.
IMAGE_BYTES, REFERENCES_BYTES = 12, 60


class Cost(NamedTuple):
    """What is left to do of a scene. is_least: whether more time is needed than is known."""

    num_images: int
    num_done: int
    seconds: float
    is_least: bool
    num_bytes: int


def forecast(job: Job) -> tuple[Table, list[str]]:
    """A row for each scene of a batch and one for all, and what to know about the numbers."""
    names = ("Images", "Done", "Time", "Disk")
    numbers = (Column(name, justify="right", no_wrap=True) for name in names)
    table = Table(Column("Scene", overflow="fold"), *numbers)
    costs, num_new = [], 0
    for name, source in name_scenes(job.sources)[0].items():
        facts = read_facts(source, job.out / name)
        num_new += facts is None
        facts = facts or UNKNOWN | {"renderers": describe_renderers()}
        costs.append(estimate(plan_scene(source, facts, job.out, job.options), job.options))
        table.add_row(name, *_tell(costs[-1]))
    images, done, seconds, are_least, sizes = zip(*costs, strict=True)
    total = Cost(sum(images), sum(done), sum(seconds), any(are_least), sum(sizes))
    table.add_section()
    table.add_row("all", *_tell(total))
    return table, _find_notes(job, total, num_new)


def estimate(plan: ScenePlan, options: Options) -> Cost:
    """What is left to do of a scene, judged by what is done of it."""
    todo: list[Unit] = []
    setups: dict[str, list[float]] = defaultdict(list)  # seconds, by method
    rates: dict[str, list[float]] = defaultdict(list)  # seconds a sample
    for unit in plan.units:
        if (header := unit.read_done()) is None:
            todo.append(unit)
        else:
            seconds_before = header["seconds_setup"] + header.get("seconds_start", 0)
            setups[header["method"]].append(seconds_before)
            rates[header["method"]].append(header["seconds_render"] / max(header["samples"], 1))
    seconds, is_least = 0.0, False
    for unit in todo:
        method, budget = unit.header["method"], unit.header["budget"]
        is_least |= not setups[method]
        seconds += mean(setups[method] or [0])
        seconds += budget.get("seconds") or budget["samples"] * mean(rates[method] or [0])
    pixel_bytes = IMAGE_BYTES * len(todo) + REFERENCES_BYTES * bool(todo)
    width, height = options.resolution
    num_bytes = pixel_bytes * width * height
    return Cost(len(plan.units), len(plan.units) - len(todo), seconds, is_least, num_bytes)


def _tell(cost: Cost) -> tuple[str, str, str, str]:
    time = format_duration(cost.seconds)
    if cost.is_least:
        time = f"over {time}" if cost.seconds else "unknown"
    disk = f"up to {-(-cost.num_bytes // 1_000_000):,} MB" if cost.num_bytes else "0 MB"
    return f"{cost.num_images:,}", f"{cost.num_done:,}", time, disk


def format_duration(seconds: float) -> str:
    """'45 s', '3 min' or '2 h 05 min'."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02} min"


def _find_notes(job: Job, total: Cost, num_new: int) -> list[str]:
    notes = [f"Results go to {job.out}."]
    if total.num_done == total.num_images:
        return [*notes, "Nothing is left to render."]
    if num_new:
        scenes = "1 scene is" if num_new == 1 else f"{num_new:,} scenes are"
        notes.append(f"{scenes} new or changed: Blender has not looked into these files yet.")
    if total.is_least:
        notes.append(
            "Before the first image of a method in a scene, time is without its set-up, and for "
            "a number of samples unknown."
        )
    missing = {str(s.file) for s in job.sources if s.recipe and not Path(s.file).is_file()}
    if missing:
        notes.append(f"To be generated first: {', '.join(sorted(Path(f).name for f in missing))}.")
    if job.options.workers > 1:
        notes.append(
            "Time is as of one worker; what has a number of samples is rendered side by side."
        )
    return notes
