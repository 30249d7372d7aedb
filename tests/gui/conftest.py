"""A real Blender with settings and caches of its own, and the extension installed in it."""

import os
import subprocess
import time

import pytest

BLENDER = os.environ.get("LIGHTTREE_BLENDER")
ZIP = os.environ.get("LIGHTTREE_EXTENSION")

PRESS_F12 = """
import bpy
from bl_ext.user_default.lighttree import engine
engine.progress_listener = lambda share, text: print(text)
scene = bpy.context.scene
scene.render.engine = "LIGHTTREE"
scene.render.resolution_x, scene.render.resolution_y = 160, 90
scene.lighttree.samples = 4
scene.render.filepath = "//f12.png"
bpy.ops.render.render(write_still=True)
"""


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("blender")


@pytest.fixture(scope="session")
def blender(folder):
    """Run Blender with settings and caches of its own; returns what it prints."""
    if not (BLENDER and ZIP):
        pytest.skip("LIGHTTREE_BLENDER must name a blender, and LIGHTTREE_EXTENSION the zip for it")
    own = {"BLENDER_USER_RESOURCES": folder / "user", "XDG_CACHE_HOME": folder / "cache"}
    own["LOCALAPPDATA"] = folder / "cache"
    own = os.environ | {name: str(path) for name, path in own.items()}

    def run(*arguments, status=0, environment=None):
        command = [BLENDER, *map(str, arguments)]
        done = subprocess.run(
            command,
            env=own | (environment or {}),
            cwd=folder,
            capture_output=True,
            text=True,
            encoding="utf-8",
        )
        output = done.stdout + done.stderr
        assert done.returncode == status and "Traceback" not in output, output
        return output

    return run


@pytest.fixture(scope="session")
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
