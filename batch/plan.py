"""What a comparison has to render: a list of units, one image each.

The header of a unit's image is known before it is rendered, so a unit is done when a file with
that header exists: this is all there is to resuming. References are units too, long ones in
chunks with seeds of their own.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lighttree_core import Settings

from .images import ImageError, read_exr
from .methods import ENDLESS, LIGHTTREE, METHODS, InputError
from .metrics import budget_label

REFERENCE_METHODS = ("lighttree", "cycles")
REFERENCE_CHUNKS = 8
REFERENCE_SEED = 1_000_000  # far from any seed of a method
SECONDS_A_SAMPLE = 0.1  # a guess, which only moves the progress bar
SIDES_PX = (4, 65536)  # Blender's own limits


@dataclass(frozen=True)
class Options:
    """What to compare; refuses what makes no sense.

    budgets: seconds of rendering or numbers of samples, as `budget_kind` says. cameras: names; none
    for each file's active one. threads: 0 for all cores. reference_seconds: for each
    reference; 0 for ten times the longest budget. strict: refuse scenes not modelled in full.
    tree: options of the light tree, as properties of `scene.lighttree`, for LightTree's methods
    that do not set them themselves. references: whose long renders, as shipped, are averaged.
    """

    methods: Sequence[str] = tuple(METHODS)
    budget_kind: str = "seconds"
    budgets: Sequence[float] = (1, 2, 4, 8, 16)
    seeds: int = 2
    resolution: tuple[int, int] = (480, 270)
    bounces: int = 4
    threads: int = 0
    reference_seconds: float = 0
    cameras: Sequence[str] = ()
    strict: bool = False
    tree: dict[str, Any] = field(default_factory=dict)
    references: Sequence[str] = REFERENCE_METHODS

    def __post_init__(self):
        for name in self.methods:
            if name not in METHODS:
                known = ", ".join(METHODS)
                raise InputError(f"There is no method called '{name}'; there are {known}.")
        width, height = self.resolution
        longest = 1e6 if self.budget_kind == "seconds" else ENDLESS
        limits = (
            ("The number of methods", len(self.methods), 1, len(METHODS)),
            ("The number of budgets", len(self.budgets), 1, 1000),
            *((f"A budget in {self.budget_kind}", b, 1e-3, longest) for b in self.budgets),
            ("The width in pixels", width, *SIDES_PX),
            ("The height in pixels", height, *SIDES_PX),
            ("The number of bounces", self.bounces, 0, 1024),
            ("The number of threads", self.threads, 0, 1024),
            ("The number of seeds", self.seeds, 1, 1000),
            ("The time for references in seconds", self.reference_seconds, 0, 1e7),
        )
        for name, value, least, most in limits:
            if not least <= value <= most:
                raise InputError(f"{name} must be {least:g} to {most:g}, not {value:g}.")

    @property
    def common(self) -> dict:
        """What all images of a comparison share, as in their headers."""
        return {
            "resolution": list(self.resolution),
            "bounces": self.bounces,
            "threads": self.num_threads,
        }

    @property
    def num_threads(self) -> int:
        return Settings(threads=self.threads).num_threads

    @property
    def resolved_reference_seconds(self) -> float:
        if self.reference_seconds:
            return self.reference_seconds
        return 10 * max(self.budgets) if self.budget_kind == "seconds" else 60


@dataclass(frozen=True)
class Unit:
    """One image to render: where it goes, and the header it must have."""

    path: Path
    header: dict

    @property
    def seconds(self) -> float:
        """How long it renders; where that is not given, a guess."""
        budget = self.header["budget"]
        return budget.get("seconds") or budget["samples"] * SECONDS_A_SAMPLE

    def is_done(self) -> bool:
        try:
            _, found = read_exr(self.path)
        except ImageError:
            return False
        return all(found.get(key) == value for key, value in self.header.items())


@dataclass(frozen=True)
class ScenePlan:
    """The units of one scene. entry: its part of run.json. chunks: by method of the reference."""

    entry: dict
    file: str
    folder: Path
    reference_header: dict
    chunks: dict[str, list[Unit]]
    renders: list[Unit]

    @property
    def all_chunks(self) -> list[Unit]:
        return [unit for pair in zip(*self.chunks.values(), strict=True) for unit in pair]

    @property
    def units(self) -> list[Unit]:
        return [*self.all_chunks, *self.renders]


def name_scenes(
    files: Sequence[str | Path], cameras: Sequence[str]
) -> dict[str, tuple[str | Path, str | None]]:
    """File and camera of each scene, by the name of its folder."""
    scenes: dict[str, tuple[str | Path, str | None]] = {}
    for file in files:
        if not Path(file).is_file():
            raise InputError(f"{file}: no such file.")
        for camera in cameras or (None,):
            stem = Path(file).stem + (f"-{camera}" if camera else "")
            name = re.sub(r"[^\w.-]", "_", stem)
            if name in scenes:
                raise InputError(f"{file}: the scene name '{name}' is taken; rename the file.")
            scenes[name] = file, camera
    return scenes


def plan_scene(
    name: str, file: str | Path, facts: dict, folder: Path, options: Options
) -> ScenePlan:
    """Everything to render for a scene; `facts` are what `worker.inspect` found."""
    common = {"scene": name} | options.common

    def unit(path: str, method: str, seed: int, budget: dict, tree: dict) -> Unit:
        engine, overrides = METHODS[method].engine, METHODS[method].overrides
        if engine == LIGHTTREE:
            overrides = tree | overrides
        settings = {"engine": engine, "renderer": facts["renderers"][engine]}
        settings |= {"camera": facts["camera"], "file_sha256": facts["file_sha256"]}
        header = {"method": method, "seed": seed, "budget": budget, "settings": settings}
        header |= {"overrides": overrides}
        return Unit(folder / f"{path}.exr", common | header)

    chunk_s = options.resolved_reference_seconds / REFERENCE_CHUNKS
    chunks = {
        method: [
            unit(
                f"reference-chunks/{method}-{i}",
                method,
                REFERENCE_SEED + i,
                {"seconds": chunk_s},
                tree={},
            )
            for i in range(REFERENCE_CHUNKS)
        ]
        for method in options.references
    }
    renders = [
        unit(f"{method}-{budget_label(budget)}-seed{seed}", method, seed, budget, options.tree)
        for budget in ({options.budget_kind: amount} for amount in options.budgets)
        for seed in range(1, options.seeds + 1)
        for method in options.methods  # innermost, so that a slow minute hits all alike
    ]
    told = ("camera", "lights", "triangles", "not_modelled")
    entry = {"name": name, "file": str(file)} | {key: facts[key] for key in told} | {"failed": []}
    return ScenePlan(entry, os.path.abspath(file), folder, common, chunks, renders)
