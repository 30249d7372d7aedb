"""The command line: what it refuses and how it says so, and each door once."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict, fields
from functools import partial

import numpy as np
import pytest

from lighttree_batch import experiment
from lighttree_batch.__main__ import main
from lighttree_batch.arguments import TREE_HELP
from lighttree_batch.images import read_exr
from lighttree_core.light_tree.nodes import NUM_LANES
from lighttree_core.light_tree.options import (
    BUCKET_KINDS,
    CONE_AXES,
    IMPORTANCES,
    MAX_BUCKETS,
    SPLITS,
    TreeOptions,
)

SAVE_BLENDS = """
import bpy, sys
from pathlib import Path
folder = Path(sys.argv[1])
save = lambda name: bpy.ops.wm.save_as_mainfile(filepath=str(folder / name), compress=False)
bpy.ops.wm.read_factory_settings()
bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 32, 18
save("plain.blend")
nodes = bpy.data.materials["Material"].node_tree.nodes
shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
shader.inputs["Subsurface Weight"].default_value = 0.5
save("waxen.blend")
bpy.context.scene.camera = None
save("no-camera.blend")
bpy.ops.wm.read_factory_settings(use_empty=True)
with bpy.data.libraries.load(str(folder / "plain.blend"), link=True) as (there, here):
    here.objects = ["Cube"]
