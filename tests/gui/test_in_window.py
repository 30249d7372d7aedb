"""Blender's window, driven by scripts: what a user waits for, and what is left behind.

As `test_installed.py`, which comes after it and uninstalls, with a display. LIGHTTREE_SCREENSHOTS
may name a folder for pictures.
"""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image


@pytest.fixture(scope="session")
def result(scene, folder, blender):
    if not os.environ.get("DISPLAY"):
        pytest.skip("There is no display to open a window on: DISPLAY is not set.")
    path, *_ = scene
    script = shutil.copy(Path(__file__).with_name("window.py"), folder)
    blender(path, "--window-geometry", 0, 0, 1600, 1000, "--python", script, "--", folder)
    if pictures := os.environ.get("LIGHTTREE_SCREENSHOTS"):
        for picture in folder.glob("*.png"):
            shutil.copy(picture, pictures)
    found = json.loads((folder / "result.json").read_text())
    assert "failed" not in found, found["failed"]
    return found


@pytest.fixture(scope="session")
def waits(scene, folder, blender):
    """What `waiting.py` measures in a city of a thousand lights."""
    if not os.environ.get("DISPLAY"):
        pytest.skip("There is no display to open a window on: DISPLAY is not set.")
    path, out = folder / "thousand.blend", folder / "waits.json"
    blender("--command", "lighttree", "scene", "city-small", "--lights", "1000", "-o", path)
    script = shutil.copy(Path(__file__).with_name("waiting.py"), folder)
    blender(path, "--window-geometry", 0, 0, 1600, 1000, "--python", script, "--", out)
    found = json.loads(out.read_text())
    assert "failed" not in found, found["failed"]
    return found


@pytest.fixture(scope="session")
def compiling(scene, folder, blender, tmp_path_factory):
    """What `compiling.py` finds while kernels are compiled."""
    if not os.environ.get("DISPLAY"):
        pytest.skip("There is no display to open a window on: DISPLAY is not set.")
    cache = str(tmp_path_factory.mktemp("cache"))
    script = shutil.copy(Path(__file__).with_name("compiling.py"), folder)
    window = ("--window-geometry", 0, 0, 1600, 1000)
    caches = {"XDG_CACHE_HOME": cache, "LOCALAPPDATA": cache}
    blender(*window, "--python", script, "--", folder, environment=caches)
    found = json.loads((folder / "compiling.json").read_text())
    assert "failed" not in found, found["failed"]
    return found


def test_who_waits_for_kernels_is_told(compiling):
    assert "Compiling kernels" in compiling["viewport"]
    if "f12" in compiling:
        assert "Compiling kernels" in compiling["f12"] and compiling["cancel_s"] < 5


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for processes")
def test_nothing_compiles_on_after_disabling_or_quitting(compiling):
    assert compiling["before_disabling"] and not compiling["after_disabling"]
    assert compiling["disabling_s"] < 2
    assert compiling["before_quitting"]
    for pid in compiling["before_quitting"]:
        command = Path(f"/proc/{pid}/cmdline")
        assert not command.exists() or b"compile_part" not in command.read_bytes()


EDITS = "move_mesh", "move_light", "add_light", "assign_glass"


def test_pictures_come_soon(waits):
    assert waits["first_picture"][0]["seconds"] < 10
    for name in EDITS:
        assert np.median([step["seconds"] for step in waits[name]]) < 4, name


def test_the_window_does_not_stall(waits):
    usual = waits["solid_redrawn"][0]["gap_s"]  # Blender's own
    for name in EDITS:
        assert np.median([step["gap_s"] for step in waits[name]]) < usual + 1, name
        assert max(step["view_draw"] for step in waits[name]) < 0.2, name


def test_an_edit_is_seen_within_a_second(result):
    assert np.median(result["edits_s"]) < 1


def test_edits_leave_no_view_and_no_memory_behind(result):
    memory = result["memory_mib"]
    assert result["num_views"] == 1
    assert np.mean(memory[-10:]) < 1.05 * np.mean(memory[10:20])


@pytest.mark.parametrize("name", ["viewport", "overlay"])
def test_something_is_drawn(name, result, folder):
    assert result["overlay_problem"] == ""
    picture = np.asarray(Image.open(folder / f"{name}.png").convert("L"), float)
    height, width = picture.shape
    assert picture[height // 4 : height * 3 // 4, : width // 2].std() > 10


def test_escape_stops_a_render_at_once(result):
    if "cancels_s" not in result:
        pytest.skip("xdotool, which presses keys, is not installed")
    assert np.median(result["cancels_s"]) < 0.3
    assert result["memory_after_cancels_mib"] < 1.2 * max(result["memory_mib"])
