"""The extension in a real Blender: installed from its zip, rendering, switched off and on, removed.

    LIGHTTREE_BLENDER=/opt/blender/blender LIGHTTREE_EXTENSION=dist/lighttree-....zip \\
        python -m pytest tests/gui
"""

from pathlib import Path

import numpy as np

from lighttree_batch.images import read_render

MODULE = "bl_ext.user_default.lighttree"
BESIDE_CYCLES = Path(__file__).parent.parent / "beside_cycles.py"

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


def test_the_first_picture_comes_within_two_minutes_of_installing(scene):
    path, output, seconds = scene
    assert path.with_name("f12.png").stat().st_size > 1000
    assert "Compiling kernels, once for this version" in output
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
