"""What of a .blend is rendered, and what of it gets into the file: views, layers, frames, alpha."""

import json

import blender_scenes as blend
import bpy
import numpy as np
import pytest

from lighttree_batch import process
from lighttree_batch.__main__ import main
from lighttree_batch.images import read_exr
from lighttree_batch.plan import Source
from lighttree_batch.single import explain_file

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Two scenes. In the first two view layers, the active one unused, see a plane each, which
    glows with 0.25 and 0.75; it grows with the frame. Its film is transparent.
    """
    blend.new_file()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 8, 4
    scene.render.film_transparent = True
    blend.add_camera(ortho_scale=4, location=(0, 0, 5))
    blend.add_camera(ortho_scale=400, location=(0, 0, 5), name="Far")
    scene.camera = bpy.data.objects["Camera"]
    for name, strength in (("A", 0.25), ("B", 0.75)):
        glow = blend.new_material(name, "ShaderNodeEmission", Strength=strength, Color=(1, 1, 1))
        plane = blend.add_plane(2, glow, name=name)
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        collection.objects.link(plane)
        scene.collection.objects.unlink(plane)
        plane.scale.x = 1
        plane.keyframe_insert("scale", frame=1)
        plane.scale.x = 2
        plane.keyframe_insert("scale", frame=11)
    scene.view_layers[0].name = "A"
    scene.view_layers.new("B")
    for layer, hidden in (("A", "B"), ("B", "A")):
        scene.view_layers[layer].layer_collection.children[hidden].exclude = True
    scene.view_layers["A"].use = False
    scene.view_layers["B"].use_pass_z = True
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(bpy.data.objects["A"])
    path = tmp_path_factory.mktemp("views") / "two {0} 'layers' #.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def render(file, out, *options):
    assert main(["render", str(file), "-o", str(out), "--samples", "4", *options]) == 0
    return read_exr(out)[0]


def test_the_layer_that_is_used_is_rendered_with_alpha_and_all_passes(file, tmp_path):
    found = render(file, tmp_path / "{a} #.exr")
    covered = found["A"] > 0.99
    assert covered.any() and not covered.all() and np.isclose(found["A"], 0).any()
    assert np.allclose(found["R"], 0.75 * found["A"], atol=1e-3)
    assert np.allclose(found["B.Depth.Z"][covered], 5) and "B.Albedo.R" in found
    assert not any(name.startswith("A.") for name in found)


def test_scene_layer_camera_frame_and_resolution_are_chosen_by_name(file, tmp_path):
    found = render(file, tmp_path / "a.exr", "--view-layer", "A", "--resolution", "16x8")
    assert found["R"].shape == (8, 16) and np.allclose(found["R"][found["A"] > 0.99], 0.25)
    assert render(file, tmp_path / "a.exr", "--camera", "Far")["A"].max() < 0.1
    assert render(file, tmp_path / "a.exr", "--frame", "11")["A"].sum() > 7.5
    seen = render(
        file, tmp_path / "a.exr", "--scene", "Other", "--camera", "auto", "--resolution", "8x32"
    )
    assert seen["R"].max() == pytest.approx(0.25) and seen["R"].any()


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("--scene", "there is no scene called 'X'; there is Other, Scene"),
        ("--view-layer", "there is no view layer called 'X'; there is A, B"),
        ("--camera", "there is no camera called 'X'; there is Camera, Far"),
    ],
)
def test_names_that_are_not_there_are_told_with_those_that_are(file, capsys, option, sentence):
    assert main(["render", str(file), "--explain", option, "X"]) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())


def test_frames_get_files_of_their_own_and_are_rendered_once(file, tmp_path, capsys):
    command = ["render", str(file), "-o", str(tmp_path / "a.exr"), "--samples", "4"]
    command += ["--frame", "1,3-4"]
    assert main(command) == 0
    images = [tmp_path / f"a.000{frame}.exr" for frame in (1, 3, 4)]
    assert sorted(tmp_path.iterdir()) == images
    areas = [read_exr(image)[0]["A"].sum() for image in images]
    assert areas == sorted(areas) and areas[0] < areas[2]
    images[1].unlink()
    capsys.readouterr()
    before = images[0].stat().st_mtime_ns
    assert main(command) == 0
    assert capsys.readouterr().err.count("Rendered before") == 2
    assert sorted(tmp_path.iterdir()) == images and images[0].stat().st_mtime_ns == before


def test_a_file_tells_what_it_has_to_people_and_to_programs(file, capsys):
    assert main(["render", str(file), "--list"]) == 0
    told = capsys.readouterr().out
    assert "Cameras: Camera (active), Far" in told and "View layers: B, A (not used)" in told
    assert main(["render", str(file), "--list", "--json"]) == 0
    assert [entry["scene"] for entry in json.loads(capsys.readouterr().out)] == ["Scene", "Other"]
    assert main(["render", str(file), "--explain", "--json", "--view-layer", "A"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["triangles"] == 2 and facts["not_modelled"] == []
    # The other scene has no camera, which only rendering needs.
    assert main(["render", str(file), "--explain", "--scene", "Other"]) == 0
    assert "There is no camera" in capsys.readouterr().out
    assert main(["render", str(file), "-o", "x.exr", "--scene", "Other"]) == 2
    assert "--camera auto" in capsys.readouterr().err


def test_scenes_have_names_of_what_is_seen_of_them():
    source = Source("a/b.blend", "Left", 3, scene="Shop", view_layer="Lamps")
    assert source.name == "b-Shop-Lamps-Left-f3"


@pytest.mark.parametrize(
    ("death", "sentence"),
    [
        ("import os; os.abort()", "crashed (SIGABRT) while it was at: Reading"),
        ("import ctypes; ctypes.string_at(0)", "crashed (SIGSEGV) while it was at: Reading"),
        ("import os; os.kill(os.getpid(), 9)", "was killed (SIGKILL), perhaps for want of memory"),
        ("import os; os._exit(3)", "ended unexpectedly (exit status 3)"),
    ],
)
def test_a_process_that_dies_is_told_with_its_last_words(file, monkeypatch, death, sentence):
    start = process._command()
    assert start[-2:] == ["-m", "lighttree_batch.worker"]
    dies = f"print('its last words', flush=True); {death}"
    code = f"from lighttree_batch import worker; worker.list_scenes = lambda file: exec({dies!r});"
    code += "worker.extract = worker.list_scenes; worker.main()"
    monkeypatch.setattr(process, "_command", lambda: [*start[:-2], "-c", code])
    with pytest.raises(process.ProcessDied) as caught:
        explain_file(file, lambda fraction, text: None)
    assert sentence in str(caught.value) and "its last words" in str(caught.value)


def test_blender_is_blamed_for_what_it_does_without_us(file, monkeypatch):
    start = process._command()
    code = "from lighttree_batch import worker; import os; worker.open_blend = lambda *_, **__: "
    code += "os.abort(); worker.main()"
    monkeypatch.setattr(process, "_command", lambda: [*start[:-2], "-c", code])
    with pytest.raises(process.ProcessDied, match=r"Blender itself crashed .* \(Cycles does too\)"):
        explain_file(file, lambda fraction, text: None)
