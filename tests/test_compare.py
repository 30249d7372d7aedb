"""Compare with Cycles: what it tells, what it leaves alone, how it ends, what its panel shows."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import blender_scenes as blend
import bpy
import numpy as np
import pytest
from matplotlib.image import imread

import lighttree_addon
from lighttree_addon import compare, comparison, panels, picture
from lighttree_batch.blend import keep_shown
from lighttree_batch.images import read_exr, write_exr
from lighttree_batch.process import RenderError
from lighttree_batch.side_by_side import Column, develop, draw_picture, translate

pytestmark = pytest.mark.blender

TESTS = str(Path(__file__).parent)
SIMPLE = {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}


@pytest.fixture(scope="module", autouse=True)
def registered():
    lighttree_addon.register()
    yield
    lighttree_addon.unregister()


def new_scene(seconds=0.3):
    """A lamp over a floor before a camera, 32 x 18 pixels to compare."""
    scene = blend.new_file()
    scene.render.engine = "LIGHTTREE"
    scene.render.resolution_x, scene.render.resolution_y = 64, 36
    scene.lighttree_compare.seconds = seconds
    scene.lighttree_compare.percentage = 50
    blend.add_plane(20, blend.new_material("Plain"), name="Floor")
    blend.add_lamp("POINT", location=(0, 0, 2))
    blend.add_camera(location=(0, 0, 5))
    return scene


def add_poster(folder):
    """A plane that emits a green image, found by its path relative to the file."""
    (folder / "textures").mkdir()
    image = bpy.data.images.new("paint", 4, 4)
    image.pixels.foreach_set(np.tile(np.array([0, 1, 0, 1], np.float32), 16))
    image.filepath_raw, image.file_format = str(folder / "textures/paint.png"), "PNG"
    image.save()
    image.source, image.filepath = "FILE", "//textures/paint.png"
    material = blend.new_material("Poster", "ShaderNodeEmission")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    emission = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeEmission")
    material.node_tree.links.new(texture.outputs[0], emission.inputs[0])
    blend.add_plane(2, material, name="Poster", location=(-1, 0, 3))


def link_board(folder):
    """A plane that emits red, linked by relative path from a library beside the file."""
    blend.new_file()
    material = blend.new_material("Board", "ShaderNodeEmission", Color=(1, 0, 0))
    blend.add_plane(2, material, name="Board", location=(1, 0, 3))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "library.blend"))
    new_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "night shot.blend"))
    with bpy.data.libraries.load("//library.blend", link=True, relative=True) as (_, here):
        here.objects = ["Board"]
    bpy.context.scene.collection.objects.link(here.objects[0])


def simple_properties(thing):
    """All numbers, texts and choices of a thing of Blender's, by name; use_nodes is deprecated."""
    return {
        prop.identifier: (getattr(thing, prop.identifier), thing.is_property_set(prop.identifier))
        for prop in thing.bl_rna.properties
        if prop.type in SIMPLE and prop.identifier != "use_nodes"
        if not getattr(prop, "is_array", False)
    }


def describe_file():
    """What is open: names of all data-blocks, settings of the scene."""
    scene = bpy.context.scene
    parts = (scene, scene.render, scene.render.image_settings, scene.view_settings, scene.cycles)
    parts += scene.lighttree, scene.lighttree_compare, *scene.view_layers, *bpy.data.lights
    parts += (scene.display_settings, *bpy.data.materials)
    blocks = {
        prop.identifier: sorted(block.name for block in getattr(bpy.data, prop.identifier))
        for prop in bpy.data.bl_rna.properties
        if prop.type == "COLLECTION"
    }
    images = [image for image in bpy.data.images if image.source == "FILE"]
    paths = [(image.filepath, bool(image.packed_file)) for image in images]
    paths += [library.filepath for library in bpy.data.libraries]
    return blocks, paths, [simple_properties(part) for part in parts]


