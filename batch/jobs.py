"""Job files: a batch of scenes in TOML, read as a whole, so that every mistake is told at once.

    out = "results"
    methods = ["lighttree", "cycles"]
    seconds = [1, 4]

    [[scene]]
    files = ["shots/*.blend"]
    frames = [1, 10]

    [[scene]]
    generate = "city-small"
    cameras = ["street", "roof"]

Keys before the first [[scene]] are of all scenes. Paths are relative to the job file, and nothing
in it is ever evaluated.
"""

from __future__ import annotations

import difflib
import glob
import os
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lighttree_core.light_tree.options import TreeOptions

from .methods import InputError
from .plan import OptionError, Options, Recipe, Source, name_scenes
from .toml_lines import Where, find_lines


class Job(NamedTuple):
    """What a job file asks for."""

    sources: Sequence[Source]
    out: Path
    options: Options


class Kind(NamedTuple):
    """What a value may be, and in words."""

    allows: Callable[[Any], bool]
    told: str


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip()) and "\0" not in value


def _is_count(value: Any) -> bool:
    return type(value) is int


def _is_number(value: Any) -> bool:
    return _is_count(value) or type(value) is float


def _list_of(is_item: Callable[[Any], bool], example: str) -> Kind:
    def allows(value: Any) -> bool:
        return isinstance(value, list) and bool(value) and all(map(is_item, value))

    return Kind(allows, f"a list like {example}")


TEXT = Kind(_is_text, "a text in quotes")
COUNT = Kind(_is_count, "a whole number")
NUMBER = Kind(_is_number, "a number")
COUNTS = _list_of(_is_count, "[1, 4, 16]")
FLAG = Kind(lambda value: isinstance(value, bool), "true or false")
TABLE = Kind(lambda value: isinstance(value, dict), "a table")
SHARED = {
    "out": TEXT,
    "methods": _list_of(_is_text, '["lighttree", "cycles"]'),
    "seconds": _list_of(_is_number, "[1, 2.5]"),
    "samples": COUNTS,
    "seeds": COUNT,
    "resolution": Kind(
        lambda value: COUNTS.allows(value) and len(value) == 2, "width and height like [480, 270]"
    ),
    "bounces": COUNT,
    "threads": COUNT,
    "reference_seconds": NUMBER,
    "reference_samples": COUNT,
    "strict": FLAG,
    "probe": FLAG,
    "tree": TABLE,
    "scene": _list_of(TABLE.allows, "[[scene]]"),
}
SCENE = {
    "files": _list_of(_is_text, '["a.blend", "shots/*.blend"]'),
    "generate": TEXT,
    "lights": COUNT,
    "seed": Kind(lambda value: _is_count(value) and 0 <= value < 2**63, "a whole number from 0"),
    "cameras": _list_of(_is_text, '["street", "roof"]'),
    "frames": COUNTS,
    "scene": TEXT,
    "view_layer": TEXT,
}
TREE = dict.fromkeys(TreeOptions.__dataclass_fields__, Kind(lambda value: True, ""))


def read_job(path: Path, workers: int = 1) -> Job:
    """The batch that a file asks for; raises InputError with a line for each mistake."""
    try:
        text = path.read_bytes().decode()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}:{line}: this is not text; a job file is TOML in UTF-8.") from None
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(_describe_syntax(path, text, error)) from None
    reader = _Reader(path, find_lines(text))
    job = reader.read(content, workers)
    if reader.mistakes:
        told = sorted(dict.fromkeys(reader.mistakes), key=lambda mistake: mistake[0])
        raise InputError("\n".join(f"{path}:{line}: {sentence}" for line, sentence in told))
    return job


def _describe_syntax(path: Path, text: str, error: Exception) -> str:
    found = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", str(error), re.DOTALL)
    if found:
        what, line, column = found.groups()
        return f"{path}:{line}: {_in_one_line(what)} in column {column}; a job file is TOML."
    what = "Too deeply nested" if isinstance(error, RecursionError) else _in_one_line(str(error))
    return f"{path}:{text.count(chr(10)) + 1}: {what}; a job file is TOML."


