"""What a batch has to render: a list of units, one image each.

What determines a unit's image is known before it is rendered, and a hash of it is the `key` in its
header, so a unit is done when a whole file with that key exists: this is all there is to resuming.
References are units too, long ones in chunks with seeds of their own.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lighttree_core import Settings

from .images import ImageError, read_exr
from .methods import ENDLESS, LIGHTTREE, METHODS, InputError
from .metrics import budget_label
from .views import View

REFERENCE_METHODS = ("lighttree", "cycles")
REFERENCE_CHUNKS = 8
REFERENCE_SEED = 1_000_000  # far from any seed of a method
SECONDS_A_SAMPLE = 0.1  # a guess, which only moves the progress bar
SIDES_PX = (4, 65536)  # Blender's own limits
LAST_FRAME = 1_048_574  # Blender's too
MOST_RENDERS = 100_000
MAX_NAME_BYTES = 200  # file systems take 255


class OptionError(InputError):
    """Options that make no sense. mistakes: name of the option and a sentence, of each."""

    def __init__(self, mistakes: list[tuple[str, str]]):
        super().__init__(mistakes[0][1])
        self.mistakes = mistakes


@dataclass(frozen=True)
class Options:
    """What to compare; refuses what makes no sense.

    budgets: seconds of rendering or numbers of samples, as `budget_kind` says. cameras, frames,
    scene, view_layer: of each file, as in `View`; none for those it was saved with. threads: 0 for
    all cores. reference_seconds: for each reference; 0 for ten times the longest budget.
    reference_samples: instead of seconds.
    strict: refuse scenes not modelled in full. probe: judge the choice of lights too. workers: how
    many renders run side by side where none is timed; they share the cores unless `threads` is
    given.
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
    reference_samples: int = 0
    cameras: Sequence[str] = ()
    frames: Sequence[int] = ()
    scene: str | None = None
    view_layer: str | None = None
    strict: bool = False
    probe: bool = False
    workers: int = 1
    tree: dict[str, Any] = field(default_factory=dict)
    references: Sequence[str] = REFERENCE_METHODS

    def __post_init__(self):
        if mistakes := self._find_mistakes():
            raise OptionError(mistakes)

    def _find_mistakes(self) -> list[tuple[str, str]]:
        known = ", ".join(METHODS)
        mistakes = [
            ("methods", f"There is no method called '{name}'; there are {known}.")
            for name in self.methods
            if name not in METHODS
        ]
        width, height = self.resolution
        longest = 1_000_000 if self.budget_kind == "seconds" else ENDLESS
        num_renders = len(self.methods) * len(self.budgets) * max(self.seeds, 0)
        limits = (
            ("methods", "The number of methods", len(self.methods), 1, len(METHODS)),
            ("budgets", "The number of budgets", len(self.budgets), 1, 1000),
            *(
                ("budgets", f"A budget in {self.budget_kind}", b, 1e-3, longest)
                for b in self.budgets
            ),
            ("resolution", "The width in pixels", width, *SIDES_PX),
            ("resolution", "The height in pixels", height, *SIDES_PX),
            ("bounces", "The number of bounces", self.bounces, 0, 1024),
            ("threads", "The number of threads", self.threads, 0, 1024),
            ("workers", "The number of workers", self.workers, 1, 1024),
            ("seeds", "The number of seeds", self.seeds, 1, 1000),
            ("seeds", "Methods times budgets times seeds", num_renders, 0, MOST_RENDERS),
            *(("frames", "A frame", n, -LAST_FRAME, LAST_FRAME) for n in self.frames),
            ("reference_seconds", "The time for references", self.reference_seconds, 0, 10_000_000),
            ("reference_samples", "The samples of a reference", self.reference_samples, 0, ENDLESS),
        )
        mistakes += [
            (option, f"{name} must be {least:,} to {most:,}, not {value}.")
            for option, name, value, least, most in limits
            if not least <= value <= most
        ]
        if self.reference_seconds and self.reference_samples:
            sentence = "reference_seconds and reference_samples exclude each other; give one."
            mistakes.append(("reference_samples", sentence))
        return mistakes

    @property
    def common(self) -> dict:
        """What all images of a comparison share, as in their headers; of threads, the most."""
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
        """Seconds of each reference; 0 if it has a number of samples instead."""
        if self.reference_seconds or self.reference_samples:
            return self.reference_seconds
        return 10 * max(self.budgets) if self.budget_kind == "seconds" else 60

    @property
    def chunk_budget(self) -> dict[str, float]:
        """What each chunk of a reference may take."""
        if self.reference_samples:
            return {"samples": -(-self.reference_samples // REFERENCE_CHUNKS)}
        return {"seconds": self.resolved_reference_seconds / REFERENCE_CHUNKS}

    def threads_of(self, budget: dict[str, float]) -> int:
        """How many threads a render has: its share of the cores where others run beside it."""
        if self.threads or "seconds" in budget:
            return self.num_threads
        return max(1, self.num_threads // self.workers)


class Recipe(NamedTuple):
    """One of the scenes of `scenes.py`, to be built. lights: None for its own number."""

    name: str
    lights: int | None = None
    seed: int = 0


class Source(NamedTuple):
    """A scene: a .blend, and what of it is rendered, as in `View`.

    recipe: what builds the file if it is not there. place: file and line that ask for it.
    """

    file: str | Path
    camera: str | None = None
    frame: int | None = None
    recipe: Recipe | None = None
    place: tuple[str, int] | None = None
    scene: str | None = None
    view_layer: str | None = None

    @property
    def view(self) -> View:
        return View(self.camera, self.frame, self.scene, self.view_layer)

    @property
    def name(self) -> str:
        """The name of the scene and of its folder."""
        frame = None if self.frame is None else f"f{self.frame}"
        parts = (Path(self.file).stem, self.scene, self.view_layer, self.camera, frame)
        return re.sub(r"[^\w.-]", "_", "-".join(part for part in parts if part is not None))

    def locate(self, sentence: str) -> str:
        """A sentence about this scene, after its place if it has one."""
        return "{}:{}: {}".format(*self.place, sentence) if self.place else sentence


@dataclass(frozen=True)
class Unit:
    """One image to render: where it goes, and the header it must have."""

    path: Path
    header: dict

    @property
    def is_chunk(self) -> bool:
        """Whether it is part of a reference; what is not becomes a row of the results."""
        return self.header["seed"] >= REFERENCE_SEED

    @property
    def is_timed(self) -> bool:
        """Whether what else runs on the machine would change the image."""
        return "seconds" in self.header["budget"]

    @property
    def seconds(self) -> float:
        """How long it renders; where that is not given, a guess."""
        budget = self.header["budget"]
        return budget.get("seconds") or budget["samples"] * SECONDS_A_SAMPLE

    def read_done(self) -> dict | None:
        """The header of its image with the facts of the render; None if there is none as yet."""
        try:
            _, found = read_exr(self.path)
        except (ImageError, OSError):
            return None
        return found if found.get("key") == self.header["key"] else None


@dataclass(frozen=True)
class ScenePlan:
    """The units of one scene. entry: its part of run.json. chunks: by method of the reference.

    files: what `file` draws upon; fixed_files: those among them that it names by absolute paths.
    """

    entry: dict
    file: str
    files: Sequence[str]
    fixed_files: Sequence[str]
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


def name_scenes(sources: Iterable[Source]) -> tuple[dict[str, Source], list[tuple[Source, str]]]:
    """The scenes by name, and a sentence for each that cannot be among them."""
    scenes: dict[str, Source] = {}
    mistakes = []
    for source in sources:
        if not source.recipe and not os.path.isfile(source.file):
            mistakes.append((source, f"{source.file}: no such file."))
        elif len(os.fsencode(source.name)) > MAX_NAME_BYTES:
            mistakes.append((source, f"the scene name '{source.name[:40]}...' is too long."))
        elif source.name in scenes:
            taken = f"the scene name '{source.name}' is taken; rename the file."
            mistakes.append((source, f"{source.file}: {taken}"))
        else:
            scenes[source.name] = source
    return scenes, mistakes


def plan_scene(source: Source, facts: dict, out_dir: Path, options: Options) -> ScenePlan:
    """Everything to render for a scene; `facts` are what `worker.inspect` found."""
    name, folder = source.name, out_dir / source.name
    common = {"scene": name} | options.common
    image = {key: facts[key] for key in (*View._fields, "file_sha256")}

    def unit(path: str, method: str, seed: int, budget: dict, tree: dict) -> Unit:
        engine, overrides = METHODS[method].engine, METHODS[method].overrides
        if engine == LIGHTTREE:
            overrides = tree | overrides
        settings = {"engine": engine, "renderer": facts["renderers"][engine]} | image
        header = {"method": method, "seed": seed, "budget": budget, "settings": settings}
        header = common | header | {"overrides": overrides, "threads": options.threads_of(budget)}
        # By samples, an image is the same bits for any number of threads.
        ignored = () if "seconds" in budget else ("threads",)
        determining = {name: header[name] for name in header if name not in ignored}
        key = hashlib.sha256(json.dumps(determining, sort_keys=True).encode()).hexdigest()
        return Unit(folder / f"{path}.exr", header | {"key": key})

    chunks = {
        method: [
            unit(
                f"reference-chunks/{method}-{i}",
                method,
                REFERENCE_SEED + i,
                options.chunk_budget,
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
    told = (*View._fields, "lights", "triangles", "not_modelled")
    entry = {"name": name, "file": str(source.file)} | {key: facts[key] for key in told}
    files = os.path.abspath(source.file), facts["files"], facts["fixed_files"]
    return ScenePlan(entry | {"failed": []}, *files, folder, common, chunks, renders)
