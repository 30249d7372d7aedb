"""The scenes of the thesis: the lights their names promise, in a closed room, well exposed."""

import time

import bpy
import numpy as np
import pytest
from mathutils import Vector

from lighttree_batch.blend import extract
from lighttree_batch.scenes import SCENES, build_scene
from lighttree_batch.thesis_scenes import BOXES, ROOM
from lighttree_core import Settings, render
from lighttree_core.lights import build_lights, count_lights

pytestmark = pytest.mark.blender

# The 1.6 million points of the ceiling take longer: a hundredth of them, and a slow test for all.
LIGHTS = {
    "thesis-spots-20": {"spot": 20},
    "thesis-ceiling-points": {"point": 16_000},
    "thesis-raster-points": {"point": 12_000},
    "thesis-random-points": {"point": 12_000},
    "thesis-random-spots": {"spot": 12_000},
    "thesis-ceiling-triangles": {"mesh triangle": 2_000},
    "thesis-three-spheres": {"mesh triangle": 6_000},
    "thesis-mixed": {"mesh triangle": 6_000, "spot": 4_000, "point": 4_000},
}
DRAWN = ("thesis-spots-20", "thesis-random-points", "thesis-random-spots", "thesis-mixed")


def build(path, name, num_lights=None, seed=0):
    """Build a scene, open it, and extract it 32 x 18 pixels large."""
    build_scene(name, path, num_lights, seed)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    bpy.context.scene.render.resolution_percentage = 5
    return extract(bpy.context.scene)


def content(scene):
    """Every number of the lamps and vertices."""
    columns = [column for name, column in vars(scene.lamps).items() if name != "names"]
    return np.concatenate([column.ravel() for column in (*columns, scene.vertices)])


@pytest.mark.parametrize("name", LIGHTS)
def test_lights_are_what_the_name_says_and_expose_the_image_well(name, tmp_path):
    scene = build(tmp_path / "room.blend", name, sum(LIGHTS[name].values()))
    assert count_lights(build_lights(scene)[0]) == LIGHTS[name]
    luminance = render(scene, Settings(samples=8)).mean @ (0.2126, 0.7152, 0.0722)
    assert 0.1 < luminance.mean() < 0.5


def test_recipes_make_these_lights_unless_asked_otherwise():
    recipes = {name: recipe for name, recipe in SCENES.items() if name.startswith("thesis-")}
    assert {name: recipe.num_lights for name, recipe in recipes.items()} == {
        name: sum(kinds.values()) for name, kinds in LIGHTS.items()
    } | {"thesis-ceiling-points": 1_600_000}


@pytest.mark.parametrize("name", LIGHTS)
def test_few_lights_do_too(name, tmp_path):
    for num_lights in (SCENES[name].min_lights, 150):
        scene = build(tmp_path / "room.blend", name, num_lights)
        lights = count_lights(build_lights(scene)[0])
        assert lights.keys() == LIGHTS[name].keys()
        assert sum(lights.values()) == pytest.approx(num_lights, abs=max(1, 0.15 * num_lights))


@pytest.mark.parametrize("name", LIGHTS)
def test_equal_seeds_give_equal_scenes(name, tmp_path):
    a, b, c = (build(tmp_path / "room.blend", name, 100, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(content(a), content(b))
    assert np.array_equal(content(a), content(c)) == (name not in DRAWN)


@pytest.mark.parametrize("name", DRAWN)
def test_no_light_drawn_by_chance_is_in_a_box_or_a_wall(name, tmp_path):
    position = build(tmp_path / "room.blend", name, 1_000).lamps.position
    assert ((position > ROOM[0]) & (position < ROOM[1])).all()
    for _, (low, high) in BOXES.values():
        assert not ((position > low) & (position < high)).all(axis=1).any()


def test_camera_is_in_a_closed_room(tmp_path):
    build(tmp_path / "room.blend", "thesis-spots-20")
    scene = bpy.context.scene
    directions = np.random.default_rng(7).normal(size=(200, 3))
    for direction in map(Vector, directions):
        is_hit, _, normal, *_ = scene.ray_cast(
            scene.view_layers[0].depsgraph, scene.camera.location, direction
        )
        # Who is inside a box sees the back of its faces.
        assert is_hit and normal.dot(direction) < 0


def test_all_is_modelled(tmp_path):
    for name in LIGHTS:
        assert build(tmp_path / "room.blend", name, 100).not_modelled == []


@pytest.mark.slow
def test_a_million_and_a_half_lamps_are_read_in_seconds(tmp_path):
    build_scene("thesis-ceiling-points", tmp_path / "room.blend")
    assert (tmp_path / "room.blend").stat().st_size < 20e6
    start = time.process_time()  # which other programs do not slow down
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    scene = extract(bpy.context.scene)
    seconds = time.process_time() - start
    assert len(scene.lamps.names) == 1_600_000
    assert seconds < 20, seconds
