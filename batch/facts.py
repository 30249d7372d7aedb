"""What an inspection found out about a scene, kept in its folder for as long as it holds."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import os
import platform
import re
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from lighttree_core.compilation import are_kernels_compiled

from .images import replacing
from .methods import CYCLES, LIGHTTREE
from .plan import Source
from .process import running_blender

FILE = "inspected.json"
PACKAGES = ("lighttree", "numba", "embreex", "numpy")
UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError)


def save_facts(facts: dict, source: Source, folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    asked = {"asked": list(source.view)}
    with replacing(folder / FILE) as temp:
        temp.write_text(json.dumps(facts | asked), encoding="utf-8")


def load_facts(folder: Path) -> dict:
    """What was once found in a scene; raises one of UNREADABLE."""
    return json.loads((folder / FILE).read_text(encoding="utf-8"))


def still_hold(facts: dict, source: Source) -> bool:
    """Whether a scene and what renders it are what they were; raises one of UNREADABLE."""
    return (
        facts["asked"] == list(source.view)
        and hash_files([source.file, *facts["files"]]) == facts["file_sha256"]
        and facts["renderers"] == describe_renderers()
    )


def read_facts(source: Source, folder: Path) -> dict | None:
    """What was found in a scene; None if nobody looked, or if it or its renderers have changed."""
    try:
        facts = load_facts(folder)
        holds = (
            still_hold(facts, source)
            and facts["versions"].items() >= describe_packages().items()
            and "view_layer" in facts  # not in those of earlier versions
            and are_kernels_compiled()  # which an inspection sees to
        )
    except UNREADABLE:
        return None
    return facts if holds else None


def is_since_inspection(path: Path) -> bool:
    """Whether a file in a scene's folder is of the scene as it was last inspected."""
    return path.exists() and path.stat().st_mtime > path.with_name(FILE).stat().st_mtime


def describe_packages() -> dict[str, str]:
    """Versions of what renders with LightTree."""
    return {name: version(name) for name in PACKAGES} | {"python": platform.python_version()}


@functools.cache
def describe_renderers() -> dict[str, str]:
    """What renders, by engine, with a hash of all of ours that has a say in images."""
    settings = Path(__file__).with_name("methods.py")
    sources = [settings]
    for name in ("lighttree_core", "lighttree_addon"):
        (folder,) = importlib.util.find_spec(name).submodule_search_locations
        sources += sorted(p for p in Path(folder).rglob("*") if p.suffix in (".py", ".npz"))
    blender = f"Blender {_blender_version()}"
    return {
        CYCLES: f"{blender}, settings {hash_files([settings])[:16]}",
        LIGHTTREE: f"LightTree {version('lighttree')} {hash_files(sources)[:16]}, {blender}",
    }


@functools.cache
def describe_machine() -> dict:
    """What the seconds of a render depend on."""
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


def hash_files(paths: Iterable[str | Path]) -> str:
    """SHA-256 over the contents of those of the files that there are."""
    digest = hashlib.sha256()
    for path in map(Path, paths):
        if path.is_file():
            with open(path, "rb") as content:
                digest.update(hashlib.file_digest(content, "sha256").digest())
    return digest.hexdigest()


def _blender_version() -> str:
    if blender := running_blender():
        return ".".join(map(str, blender.app.version))
    return version("bpy")
