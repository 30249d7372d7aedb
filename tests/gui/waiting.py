"""Run by Blender with its window: how long a user waits, and how long the window stands still.

    blender SCENE.blend --window-geometry 0 0 1600 1000 --python tests/gui/waiting.py -- OUT.json

OUT.json gets for each step the seconds until its picture is drawn, the longest gap between two
calls of a timer, and the longest calls of `view_update` and `view_draw`. Of gaps, "solid_redrawn"
has those that Blender makes by drawing its window, which is slow where Mesa draws in software.
"""

import inspect
import json
import sys
import time
import traceback
from pathlib import Path

import bpy
from bl_ext.user_default.lighttree.engine import LightTreeEngine
from bl_ext.user_default.lighttree.viewport import Viewport, redraw_views

OUT = Path(sys.argv[sys.argv.index("--") + 1])
PATIENCE_S = 60
NUM_EDITS = 3
REST_S = 3.0  # after each picture, while it is refined

result = {}
jobs = {}  # address of a picture -> what was rendered
drawn = []  # (when, picture)
calls = {}  # name -> seconds
gaps = []


def watch(owner, name, after=lambda self: None):
    """Note how long a method takes."""
    method = getattr(owner, name)

    def watched(self, *args):
        start = time.monotonic()
        method(self, *args)
        calls.setdefault(name, []).append(time.monotonic() - start)
        after(self)

    # Blender counts the arguments of its callbacks.
    names = inspect.signature(method).parameters
    of_blender = {"watched": watched}
    exec(f"def {name}({', '.join(names)}): watched({', '.join(names)})", of_blender)
    setattr(owner, name, of_blender[name])


def remember(view):
    jobs[id(view.picture)] = view.picture, view._rendered


watch(Viewport, "_show", remember)
watch(Viewport, "draw", lambda view: drawn.append((time.monotonic(), view._drawn)))
watch(LightTreeEngine, "view_update")
watch(LightTreeEngine, "view_draw")


def steps():
    scene = bpy.context.scene
    scene.render.engine = "LIGHTTREE"
    bpy.context.preferences.view.show_splash = False
    window = bpy.context.window_manager.windows[0]
    space = next(a for a in window.screen.areas if a.type == "VIEW_3D").spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    yield 10  # for Blender's own start
    forget()
    yield REST_S
    result["solid"] = [found()]
    forget()
    end = time.monotonic() + REST_S
    while time.monotonic() < end:
        redraw_views(bpy.context)
        yield 0.25
    result["solid_redrawn"] = [found()]
    yield from seen("first_picture", lambda: setattr(space.shading, "type", "RENDERED"))
    meshes = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    lamps = [thing for thing in bpy.data.objects if thing.type == "LIGHT"]
    glass = bpy.data.materials.new("Glass")
    glass.use_nodes = True
    nodes = glass.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new("ShaderNodeBsdfGlass"), nodes.new("ShaderNodeOutputMaterial")
    glass.node_tree.links.new(shader.outputs[0], output.inputs[0])
    for i in range(NUM_EDITS):
        yield from seen("move_mesh", lambda i=i: setattr(meshes[i].location, "z", 0.1))
        yield from seen("move_light", lambda i=i: setattr(lamps[i].location, "z", 3))
        yield from seen("add_light", lambda i=i: add_light(scene, i))
        yield from seen("assign_glass", lambda i=i: assign(meshes[i], glass))
    space.shading.type = "SOLID"
    yield 1
    assert not Viewport.open_ones


def add_light(scene, i):
    data = bpy.data.lights.new("New", "POINT")
    data.energy = 100
    thing = bpy.data.objects.new("New", data)
    thing.location = i, 0, 4
    scene.collection.objects.link(thing)


def assign(thing, material):
    thing.data.materials.clear()
    thing.data.materials.append(material)


def seen(name, change):
    """Change the scene, wait until that is seen, and then a while."""
    forget()
    last = {id(job) for _, job in jobs.values()}
    start = time.monotonic()
    change()
    end = start + PATIENCE_S
    while not (new := [when for when, picture in drawn if is_new(picture, last)]):
        assert time.monotonic() < end, f"{name}: nothing happens"
        yield 0.01
    seconds = new[0] - start
    yield REST_S
    result.setdefault(name, []).append({"seconds": seconds, **found()})


def is_new(picture, last):
    return picture is not None and id(picture) in jobs and id(jobs[id(picture)][1]) not in last


def forget():
    drawn.clear()
    gaps.clear()
    calls.clear()
    for key in list(jobs)[:-1]:
        del jobs[key]


def found():
    """The longest gap, and of each method the longest call."""
    return {"gap_s": max(gaps), **{name: max(values) for name, values in calls.items()}}


def beat(state={"last": None}):  # noqa: B006  kept between calls
    now = time.monotonic()
    if state["last"] is not None:
        gaps.append(now - state["last"])
    state["last"] = now
    return 0.005


def tick(running=steps()):  # noqa: B008  one run of the steps, kept between calls
    try:
        return next(running)
    except StopIteration:
        pass
    except Exception:
        result["failed"] = traceback.format_exc()
    OUT.write_text(json.dumps(result, indent=1))
    bpy.ops.wm.quit_blender()
    return None


bpy.app.timers.register(beat)
bpy.app.timers.register(tick, first_interval=3)