def describe_saved(path):
    """The same of what saving now would keep, and nothing of what is open changes."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, relative_remap=False)
    code = "import sys; sys.path.insert(0, {!r}); import bpy, lighttree_addon, test_compare\n"
    code += "lighttree_addon.register(); bpy.ops.wm.open_mainfile(filepath={!r})\n"
    code += "print(test_compare.describe_file(), flush=True); import os; os._exit(0)"
    code = code.format(TESTS, str(path))
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def compared(registered, tmp_path_factory):
    """A comparison of a file with unsaved changes, and what was so before and after it."""
    folder = tmp_path_factory.mktemp("compared")
    link_board(folder)
    add_poster(folder)
    scene = bpy.context.scene
    scene.view_settings.view_transform = "AgX"
    bpy.ops.wm.save_mainfile()
    scene.objects["Lamp"].data.energy = 0.0  # not saved, so it must come with the copy
    scene.frame_set(7)
    facts = SimpleNamespace(folder=folder / "lighttree-compare")

    def note():
        opened = bpy.data.is_dirty, bpy.data.filepath
        return opened, describe_file(), describe_saved(folder / "saved.blend")

    facts.before = note()
    bpy.data.use_autopack = True
    facts.returned = bpy.ops.lighttree.compare()
    facts.packs, bpy.data.use_autopack = bpy.data.use_autopack, False
    facts.last = compare.last
    facts.picture = picture.find_picture()
    facts.image = (facts.picture.name, tuple(facts.picture.size), facts.picture.users)
    bpy.data.images.remove(facts.picture)
    facts.after = note()
    facts.again = picture.load_picture(facts.last.result["picture"])
    facts.with_image = describe_saved(folder / "saved.blend")
    return facts


def test_the_button_gives_a_table_a_picture_and_a_report(compared):
    assert compared.returned == {"FINISHED"} and compared.last.error == ""
    result = compared.last.result
    ours, theirs = result["table"]
    assert (ours["title"], theirs["title"]) == ("LightTree", "Cycles")
    for line in (ours, theirs):
        assert line["samples"] >= 1 and 0 < line["seconds"] < 5 and line["error"] >= 0
    assert imread(result["picture"]).shape[0] > 100 and Path(result["report"]).is_file()
    page = Path(result["report"]).read_text(encoding="utf-8")
    assert "night shot.blend, camera" in page and "Compare with Cycles, in Blender" in page
    left = {path.name for path in compared.folder.iterdir()}
    written = {".lock", "log.txt", "results.csv", "results.sqlite", "report.html", "run.json"}
    assert left == written | {"night_shot", "side-by-side.png"}


def test_both_engines_saw_the_scene_as_it_was_open_with_its_texture_and_library(compared):
    for name in ("reference-lighttree", "reference-cycles"):
        image, header = read_exr(compared.folder / f"night_shot/{name}.exr")
        assert header["resolution"] == [32, 18]
        row = [[image[c][9, x] for c in "RGB"] for x in (13, 18)]
        np.testing.assert_allclose(row, [[0, 1, 0], [1, 0, 0]], atol=0.02)
        # Only poster and board shine: the lamp, which shines in the file on disk, is out.
        assert image["R"][0, 0] < 0.05


def test_nothing_of_the_open_file_is_changed(compared):
    assert compared.before[:2] == compared.after[:2] and compared.packs


def test_a_saved_file_holds_nothing_of_it_not_even_the_image(compared):
    assert compared.before[2] == compared.after[2] == compared.with_image
    assert compared.image[0] == "LightTree Comparison" and compared.image[1][0] > 700
    assert picture.NAME not in compared.before[2]


def test_the_picture_is_one_image_however_often_it_is_loaded(compared):
    path = compared.last.result["picture"]
    image = picture.load_picture(path)
    assert picture.load_picture(path) == image and image.is_runtime_data
    mine = bpy.data.images.new("LightTree Comparison of mine", 4, 4)
    assert picture.load_picture(path) == image != mine


@pytest.fixture(params=["thread", "load", "unregister"])
def how_to_end(request):
    return request.param


def children(pid):
    """Processes that a process started, and those that they started."""
    listed = subprocess.run(["ps", "-eo", "pid=,ppid=,stat=,comm="], capture_output=True, text=True)
    lines = [line.split(maxsplit=3) for line in listed.stdout.splitlines()]
    found = {int(p) for p, parent, stat, name in lines if int(parent) == pid and name != "ps"}
    return found.union(*map(children, found))


def is_alive(pid):
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return state.stdout.strip()[:1] not in ("", "Z")


def wait_for(condition, seconds=60):
    started = time.monotonic()
    while not condition():
        assert time.monotonic() - started < seconds
        time.sleep(0.05)
    return time.monotonic() - started


needs_ps = pytest.mark.skipif(sys.platform == "win32", reason="asks ps for processes")


@needs_ps
def test_a_comparison_ends_with_all_its_processes(how_to_end, tmp_path):
    scene = new_scene(seconds=100)
    scene.lighttree_compare.folder = str(tmp_path / "out")
    others = children(os.getpid())
    compare.last = running = comparison.prepare(bpy.context)
    running._job["options"]["references"] = ["cycles"]  # the one that cannot be cancelled
    running.start()
    assert not bpy.ops.lighttree.compare.poll() and bpy.ops.lighttree.cancel_compare.poll()
    wait_for(lambda: running.text == "Cycles reference 1 of 8" and running.fraction > 0)
    started = children(os.getpid()) - others
    assert len(started) == 2  # one that leads and one that renders
    if how_to_end == "thread":
        assert bpy.ops.lighttree.cancel_compare() == {"FINISHED"}
    elif how_to_end == "load":
        bpy.ops.wm.read_homefile(use_empty=True)
    else:
        lighttree_addon.unregister()
        lighttree_addon.register()
    seconds = wait_for(lambda: not running.is_running and not any(map(is_alive, started)))
    assert seconds < 1.5
    zombies = [pid for pid in started if Path(f"/proc/{pid}").exists()]
    assert zombies == [] and running.result is None and running.error == ""
    assert not (tmp_path / "out/.copy").exists()


@needs_ps
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_goes_on_when_blender_is_killed(sent, tmp_path):
    code = f"""
