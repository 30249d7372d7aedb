"""`lighttree bench` has all its figures, which sum up; `render --explain` tells what is used."""

import json
import math

import numpy as np
import pytest
from core_scenes import (
    add_triangles,
    camera,
    floor_scene,
    lamps_down,
    make_clear,
    materials,
    random_scene,
)

from lighttree_batch import bench
from lighttree_batch.__main__ import main
from lighttree_batch.bench import (
    PARTS,
    RENDER,
    SHADING_KERNELS,
    STARTUP,
    WORLD,
    build_table,
    measure_scene,
)
from lighttree_batch.explain import CLOSURE_NAMES, FEATURE_WORDS, explain_scene, find_features, tell
from lighttree_core import Settings
from lighttree_core.compilation import compile_kernels
from lighttree_core.render import Renderer
from lighttree_core.scene import (
    GLASS,
    GLOSSY,
    IMAGE_TEXTURE,
    POINT,
    SPHERE,
    TRANSPARENT,
    Closures,
    Environment,
    Textures,
)

COUNTED = ("closest", "occlusion", "choice", "shading")


def check_figures(row, max_passes=0):
    """All figures of a scene are there, and the parts of the render are the whole of it."""
    numbers = [*row["startup_s"].values(), *row["render_s"].values(), row["speed_up"]]
    assert all(math.isfinite(number) for number in numbers)
    assert row["render_s"].keys() == PARTS.keys()
    assert row["total_s"] == pytest.approx(sum(row["render_s"].values()))
    assert min(row["render_s"].values()) >= 0 and min(row["startup_s"].values()) >= 0
    for name in COUNTED:
        assert row["counts"][name] > 0
        assert row["per_second"][name] == pytest.approx(row["counts"][name] / row["render_s"][name])
    # A shadow ray goes to each light chosen, and on behind transparent surfaces; each vertex was
    # met by a ray.
    assert row["counts"]["occlusion"] <= row["counts"]["choice"] * (1 + max_passes)
    assert row["counts"]["shading"] <= row["counts"]["closest"]
    assert row["speed_up"] == pytest.approx(row["total_s"] / row["threads_s"])


def test_figures_of_a_scene_are_complete_and_sum_up():
    scene = random_scene(np.random.default_rng(7))
    functions = [getattr(RENDER, name) for name in (*SHADING_KERNELS, "build_world", "Tracer")]
    row = measure_scene(scene, num_pixels=60, samples=1, threads=2, progress=lambda *_: None)
    check_figures(row)
    assert (row["width_px"], row["height_px"], row["threads"]) == (10, 6, 2)
    assert row["startup_s"].keys() == STARTUP.keys() - {"read"}
    names = (*SHADING_KERNELS, "build_world", "Tracer")
    assert [getattr(RENDER, name) for name in names] == functions
    assert WORLD.build_sampler.__name__ == "build_sampler"


def test_start_up_is_all_that_comes_before_the_first_sample(monkeypatch):
    compile_kernels()
    monkeypatch.setattr(bench, "compile_kernels", lambda progress: 0.25)
    renderers = []
    monkeypatch.setattr(
        bench, "Renderer", lambda *args: renderers.append(Renderer(*args)) or renderers[0]
    )
    scene = random_scene(np.random.default_rng(7))
    startup = measure_scene(scene, 4, 1, 1, lambda *_: None)["startup_s"]
    (renderer,) = renderers
    assert renderer.seconds_compile == 0 and startup["kernels"] == 0.25
    # The camera's table is in none of the parts.
    assert sum(startup.values()) == pytest.approx(0.25 + renderer.seconds_setup, abs=0.02)


def test_every_vertex_that_sees_all_its_lights_chooses_once():
    # One lamp over a floor, direct light alone would be one vertex and one shadow ray a pixel; with
    # bounces the scattered rays leave the scene.
    scene = floor_scene(lamps_down([POINT], [(0, 0, 2)]), camera=camera(8, 8))
    row = measure_scene(scene, num_pixels=64, samples=2, threads=1, progress=lambda *_: None)
    assert row["counts"]["shading"] == row["counts"]["choice"] == row["counts"]["occlusion"] == 128
    assert row["counts"]["closest"] == 256


def test_what_hides_a_light_is_asked_about_once_where_a_scene_has_panes():
    # A lamp behind a black roof, both above the camera, and a clear pane that no ray meets.
    scene = floor_scene(lamps_down([POINT], [(0, 0, 8)]), camera=camera(8, 8))
    scene.materials = materials((0.5, 0), (0, 0), (0, 0))
    make_clear(scene, 1)
    corner = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    add_triangles(scene, 40 * corner + (-10, -10, 7), 2)
    add_triangles(scene, 0.1 * corner + (0, 0, -1), 1)
    row = measure_scene(scene, num_pixels=64, samples=2, threads=1, progress=lambda *_: None)
    assert row["counts"]["choice"] == row["counts"]["occlusion"] == 128


@pytest.mark.blender
def test_bench_writes_the_figures_it_shows(tmp_path, capsys):
    file, figures = tmp_path / "scene.npz", tmp_path / "figures.json"
    random_scene(np.random.default_rng(7)).save(file)
    assert main(["bench", str(file), "--quick", "--threads", "2", "--json", str(figures)]) == 0
    found = json.loads(figures.read_text())
    (row,) = found["scenes"]
    check_figures(row)
    assert row["scene"] == "scene" and row["startup_s"].keys() == STARTUP.keys()
    assert row["peak_mib"] is None or row["peak_mib"] >= row["base_mib"] > 0
    assert found["versions"]["numba"]
    output = capsys.readouterr().out
    for words in (*STARTUP.values(), *PARTS.values(), "speed-up by threads", "peak memory"):
        assert words in output


