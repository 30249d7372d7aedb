"""The extension in a real Blender: installed from its zip, rendering, switched off and on, removed.

    LIGHTTREE_BLENDER=/opt/blender/blender LIGHTTREE_EXTENSION=dist/lighttree-....zip \\
        python -m pytest tests/gui
"""

import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from lighttree_batch.images import read_render

BLENDER = os.environ.get("LIGHTTREE_BLENDER")
ZIP = os.environ.get("LIGHTTREE_EXTENSION")
MODULE = "bl_ext.user_default.lighttree"
BESIDE_CYCLES = Path(__file__).parent.parent / "beside_cycles.py"

pytestmark = pytest.mark.skipif(
    not (BLENDER and ZIP),
    reason="LIGHTTREE_BLENDER must name a blender, and LIGHTTREE_EXTENSION the zip for it",
)

PRESS_F12 = f"""
import bpy
from {MODULE} import engine
engine.progress_listener = lambda share, text: print(text)
scene = bpy.context.scene
scene.render.engine = "LIGHTTREE"
scene.render.resolution_x, scene.render.resolution_y = 160, 90
scene.lighttree.samples = 4
scene.render.filepath = "//f12.png"
bpy.ops.render.render(write_still=True)
"""

# Counts what an add-on has added to Blender, on and off.
SWITCH = f"""
import addon_utils, bpy
def count():
    lists = [item for item in bpy.app.handlers if isinstance(item, list)]
    names = [*dir(bpy.types), *dir(bpy.types.Scene)]
    names += [handler.__module__ for handlers in lists for handler in handlers]
    for panel in bpy.types.Panel.__subclasses__():
        names += getattr(panel, "COMPAT_ENGINES", ()) if panel.is_registered else ()
    return sum("lighttree" in name.lower() for name in names)
print("on", count())
for _ in range(2):
    addon_utils.disable("{MODULE}")
    print("off", count())
    addon_utils.enable("{MODULE}")
    print("on", count())
repos = [repo.module for repo in bpy.context.preferences.extensions.repos]
bpy.ops.extensions.package_uninstall(repo_index=repos.index("user_default"), pkg_id="lighttree")
print("off", count())
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("blender")


@pytest.fixture(scope="module")
def blender(folder):
    """Run Blender with settings and caches of its own; returns what it prints."""
    own = {"BLENDER_USER_RESOURCES": folder / "user", "XDG_CACHE_HOME": folder / "cache"}
    own["LOCALAPPDATA"] = folder / "cache"
    environment = os.environ | {name: str(path) for name, path in own.items()}

    def run(*arguments, status=0):
        command = [BLENDER, *map(str, arguments)]
        done = subprocess.run(
            command, env=environment, cwd=folder, capture_output=True, text=True, encoding="utf-8"
        )
        output = done.stdout + done.stderr
        assert done.returncode == status and "Traceback" not in output, output
        return output

    return run


@pytest.fixture(scope="module")
def scene(folder, blender):
    """The extension installed, as from a zip dropped into the window, and a city rendered by it."""
    blender("--command", "extension", "validate", ZIP)
    start = time.monotonic()
    blender("--command", "extension", "install-file", "-r", "user_default", "-e", ZIP)
    path = folder / "city.blend"
    blender("--command", "lighttree", "scene", "city-small", "--lights", "300", "-o", path)
    output = blender("--background", path, "--python-exit-code", "1", "--python-expr", PRESS_F12)
    seconds = time.monotonic() - start
    return path, output, seconds


def test_the_first_picture_comes_within_two_minutes_of_installing(scene):
    path, output, seconds = scene
    assert path.with_name("f12.png").stat().st_size > 1000
    assert "Compiling kernels (first run only" in output
    assert seconds < 120


def test_cycles_renders_the_same_bits_beside_lighttree(scene, folder, blender):
    script = BESIDE_CYCLES.read_text(encoding="utf-8")
    run = ("--python-exit-code", "1", "--python-expr", script, "--", folder)
    blender("--background", "--factory-startup", *run, "CYCLES")
    alone, _ = read_render(folder / "0.exr")
    blender("--background", *run, "CYCLES", "LIGHTTREE", "CYCLES")
    before, ours, after = (read_render(folder / f"{i}.exr")[0] for i in range(3))
    assert np.array_equal(before, alone) and np.array_equal(after, alone)
    assert ours.any() and not np.array_equal(ours, alone)


def test_the_command_line_is_there(scene, blender):
    path, *_ = scene
    assert "compare" in blender("--command", "lighttree", "--help")
    assert "Missing argument" in blender("--command", "lighttree", "compare", status=2)
    render = ("--command", "lighttree", "render", "--samples", "1", "-o", path.with_suffix(".exr"))
    assert "1 samples a pixel" in blender(path, *render)
    assert path.with_suffix(".exr").exists()


def test_compare_writes_a_report_by_both_ways_in(scene, folder, blender):
    path, *_ = scene
    compare = ["compare", "--samples", "1", "--seeds", "1", "--resolution", "64x36"]
    compare += ["--methods", "lighttree,cycles", "--reference-seconds", "1"]
    blender(path, "--command", "lighttree", *compare, "--out", folder / "command")
    expression = "from lighttree_batch.__main__ import main; exit(main())"
    expression = ("--python-expr", expression, "--", *compare, "--out", folder / "expression")
    blender("--background", path, *expression)
    for name in ("command", "expression"):
        page = (folder / name / "report.html").read_text(encoding="utf-8")
        assert "MakeFlipBook" in page and "city.blend" in page


def test_switched_off_or_removed_it_leaves_nothing(scene, folder, blender):
    output = blender("--background", "--python-exit-code", "1", "--python-expr", SWITCH)
    lines = [line.split() for line in output.splitlines() if line.startswith(("on ", "off "))]
    assert [word for word, _ in lines] == ["on", "off"] * 3
    assert len({count for word, count in lines if word == "on"}) == 1 and lines[0][1] != "0"
    assert {count for word, count in lines if word == "off"} == {"0"}
    assert not list((folder / "user/extensions").rglob("lighttree*"))
    assert "Unrecognized command" in blender("--command", "lighttree", "--help", status=1)