import sys; sys.path.insert(0, {TESTS!r})
import bpy, lighttree_addon, test_compare
lighttree_addon.register()
test_compare.new_scene(seconds=100).lighttree_compare.folder = {str(tmp_path)!r}
bpy.ops.lighttree.compare()
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL) as blender:
        wait_for(lambda: len(children(blender.pid)) == 2 and (tmp_path / "run.json").exists())
        started = children(blender.pid)
        time.sleep(1)
        blender.send_signal(sent)
    assert wait_for(lambda: not any(map(is_alive, started)), 10) < 1.5


@needs_ps
def test_a_process_that_dies_is_told_in_a_sentence(tmp_path):
    new_scene(seconds=100).lighttree_compare.folder = str(tmp_path)
    others = children(os.getpid())
    running = comparison.prepare(bpy.context)
    running.start()
    wait_for(lambda: children(os.getpid()) - others)
    (leader,) = children(os.getpid()) - others
    os.kill(leader, signal.SIGKILL)
    wait_for(lambda: not running.is_running)
    assert running.error.startswith("The render process was killed (SIGKILL)")


def refusal():
    """The one sentence with which comparing the open scene is refused."""
    with pytest.raises(RuntimeError) as info:
        bpy.ops.lighttree.compare()
    text = str(info.value).strip()
    assert "\n" not in text and text == f"Error: LightTree: {compare.last.error}"
    return compare.last.error


def test_a_scene_without_a_camera_is_refused_at_once():
    scene = new_scene()
    bpy.data.objects.remove(scene.camera)
    assert refusal() == "The scene has no active camera; set one."


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path):
    (tmp_path / "file").touch()
    new_scene().lighttree_compare.folder = str(tmp_path / "file/deep")
    assert "file/deep: no results can be written there (Not a directory)" in refusal()


