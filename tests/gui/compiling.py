"""Run by Blender with its window and no compiled kernels: what is shown meanwhile, what is stopped.

    blender --window-geometry 0 0 1600 1000 --python tests/gui/compiling.py -- FOLDER

FOLDER gets compiling.json and a screenshot. Blender is quit while it compiles.
"""

import json
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path

import addon_utils
import bpy
from bl_ext.user_default.lighttree import kernels
from bl_ext.user_default.lighttree.viewport import Viewport

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
MODULE = "bl_ext.user_default.lighttree"
PATIENCE_S = 60

result, messages, ends = {}, [], []


def steps():
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.use_preferences_save = False  # LightTree is to stay enabled
    scene = bpy.context.scene
    scene.render.engine = "LIGHTTREE"
    yield from until(lambda: kernels.Compilation.running.share > 0.02)
    bpy.ops.screen.userpref_show("INVOKE_DEFAULT", section="EXTENSIONS")
    bpy.ops.preferences.addon_show(module=MODULE)
    yield 2
    if shutil.which("import"):
        subprocess.run(["import", "-window", "root", str(FOLDER / "compiling.png")], check=True)
    windows = bpy.context.window_manager.windows
    with bpy.context.temp_override(window=windows[-1]):
        bpy.ops.wm.window_close()
    yield 1
    yield from look_at_viewport(windows[0])
    yield from press_escape()
    result["before_disabling"] = children()
    start = time.monotonic()
    addon_utils.disable(MODULE)
    result["disabling_s"] = time.monotonic() - start
    result["after_disabling"] = children()
    addon_utils.enable(MODULE)
    yield from until(lambda: len(children()) >= 2)
    result["before_quitting"] = children()


def look_at_viewport(window):
    """Rendered shading waits and says so, and stops waiting once it is closed."""
    space = next(a for a in window.screen.areas if a.type == "VIEW_3D").spaces.active
    space.shading.type = "RENDERED"
    yield from until(lambda: Viewport.open_ones)
    view = next(iter(Viewport.open_ones))
    yield from until(lambda: "ompiling" in view.message)
    result["viewport"] = view.message
    space.shading.type = "SOLID"
    yield from until(lambda: not view._thread.is_alive())


def press_escape():
    """F12 waits and says so, until Escape."""
    if not shutil.which("xdotool"):
        return
    bpy.context.preferences.view.render_display_type = "NONE"
    bpy.app.handlers.render_stats.append(lambda text, _: messages.append(text))
    bpy.app.handlers.render_cancel.append(lambda *_: ends.append(time.monotonic()))
    bpy.ops.render.render("INVOKE_DEFAULT")
    yield from until(lambda: any("ompiling" in text for text in messages))
    result["f12"] = messages[-1]
    start = time.monotonic()
    subprocess.run(["xdotool", "key", "Escape"], check=True)
    yield from until(lambda: ends and not bpy.app.is_job_running("RENDER"))
    result["cancel_s"] = ends[0] - start


def children():
    """Processes that this one has started, where Linux tells."""
    found = Path("/proc/self/task").glob("*/children")
    return [int(pid) for path in found for pid in path.read_text().split()]


def until(is_so):
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end, "nothing happens"
        yield 0.01


def tick(running=steps()):  # noqa: B008  one run of the steps, kept between calls
    try:
        return next(running)
    except StopIteration:
        pass
    except Exception:
        result["failed"] = traceback.format_exc()
    (FOLDER / "compiling.json").write_text(json.dumps(result))
    bpy.ops.wm.quit_blender()
    return None


bpy.app.timers.register(tick, first_interval=3)