class _Reader:
    """Takes a parsed job file apart; mistakes: line and sentence of each."""

    def __init__(self, path: Path, lines: dict[Where, int]):
        self.path, self.folder, self.lines = path, path.parent, lines
        self.mistakes: list[tuple[int, str]] = []

    def note(self, where: Where, sentence: str) -> None:
        self.mistakes.append((self.find_line(where), _in_one_line(sentence)))

    def find_line(self, where: Where) -> int:
        """Its line, or that of the innermost thing around it with a known one."""
        while where and where not in self.lines:
            where = where[:-1]
        return self.lines.get(where, 1)

    def read(self, content: dict, workers: int) -> Job | None:
        given = self.check(content, SHARED, ())
        out = self.folder / given.get("out", "results")
        if os.path.lexists(out) and not os.path.isdir(out):
            self.note(("out",), f"{out} is no folder; name one for the results.")
        options = self.read_options(given, workers)
        if "scene" not in content:
            self.note((), 'There is no [[scene]]; each has files = ["a.blend"], or generate.')
        sources = [
            source
            for number, scene in enumerate(given.get("scene", ()))
            for source in self.read_scene(scene, ("scene", number), out)
        ]
        _, mistakes = name_scenes(sources)
        for source, sentence in mistakes:
            self.mistakes.append((source.place[1], _in_one_line(sentence)))
        return Job(sources, out, options) if options else None

    def check(self, table: dict, kinds: dict[str, Kind], where: Where) -> dict:
        """Those entries of a table that are allowed."""
        good = {}
        for key, value in table.items():
            if key not in kinds:
                near = difflib.get_close_matches(key, kinds, 1)
                meant = f" (did you mean {near[0]}?)" if near else ""
                known = ", ".join(kinds)
                self.note(
                    (*where, key), f"There is no key {_show(key)} here{meant}; there are {known}."
                )
            elif not kinds[key].allows(value):
                sentence = f"{key} cannot be {_show(value)}; it must be {kinds[key].told}."
                self.note((*where, key), sentence)
            else:
                good[key] = value
        return good

    def read_options(self, given: dict, workers: int) -> Options | None:
        if "seconds" in given and "samples" in given:
            self.note(("samples",), "seconds and samples exclude each other; give one of them.")
        kind = "samples" if "samples" in given else "seconds"
        values = {name: given[name] for name in given if name in Options.__dataclass_fields__}
        values |= {"budget_kind": kind, "tree": self.read_tree(given.get("tree", {}))}
        values |= {"workers": workers}
        if kind in given:
            values["budgets"] = tuple(dict.fromkeys(map(_plain, given[kind])))
        if "methods" in given:
            values["methods"] = tuple(dict.fromkeys(given["methods"]))
        try:
            return Options(**values)
        except OptionError as error:
            for option, sentence in error.mistakes:
                if option == "workers":  # which is not of the file
                    raise InputError(sentence) from None
                self.note((kind if option == "budgets" else option,), sentence)

    def read_tree(self, table: dict) -> dict[str, Any]:
        """What `[tree]` sets, by its names in `scene.lighttree`."""
        tree = {}
        for name, value in self.check(table, TREE, ("tree",)).items():
            text = {True: "on", False: "off"}[value] if isinstance(value, bool) else value
            try:
                options = TreeOptions.parse([f"{name}={text}"])
            except ValueError as error:
                self.note(("tree", name), f"{error}.")
            else:
                tree[f"tree_{name}"] = getattr(options, name)
        return tree

    def read_scene(self, table: dict, where: Where, out: Path) -> Iterator[Source]:
        """The scenes of a [[scene]]: each of its files, from each camera, at each frame."""
        scene = self.check(table, SCENE, where)
        if ("files" in table) == ("generate" in table):
            self.note(where, "A scene has either files or generate; give one of them.")
        for key in ("lights", "seed"):
            if key in scene and "files" in table:
                self.note((*where, key), f"{key} is of scenes to generate; files have their own.")
        for frame in scene.get("frames", ()):
            try:
                Options(frames=(frame,))
            except OptionError as error:
                self.note((*where, "frames"), str(error))
        asks = "files" if "files" in table else "generate"
        place = str(self.path), self.find_line((*where, asks))
        files = [(file, None) for file in self.find_files(scene.get("files", ()), where)]
        if "generate" in scene:
            files += self.read_recipe(scene, where, out)
        for file, recipe in files:
            for camera in dict.fromkeys(scene.get("cameras", (None,))):
                for frame in dict.fromkeys(scene.get("frames", (None,))):
                    shown = scene.get("scene"), scene.get("view_layer")
                    yield Source(file, camera, frame, recipe, place, *shown)

    def read_recipe(self, scene: dict, where: Where, out: Path) -> list[tuple[Path, Recipe]]:
        from .scenes import check_recipe  # imports bpy

        name, lights, seed = scene["generate"], scene.get("lights"), scene.get("seed", 0)
        try:
            check_recipe(name, lights)
        except ValueError as error:
            key = "generate" if lights is None else "lights"
            self.note((*where, key), str(error))
            return []
        stem = name + (f"-{lights}" if lights else "") + (f"-seed{seed}" if seed else "")
        return [(out / f"{stem}.blend", Recipe(name, lights, seed))]

    def find_files(self, patterns: Iterable[str], where: Where) -> list[Path]:
        """The files that are named; a name that is no file's is a pattern like shots/*.blend."""
        files = {}
        for pattern in patterns:
            path = self.folder / pattern
            if os.path.isfile(path) or not glob.has_magic(pattern):
                found = [path]  # that a file is missing is told by `name_scenes`
            else:
                found = map(self.folder.joinpath, sorted(glob.glob(pattern, root_dir=self.folder)))
                found = [path for path in found if path.suffix.lower() == ".blend"]
            if not found:
                sentence = f"{_show(pattern)} matches no .blend; patterns are like shots/*.blend."
                self.note((*where, "files"), sentence)
            files |= dict.fromkeys(found)
        return list(files)


def _plain(number: float) -> float:
    """2 for 2.0, as headers have it."""
    return int(number) if type(number) is float and number.is_integer() else number


def _show(value: Any) -> str:
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _in_one_line(text: str) -> str:
    return textwrap.shorten(text, 400, placeholder=" ...")