def test_what_only_the_processes_find_out_is_told_without_the_copy(tmp_path):
    scene = new_scene()
    scene.lighttree_compare.folder = str(tmp_path)
    scene.objects["Lamp"].data.energy = float("nan")
    error = refusal()
    assert "Lamp" in error and ".copy" not in error and "Traceback" not in error
    assert compare.last.result is None and not (tmp_path / ".copy").exists()


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(errno.ENOSPC, "full", "x.exr"), "The disk is full; make room and compare again."),
        (PermissionError(errno.EACCES, "Permission denied", "x"), "x: Permission denied."),
        (RenderError("/o/.copy/a.blend: it is broken."), "It is broken."),
        (ModuleNotFoundError("No module named 'rich'"), "install it anew (No module named 'rich')"),
        (KeyError("bug"), "The comparison failed: 'bug'. The console tells where."),
    ],
)
def test_every_error_is_one_sentence(error, sentence):
    assert sentence in comparison._explain(error, "/o/.copy/a.blend")


def test_the_copy_is_of_what_the_window_shows(tmp_path):
    scene = new_scene()
    scene.lighttree_compare.folder = str(tmp_path)
    assert "shown" not in comparison.prepare(bpy.context)._job
    bpy.context.window.view_layer = scene.view_layers.new("Second")
    job = comparison.prepare(bpy.context)._job
    assert job["shown"] == {"scene": "Scene", "view_layer": "Second"}
    other = bpy.data.scenes.new("Other")
    other.view_layers.new("Third")
    comparison._save_copy(Path(job["file"]))
    keep_shown(job["file"], "Other", "Third")
    bpy.ops.wm.open_mainfile(filepath=job["file"], load_ui=False)
    assert bpy.context.scene.name == "Other"
    assert bpy.context.scene.view_layers.keys() == ["Third"]


def test_nonsense_settings_are_kept_in_bounds(tmp_path):
    scene = new_scene()
    settings = scene.lighttree_compare
    settings.seconds, settings.percentage = -1, 0
    assert settings.seconds > 0 and settings.percentage == 1
    assert comparison.options(scene)["resolution"] == [4, 4]
    settings.folder = ""
    assert comparison.output_folder(scene) == Path(bpy.app.tempdir, "lighttree-compare")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert comparison.output_folder(bpy.context.scene) == tmp_path / "lighttree-compare"


def test_bounces_and_threads_are_the_scene_s():
    scene = new_scene()
    scene.lighttree.max_bounces = 3
    scene.lighttree_compare.no_lamp_mis = True
    chosen = comparison.options(scene)
    assert (chosen["bounces"], chosen["threads"]) == (3, 1)
    assert chosen["methods"] == ["lighttree", "cycles", "cycles-no-lamp-mis"]
    scene.render.threads_mode = "AUTO"
    assert comparison.options(scene)["threads"] == 0


class Layout:
    """Records what a panel draws; everything opens another layout, which is the same."""

    def __init__(self):
        self.labels, self.buttons, self.settings, self.bars = [], [], [], []

    def column(self, align=False):
        return self

    row = box = column

    def prop(self, data, name):
        self.settings.append(name)

    def label(self, text, icon="NONE"):
        self.labels.append(text)

    def progress(self, factor, text):
        self.bars.append((factor, text))

    def operator(self, name, text="", icon="NONE"):
        self.buttons.append((name, button := SimpleNamespace()))
        return button


def draw():
    drawing = SimpleNamespace(layout=Layout())
    panels.RENDER_PT_lighttree_compare.draw(drawing, bpy.context)
    return drawing.layout


def test_the_panel_before_and_while_it_runs(monkeypatch):
    new_scene(seconds=4)
    layout = draw()
    assert [name for name, _ in layout.buttons] == ["lighttree.compare"]
    assert layout.settings == ["seconds", "percentage", "folder", "no_lamp_mis"]
    assert layout.labels == ["Takes about 2 minutes"]
    bpy.context.scene.lighttree_compare.seconds = 1
    assert draw().labels == ["Takes about 37 seconds"]
    running = SimpleNamespace(is_running=True, fraction=0.374, text="Rendering with Cycles")
    monkeypatch.setattr(compare, "last", running)
    layout = draw()
    assert (layout.bars, layout.labels) == ([(0.374, "37%")], ["Rendering with Cycles"])
    assert [name for name, _ in layout.buttons] == ["lighttree.cancel_compare"]
    monkeypatch.setattr(compare, "last", None)


