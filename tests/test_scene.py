"""Scenes survive a round trip to disk, and bad ones are refused by name."""

import dataclasses
import json

import numpy as np
import pytest
from core_scenes import add_triangles, camera, floor_scene, point_lamps, random_scene

from lighttree_core import Scene, SceneError
from lighttree_core.scene import (
    DISK,
    ELLIPSE,
    FACING,
    POINT,
    RECTANGLE,
    SPHERE,
    SUN,
    Closures,
    Textures,
)


def parts(scene) -> dict:
    return dataclasses.asdict(scene)


def test_a_saved_scene_comes_back_equal(tmp_path):
    scene = random_scene(np.random.default_rng(7))
    scene.camera = camera(16, 9, crop_px=(1, 2, 10, 8), orthographic=True)
    scene.not_modelled = ["Lamp <b>: its texture is not modelled"]
    scene.save(tmp_path / "scene.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.npz"]
    np.testing.assert_equal(parts(Scene.load(tmp_path / "scene.npz")), parts(scene))


def test_a_later_format_is_told_from_a_damaged_file(tmp_path):
    path = tmp_path / "scene.npz"
    floor_scene().save(path)
    with np.load(path) as file:
        arrays = dict(file)
    facts = json.loads(str(arrays["facts"]))
    for change, sentence in (
        ({"format_version": 99}, "later LightTree"),
        ({"camera": {}}, "damaged"),
        ({"camera": 3}, "damaged"),
    ):
        np.savez(path, **{**arrays, "facts": json.dumps({**facts, **change})})
        with pytest.raises(SceneError, match=sentence):
            Scene.load(path)
    np.savez(path, **{**arrays, "facts": "[]"})
    with pytest.raises(SceneError, match="damaged"):
        Scene.load(path)


def test_files_of_before_a_column_are_read_as_without_it(tmp_path):
    path, scene = tmp_path / "scene.npz", floor_scene()
    scene.closures, scene.textures = Closures.empty(2), Textures.empty(3, 1)
    scene.textures.kind[:] = FACING
    scene.textures.size[:], scene.textures.texels = 1, np.zeros((1, 4), np.uint8)
    scene.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    for name in ("closures.height_texture", "closures.bump_strength", "textures.curve"):
        del arrays[name]
    np.savez(path, **arrays)
    loaded = Scene.load(path)
    loaded.check()
    np.testing.assert_equal(parts(loaded), parts(scene))


def test_damaged_bytes_are_one_sentence(tmp_path):
    path = tmp_path / "scene.npz"
    floor_scene().save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(7)
    for content in (b"", b"not a scene", whole[:100], whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(SceneError, match=r"scene\.npz"):
            Scene.load(path)
    for _ in range(50):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 5):
            damaged[place] ^= 255
        path.write_bytes(damaged)
        try:
            Scene.load(path).check()
        except SceneError as error:
            assert "\n" not in str(error)
    with pytest.raises(SceneError, match="no such file"):
        Scene.load(tmp_path / "missing.npz")


def _bad_vertex(scene):
    add_triangles(scene, [[[0, 0, 1], [1, 0, np.inf], [0, 1, 1]]], 0, name="Broken")


def _bad_emission(scene):
    scene.materials.emission[0, 1, 2] = np.nan


def _bad_index(scene):
    scene.triangles[0, 0] = 99


def _bad_border(scene):
    scene.camera = camera(16, 9, crop_px=(5, 5, 5, 5))


def _bad_background(scene):
    scene.background[1] = np.inf


def _bad_camera_color(scene):
    scene.environment.camera_color = np.array([[0, np.nan, 0]], np.float32)


def _two_camera_colors(scene):
    scene.environment.camera_color = np.zeros((2, 2), np.float32)


def _bad_camera(scene):
    scene.camera.world_from_camera[0, 3] = np.nan


BAD_LAMPS = {
    "energy": (POINT, {"radiance": np.nan}),
    "infinite energy": (SUN, {"radiance": np.inf}),
    "place": (POINT, {"position": np.nan}),
    "no sides": (RECTANGLE, {"axis_u": 0.0}),
    "no area": (ELLIPSE, {"axis_v": (1.0, 0.0, 0.0)}),
    "no direction": (SUN, {"axis_w": 0.0}),
    "no radius": (SPHERE, {"radius": 0.0}),
    "radius below zero": (DISK, {"radius": -1.0}),
    "sun wider than the sky": (SUN, {"radius": 4.0}),
    "spot of zero scale": (POINT, {"cos_cone": 0.5, "axis_u": 0.0, "axis_v": 0.0, "axis_w": 0.0}),
    "cosine above one": (POINT, {"cos_cone": 1.5}),
    "cone wider than a half space": (POINT, {"cos_cone": -0.5}),
    "blend below zero": (POINT, {"cos_cone": 0.5, "blend": -0.5}),
    "blend above one": (POINT, {"cos_cone": 0.5, "blend": 2.0}),
    "spread of zero": (RECTANGLE, {"spread": 0.0}),
    "spread above a half space": (ELLIPSE, {"spread": 4.0}),
}


@pytest.mark.parametrize(("kind", "columns"), BAD_LAMPS.values(), ids=BAD_LAMPS)
def test_a_lamp_that_makes_no_sense_is_refused_by_name(kind, columns):
    lamps = point_lamps([(0, 0, 2), (1, 0, 2)])
    lamps.names = ["Good", "Broken"]
    lamps.axis_u[:], lamps.axis_v[:], lamps.axis_w[:] = (1, 0, 0), (0, -1, 0), (0, 0, -1)
    lamps.kind[1], lamps.radius[1] = kind, 0.1
    scene = floor_scene(lamps)
    scene.check()
    for name, value in columns.items():
        getattr(lamps, name)[1] = value
    with pytest.raises(SceneError, match="'Broken'"):
        scene.check()


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (_bad_vertex, "'Broken'"),
        (_bad_emission, "'material 0'"),
        (_bad_index, "vertex or material"),
        (_bad_border, "border"),
        (_bad_background, "background"),
        (_bad_camera_color, "background"),
        (_two_camera_colors, "background"),
        (_bad_camera, "camera"),
    ],
)
def test_what_cannot_be_rendered_is_refused_by_name(spoil, word):
    scene = floor_scene()
    spoil(scene)
    with pytest.raises(SceneError, match=word):
        scene.check()
