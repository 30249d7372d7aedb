"""Run by Blender with its window: press what a user presses, write down what happens.

    blender CITY.blend --python tests/gui/window.py -- FOLDER

FOLDER gets result.json and a screenshot of each step.
"""

import json
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path

import bpy
from bl_ext.user_default.lighttree.viewport import Viewport

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
NUM_EDITS, NUM_CANCELS = 100, 50
PATIENCE_S = 120

result = {}
messages = []  # of renders
ends = []  # when renders ended


def steps():
    """What is done, one thing after the other; yields how many seconds Blender has for itself."""
    scene = bpy.context.scene
    scene.render.engine = "LIGHTTREE"
    bpy.context.preferences.view.show_splash = False
    area = next(a for a in window().screen.areas if a.type == "VIEW_3D")
    yield from edit_in_viewport(area)
    yield from look_at_tree(area)
    yield from cancel_renders(scene)


def edit_in_viewport(area):
    """Rendered shading, then lamps and a mesh that move."""
    space = area.spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    start = time.monotonic()
    space.shading.type = "RENDERED"
    yield from until(lambda: Viewport.open_ones and view().picture is not None)
    result["first_picture_s"] = time.monotonic() - start
    yield 10
    screenshot("viewport")
    lamps = [thing for thing in bpy.data.objects if thing.type == "LIGHT"]
    result["edits_s"], result["memory_mib"] = [], []
    for i in range(NUM_EDITS):
        yield from edit(lambda i=i: setattr(lamps[i % len(lamps)].location, "z", 3 + 0.01 * i))
        result["memory_mib"].append(memory_mib())
    mesh = next(thing for thing in bpy.data.objects if thing.type == "MESH")
    yield from edit(lambda: setattr(mesh.location, "z", 0.01))
    result["num_views"] = len(Viewport.open_ones)
    space.shading.type = "SOLID"
    yield from until(lambda: not Viewport.open_ones)
    space.overlay.show_overlays = True


def edit(change):
    """Change the scene and wait for the picture of it."""
    before, start = view().picture, time.monotonic()
    change()
    yield from until(lambda: view().picture is not before)
    result["edits_s"].append(time.monotonic() - start)


def look_at_tree(area):
    overlay = bpy.context.window_manager.lighttree_overlay
    overlay.show, overlay.depth = True, 2
    yield 2
    result["overlay_problem"] = overlay.problem
    screenshot("overlay")
    overlay.show = False


def cancel_renders(scene):
    """F12 and Escape, again and again."""
    if not shutil.which("xdotool"):  # Blender's own simulated keys do not reach a render
        return
    bpy.context.preferences.view.render_display_type = "NONE"
    scene.lighttree.samples = 2**20
    bpy.app.handlers.render_stats.append(lambda text, _: messages.append(text))
    bpy.app.handlers.render_cancel.append(lambda *_: ends.append(time.monotonic()))
    result["cancels_s"] = []
    for _ in range(NUM_CANCELS):
        messages.clear()
        bpy.ops.render.render("INVOKE_DEFAULT")
        yield from until(lambda: any("Sample" in text for text in messages))
        ends.clear()
        start = time.monotonic()
        subprocess.run(["xdotool", "key", "Escape"], check=True)
        yield from until(lambda: ends and not bpy.app.is_job_running("RENDER"))
        result["cancels_s"].append(ends[0] - start)
    result["memory_after_cancels_mib"] = memory_mib()


def window():
    return bpy.context.window_manager.windows[0]


def view():
    return next(iter(Viewport.open_ones))


def until(is_so):
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end, "nothing happens"
        yield 0.01


def screenshot(name):
    path = str(FOLDER / f"{name}.png")
    if shutil.which("import"):  # ImageMagick; Blender's own are black where Mesa draws in software
        subprocess.run(["import", "-window", "root", path], check=True)
        return
    with bpy.context.temp_override(window=window()):
        bpy.ops.screen.screenshot(filepath=path)


def memory_mib():
    status = Path("/proc/self/status")
    if not status.exists():
        return 0
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return int(lines["VmRSS"].split()[0]) / 1024


def tick(running=steps()):  # noqa: B008  one run of the steps, kept between calls
    try:
        return next(running)
    except StopIteration:
        pass
    except Exception:
        result["failed"] = traceback.format_exc()
        screenshot("failed")
    (FOLDER / "result.json").write_text(json.dumps(result))
    bpy.ops.wm.quit_blender()
    return None


bpy.app.timers.register(tick, first_interval=3)