bpy.context.scene.collection.objects.link(here.objects[0])
save("linked.blend")
"""


@pytest.fixture(scope="module")
def blends(tmp_path_factory):
    """Blender's default scene in several states of health."""
    folder = tmp_path_factory.mktemp("blends")
    subprocess.run([sys.executable, "-c", SAVE_BLENDS, folder], check=True, capture_output=True)
    whole = (folder / "plain.blend").read_bytes()
    (folder / "cut.blend").write_bytes(whole[: len(whole) // 2])
    (folder / "text.blend").write_text("not a scene")
    # The file begins with its version: BLENDER-v405 or BLENDER17-01v0502.
    version = re.match(rb"BLENDER\S*?v0?(\d{3})", whole)
    newer = whole[: version.start(1)] + b"909" + whole[version.end(1) :]
    (folder / "newer.blend").write_bytes(newer)
    (folder / "unlinked").mkdir()
    (folder / "linked.blend").rename(folder / "unlinked/linked.blend")
    return folder


def refusal(capsys, *arguments):
    """The one sentence with which a command refuses bad input."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert captured.out == "" and line.startswith("lighttree: ")
    return line


COMPARE = ("compare", "x.blend", "-o", "results")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("frobnicate",), "No such command 'frobnicate'"),
        (("compare", "--frobnicate"), "No such option: --frobnicate"),
        (("compare",), "Missing argument"),
        ((*COMPARE, "--seconds", "1", "--samples", "1"), "exclude each other"),
        ((*COMPARE, "--seconds", "1,two"), "'1,two' is not a list of numbers"),
        ((*COMPARE, "--samples", "1.5"), "'1.5' is not a list of whole numbers"),
        ((*COMPARE, "--seconds", "0"), "must be 0.001 to"),
        ((*COMPARE, "--resolution", "0x0"), "width in pixels must be 4"),
        ((*COMPARE, "--resolution", "big"), "'big' is not a size in pixels"),
        ((*COMPARE, "--frame", "1.5"), "'1.5' is not a list of frames"),
        ((*COMPARE, "--frame", "1,9999999"), "A frame must be -1,048,574 to 1,048,574"),
        ((*COMPARE, "--methods", "cyclees"), "no method called 'cyclees'"),
        (COMPARE, "x.blend: no such file"),
        ((*COMPARE, "--tree", "split=best"), "--tree split must be one of saoh, sah"),
        ((*COMPARE, "--tree", "colour=red"), "there is no tree option 'colour'"),
        ((*COMPARE, "--thesis"), "not both"),
        ((*COMPARE, "--max-lights", "9"), "an option of --thesis"),
        (("render", "x.npz", "-o", "x.exr", "--tree", "buckets=many"), "is not a whole number"),
        (("render", "x.npz", "-o", "x.exr", "--tree", "buckets=1"), "buckets must be 0"),
        (("render", "x.npz", "-o", "x.exr", "--split-lights", "0"), "'--split-lights'"),
        (("render", "x.npz", "-o", "x.exr", "--mis", "none"), "'--mis'"),
        (("render", "x.npz", "-o", "x.exr", "--filter", "none"), "'--filter'"),
        (("render", "x.blend", "-o", "x.exr"), "x.blend: no such file"),
        (("export", "x.blend", "-o", "x.npz"), "x.blend: no such file"),
        (("report", "."), "no run.json"),
        (("scene",), "--list"),
        (("scene", "city", "-o", "city.png"), "must end in .blend"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(arguments, sentence, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert sentence in refusal(capsys, *arguments)


def test_an_output_that_cannot_be_written_is_refused_before_work_begins(capsys, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "x.blend").touch()
    inside_file = tmp_path / "file/deep"
    assert "no results can be written" in refusal(
        capsys, "compare", tmp_path / "x.blend", "-o", inside_file
    )
    assert "cannot be written" in refusal(
        capsys, "render", tmp_path / "x.blend", "-o", inside_file / "x.exr"
    )


def test_a_full_disk_is_told_as_such(capsys, monkeypatch):
    def fill_disk(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "results/a.exr")

    monkeypatch.setattr(experiment, "run_comparison", fill_disk)
    assert main(["compare", "x.blend", "-o", "results"]) == 1
    assert capsys.readouterr().err == (
        "lighttree: The disk is full; make room and run the same command again.\n"
    )


def test_a_fault_shows_its_traceback_only_on_request(capsys, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(experiment, "run_comparison", fail)
    assert main(["compare", "x.blend", "-o", "results"]) == 1
    assert "Internal error, ZeroDivisionError: a bug" in (err := capsys.readouterr().err)
    assert "Traceback" not in err
    monkeypatch.setenv("LIGHTTREE_DEBUG", "1")
    assert main(["compare", "x.blend", "-o", "results"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_the_command_line_starts_without_what_takes_long_to_import():
    code = "import lighttree_batch.__main__, sys; print(*{'bpy', 'numba'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_help_teaches_by_example(capsys):
    assert main(["--help"]) == 0
    assert "lighttree compare a.blend b.blend --out results" in capsys.readouterr().out


def test_help_names_every_option_of_the_tree_and_its_values():
    for field in fields(TreeOptions):
        (values,) = re.findall(rf"{field.name}=([^,.]+)", TREE_HELP)
        if isinstance(field.default, str):
            for value in values.split("|"):
                TreeOptions.parse([f"{field.name}={value}"])
    choices = {*SPLITS, *BUCKET_KINDS, *CONE_AXES, *IMPORTANCES, str(NUM_LANES), str(MAX_BUCKETS)}
    assert choices <= set(re.findall(r"\w+", TREE_HELP))


@pytest.mark.blender
@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("text.blend", "Blender cannot open it"),
        ("cut.blend", "Blender cannot open it"),
        ("no-camera.blend", "no active camera"),
    ],
)
def test_a_blend_that_cannot_be_rendered_is_refused(name, sentence, blends, tmp_path, capsys):
    assert sentence in refusal(capsys, "render", blends / name, "-o", tmp_path / "x.exr")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.blender
@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("newer.blend", "newer than this Blender"),
        ("unlinked/linked.blend", "Library //plain.blend: missing"),
    ],
)
def test_what_blender_opens_all_the_same_is_rendered_with_a_warning(
    name, sentence, blends, tmp_path, capsys
):
    render = ["render", str(blends / name), "-o", str(tmp_path / "x.exr"), "--samples", "1"]
    render += ["--camera", "auto"]
    assert main(render) == 0
    assert sentence in capsys.readouterr().err
    assert sentence in refusal(capsys, *render, "--strict")


@pytest.mark.blender
def test_unknown_cameras_and_scenes_are_told_with_what_there_is(blends, tmp_path, capsys):
    compare = ("compare", blends / "plain.blend", "-o", tmp_path, "--camera", "Roof")
    assert "no camera called 'Roof'; there is Camera" in refusal(capsys, *compare)
    sentence = refusal(capsys, "scene", "town", "-o", tmp_path / "x.blend")
    assert "'town'" in sentence and "city-small" in sentence


@pytest.mark.blender
def test_list_shows_every_scene(capsys):
    assert main(["scene", "--list"]) == 0
    assert "city-small" in capsys.readouterr().out


@pytest.mark.blender
def test_a_blend_and_its_export_render_alike(blends, tmp_path, capsys):
    source, image, scene = blends / "plain.blend", tmp_path / "a.exr", tmp_path / "a.npz"
    settings = ("--samples", "2", "--seed", "3", "--sampler", "power", "--threads", "1")
    settings = (*settings, "--filter", "gaussian")
    assert main(["render", str(source), "-o", str(image), *settings]) == 0
    assert capsys.readouterr().out == f"{image}\n"
    assert main(["export", str(source), "-o", str(scene)]) == 0
    again = tmp_path / "b.exr"
    assert main(["render", str(scene), "-o", str(again), *settings]) == 0
    (channels, header), (same, other) = read_exr(image), read_exr(again)
    assert header["samples"] == 2 and channels["R"].shape == (18, 32) and channels["R"].any()
    assert all(np.array_equal(channels[c], same[c]) for c in "RGB")
    # A process for Blender has kernels to load, which is in no other figure.
    assert header["seconds_compile"] > 0 and other["seconds_compile"] >= 0


@pytest.mark.blender
def test_options_of_the_tree_reach_both_doors(blends, tmp_path):
    source, scene, image = blends / "plain.blend", tmp_path / "a.npz", tmp_path / "a.exr"
    options = ("--tree", "split=sah", "--tree", "thin_box=off", "--tree", "split_threshold=0.5")
    options = (*options, "--samples", "1", "--split-lights", "2", "--mis", "balance")
    assert main(["render", str(source), "-o", str(image), *options]) == 0
    used = read_exr(image)[1]["engine_settings"]
    assert (used["tree_split"], used["tree_thin_box"], used["tree_split_threshold"]) == (
        "sah",
        False,
        0.5,
    )
    assert (used["split_lights"], used["mis"]) == (2, "balance")
    assert used["tree_width"] == TreeOptions().width
    assert main(["export", str(source), "-o", str(scene)]) == 0
    assert main(["render", str(scene), "-o", str(image), *options]) == 0
    used = read_exr(image)[1]["engine_settings"]
    expected = TreeOptions(split="sah", thin_box=False, split_threshold=0.5)
    assert used["tree"] == asdict(expected)
    assert (used["split_lights"], used["mis"]) == (2, "balance")


@pytest.mark.blender
def test_strict_refuses_what_is_not_modelled(blends, tmp_path, capsys):
    # Its cube lets light in below the surface.
    compare = ("compare", blends / "waxen.blend", "-o", tmp_path / "results", "--strict")
    assert "refused by --strict" in refusal(capsys, *compare)
    assert "Strict" in refusal(
        capsys, "render", blends / "waxen.blend", "-o", tmp_path / "x.exr", "--strict"
    )


@pytest.mark.blender
@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT")
def test_ctrl_c_stops_at_once_and_leaves_no_process(blends, tmp_path):
    command = [sys.executable, "-m", "lighttree_batch", "compare", blends / "plain.blend"]
    options = ["-o", tmp_path / "run", "--resolution", "64x36", "--samples", "1000000"]
    # Whoever runs the tests in the background may have SIGINT ignored, and children inherit that.
    heed_ctrl_c = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen(
        [*command, *options], stderr=subprocess.PIPE, text=True, preexec_fn=heed_ctrl_c
    )
    while not (tmp_path / "run/run.json").exists() and process.poll() is None:
        time.sleep(0.1)
    workers = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True
    ).stdout.split()
    started = time.monotonic()
    process.send_signal(signal.SIGINT)
    try:
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert time.monotonic() - started < 5
    assert (process.returncode, err) == (
        130,
        "lighttree: stopped; run the same command again to go on.\n",
    )
    assert workers and not any(os.path.exists(f"/proc/{pid}") for pid in workers)