@pytest.mark.blender
def test_bench_takes_a_blend_and_refuses_what_is_not_there(tmp_path, capsys):
    assert main(["bench", str(tmp_path / "none.blend")]) == 2
    assert "no such file" in capsys.readouterr().err
    file, figures = tmp_path / "city.blend", tmp_path / "figures.json"
    assert main(["scene", "city-small", "-o", str(file), "--lights", "200"]) == 0
    assert main(["bench", str(file), "--quick", "--json", str(figures)]) == 0
    (row,) = json.loads(figures.read_text())["scenes"]
    check_figures(row, Settings().max_passes)
    assert row["lights"] > 150 and row["startup_s"]["read"] > 0


def test_table_shows_scenes_side_by_side():
    scene = random_scene(np.random.default_rng(7))
    row = measure_scene(scene, num_pixels=4, samples=1, threads=1, progress=lambda *_: None)
    row["startup_s"]["read"], row["base_mib"], row["peak_mib"] = 0.0, None, None
    table = build_table([{"scene": "a"} | row, {"scene": "b"} | row])
    assert [column.header for column in table.columns] == ["", "a", "b"]


def glossy_scene():
    """A glossy ball lamp's worth of everything: lamps of two kinds, a closure, an image."""
    scene = floor_scene(lamps_down([POINT, SPHERE], [(0, 0, 2), (1, 0, 2)]))
    scene.closures = Closures.empty(1)
    scene.closures.kind[0], scene.closures.weight[0] = GLOSSY, 1
    scene.closures.weight_texture[0] = 0
    scene.materials.num_closures[0] = 1
    scene.textures = Textures.empty(1, 1)
    scene.textures.kind[0] = IMAGE_TEXTURE
    scene.textures.size[0] = 512, 512
    scene.textures.texels = np.zeros((512 * 512, 4), np.uint8)
    scene.uvs = np.zeros((1, 2, 3, 2), np.float32)
    scene.not_modelled = ["Cube: rendered as a ball."]
    return scene


def test_explaining_counts_what_there_is_and_names_what_is_used():
    facts = explain_scene(glossy_scene())
    assert facts["lights"] == {"point": 2} and facts["closures"] == {"glossy": 1}
    used = {name for name, is_used in facts["features"].items() if is_used}
    assert used == {"lobes", "gloss", "textures", "met_lamps"}
    lines = list(tell(facts))
    assert "2 lights: 2 point" in lines
    assert "1 texture, 1 image of 1.0 MiB" in lines
    assert "Not modelled: Cube: rendered as a ball." in lines
    for name, words in FEATURE_WORDS.items():
        assert (f"  {words}" in lines) == (name in used)


def test_a_plain_scene_uses_nothing_more_and_is_modelled():
    scene = floor_scene(lamps_down([POINT], [(0, 0, 2)]))
    add_triangles(scene, [[[0, 0, 1], [1, 0, 1], [0, 1, 1]]], 0)
    facts = explain_scene(scene)
    assert not any(facts["features"].values()) and facts["triangles"] == 3
    assert list(tell(facts))[-2:] == [
        "Uses: plain diffuse surfaces and lights",
        "Modelled as a whole.",
    ]


def test_a_scene_may_use_everything():
    scene = glossy_scene()
    add_triangles(scene, [[[0, 0, 1], [1, 0, 1], [0, 1, 1]]], 0)
    scene.uvs = scene.uvs.repeat(2, axis=1)[:, :3]
    scene.closures = Closures.empty(3)
    scene.closures.kind[:] = GLOSSY, GLASS, TRANSPARENT
    scene.closures.weight[:], scene.closures.weight_texture[0] = 0.3, 0
    scene.materials.num_closures[0] = 3
    scene.corner_normals = np.tile(np.float32([0, 0, 1]), (3, 3, 1))
    scene.environment = Environment(image=np.ones((2, 4, 3), np.float32))
    scene.lamps.casts_shadow[0] = False
    scene.film_transparent = True
    features = explain_scene(scene)["features"]
    assert all(features.values()) and all(type(used) is bool for used in features.values())


def test_every_feature_and_closure_has_a_name():
    assert FEATURE_WORDS.keys() == find_features(glossy_scene()).keys()
    assert sorted(CLOSURE_NAMES) == list(range(len(CLOSURE_NAMES)))


def test_explaining_an_exported_scene_renders_nothing(tmp_path, capsys):
    file = tmp_path / "scene.npz"
    glossy_scene().save(file)
    assert main(["render", str(file), "--explain"]) == 0
    assert "2 lights: 2 point" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.blender
def test_explaining_a_blend_tells_what_its_export_would(tmp_path, capsys):
    file, exported = tmp_path / "city.blend", tmp_path / "city.npz"
    assert main(["scene", "city-small", "-o", str(file), "--lights", "200"]) == 0
    assert main(["export", str(file), "-o", str(exported)]) == 0
    capsys.readouterr()
    told = []
    for path in (file, exported):
        assert main(["render", str(path), "--explain"]) == 0
        told.append(capsys.readouterr().out)
    assert told[0] == told[1] and "mesh triangle" in told[0]


def test_rendering_without_an_output_is_refused(tmp_path, capsys):
    (tmp_path / "x.npz").touch()
    assert main(["render", str(tmp_path / "x.npz")]) == 2
    assert "--explain" in capsys.readouterr().err
