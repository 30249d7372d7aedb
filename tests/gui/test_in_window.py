"""Blender's window, driven by `window.py`: what a user waits for, and what is left behind.

As `test_installed.py`, which comes after it and uninstalls, with a display. LIGHTTREE_SCREENSHOTS
may name a folder for pictures.
"""

import json
import os
import shutil
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