def test_the_panel_shows_an_error(monkeypatch):
    new_scene()
    last = comparison.Comparison("Scene", error="The disk is full.")
    monkeypatch.setattr(compare, "last", last)
    assert draw().labels[1:] == ["The disk is full."]
    last.scene_name = "Another"
    assert draw().labels[1:] == []


def test_the_panel_shows_the_table_and_opens_the_report(monkeypatch, tmp_path):
    new_scene()
    last = comparison.Comparison("Scene")
    line = {"title": "LightTree", "seconds": 4.02, "samples": 1234, "error": 0.0612, "gain": 20.1}
    base = {"title": "Cycles", "seconds": 4, "samples": 9, "error": 0, "gain": None}
    last.result = {"table": [line, base], "notes": ["A note."], "report": str(tmp_path / "r.html")}
    monkeypatch.setattr(compare, "last", last)
    layout = draw()
    text = " ".join(layout.labels[1:])
    assert text.startswith("LightTree: 20.1 times less error than Cycles at equal time ")
    assert text.endswith(" LightTree 4.02 s 1,234 0.0612 20.1x Cycles 4 s 9 0 - A note.")
    name, button = layout.buttons[-1]
    assert (name, button.url) == ("wm.url_open", (tmp_path / "r.html").as_uri())


def test_a_loss_is_told_as_such():
    def told(gain):
        return compare.summarize({"table": [{"gain": gain}]})

    assert told(0.5) == "LightTree: 2 times more error than Cycles at equal time"
    assert told(None) == "LightTree and Cycles were compared"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("city lighttree-0: Warming up", "LightTree reference 1 of 8"),
        ("city cycles-7: ", "Cycles reference 8 of 8"),
        ("city cycles-4s-seed1: Sample 3", "Rendering with Cycles"),
        ("a_b cycles-no-lamp-mis-0.5s-seed1: x", "Rendering with Cycles, no lamp MIS"),
        ("Measuring city cycles-4s-seed1", "Measuring errors"),
        ("Compiling kernels (first run only)", "Compiling kernels (first run only)"),
    ],
)
def test_progress_is_told_in_an_artist_s_words(text, told):
    assert translate(text) == told


def test_the_picture_holds_every_pixel_in_its_place(tmp_path):
    rng = np.random.default_rng(7)
    images = [rng.integers(0, 256, (100, 400, 3)) / 255 for _ in range(4)]
    columns = [Column(["one", "two"], images[:2]), Column(["three", "four"], images[2:])]
    draw_picture(tmp_path / "x.png", columns)
    found = imread(tmp_path / "x.png")[..., :3]
    caption = (found.shape[0] - 2 * 100 - 8) // 2
    for i, image in enumerate(images):
        top, left = caption + i % 2 * (100 + caption), 8 + i // 2 * 408
        np.testing.assert_allclose(found[top : top + 100, left : left + 400], image, atol=1 / 255)


def test_an_image_is_developed_as_the_scene_would_show_it(tmp_path):
    write_exr(tmp_path / "grey.exr", dict.fromkeys("RGB", np.full((4, 4), 0.5)), {})
    before = bpy.data.images.keys()
    standard = develop(tmp_path / "grey.exr", {"view_transform": "Standard", "exposure": 0.0})
    # sRGB of a linear 0.5, and of 1.
    np.testing.assert_allclose(standard, 0.7354, atol=0.003)
    brighter = develop(tmp_path / "grey.exr", {"exposure": 1.0})
    np.testing.assert_allclose(brighter, 1, atol=0.003)
    agx = develop(tmp_path / "grey.exr", {"view_transform": "AgX", "exposure": 0.0})
    assert abs(agx.mean() - 0.7354) > 0.05 and bpy.data.images.keys() == before
