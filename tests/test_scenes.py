"""The scene recipes: what lies in the .blend files they make."""

import bpy
import numpy as np
import pytest
from mathutils import Vector

from lighttree_batch import shapes
from lighttree_batch.blend import extract
from lighttree_batch.scenes import SCENES, build_scene

pytestmark = pytest.mark.blender

LIGHT_SETTINGS = ("type", "energy", "color", "spot_size", "spot_blend", "shadow_soft_size")
LIGHT_SETTINGS += ("shape", "size", "size_y", "spread", "angle")


@pytest.fixture(scope="module")
def small_city(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "city-small.blend"
    build_scene("city-small", path)
    return path


def content(path):
    """All objects of a file by name: where they are, and what their data says."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return {item.name: (item.matrix_world.copy(), data_of(item)) for item in bpy.data.objects}


def data_of(item):
    if item.type == "LIGHT":
        settings = (getattr(item.data, name, None) for name in LIGHT_SETTINGS)
        return [tuple(value) if hasattr(value, "r") else value for value in settings]
    if item.type == "CAMERA":
        return item.data.lens
    vertices = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", vertices)
    material_ids = np.empty(len(item.data.polygons), np.int32)
    item.data.polygons.foreach_get("material_index", material_ids)
    return vertices.tobytes(), material_ids.tobytes(), item.data.materials.keys()


def first_hit(position, direction):
    """Distance to the first surface along a ray, and its normal; (inf, None) without one."""
    hit, location, normal, *_ = bpy.context.scene.ray_cast(
        bpy.context.evaluated_depsgraph_get(), position, direction
    )
    return ((location - Vector(position)).length, normal) if hit else (np.inf, None)


def lit_windows():
    """Centre and normal of every lit window."""
    return [(face.center, face.normal) for face in bpy.data.meshes["windows lit"].polygons]


def lights_of(kind):
    return [item for item in bpy.data.objects if item.type == "LIGHT" and item.data.type == kind]


def test_equal_seeds_give_equal_scenes_and_others_do_not(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        build_scene("city-small", tmp_path / f"{name}.blend", num_lights=200, seed=seed)
    a, b, c = (content(tmp_path / f"{name}.blend") for name in "abc")
    assert a == b
    assert a != c


@pytest.mark.parametrize("num_lights", [200, 540, 1_003, 2_500])
def test_as_many_lights_as_asked_for(tmp_path, num_lights):
    build_scene("city", tmp_path / "city.blend", num_lights)
    num = {kind: len(lights_of(kind)) for kind in ("SPOT", "AREA", "POINT")}
    num["windows"] = len(bpy.data.meshes["windows lit"].polygons)
    assert sum(num.values()) == num_lights
    assert num["windows"] == pytest.approx(0.75 * num_lights, rel=0.02)


def test_more_objects_than_blender_bears_are_the_same_as_instances(tmp_path, monkeypatch):
    scenes, num_objects = [], []
    for max_objects in (shapes.MAX_OBJECTS, 3):
        monkeypatch.setattr(shapes, "MAX_OBJECTS", max_objects)
        build_scene("city", tmp_path / "city.blend", 600)
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "city.blend"))
        scenes.append(extract(bpy.context.scene))
        num_objects.append(len(bpy.data.objects))
    assert num_objects[1] < num_objects[0] / 2
    for rows in (lamp_rows, triangle_rows):
        np.testing.assert_allclose(*map(rows, scenes), atol=1e-5)


def lamp_rows(scene):
    """Position, radiance and axis of every lamp, sorted."""
    lamps = scene.lamps
    return in_order(np.hstack([lamps.position, lamps.radiance, lamps.axis_w]))


def triangle_rows(scene):
    """Corners and albedo of every triangle, sorted."""
    corners = scene.vertices[scene.triangles].reshape(-1, 9)
    return in_order(np.hstack([corners, scene.materials.albedo[scene.triangle_material, 0]]))


def in_order(rows):
    return rows[np.lexsort(np.round(rows, 3).T)]


@pytest.mark.parametrize("seed", range(4))
def test_cameras_are_in_free_air(tmp_path, seed):
    build_scene("city-small", tmp_path / "city.blend", num_lights=300, seed=seed)
    assert bpy.context.scene.camera.name == "street"
    directions = np.random.default_rng(7).normal(size=(200, 3))
    for name in ("street", "roof", "alley"):
        camera = bpy.data.objects[name]
        for direction in map(Vector, directions):
            distance, normal = first_hit(camera.location, direction)
            assert distance > 0.4, name
            # Who is inside a box sees the back of its faces.
            assert normal is None or normal.dot(direction) < 0, name


def test_lit_windows_face_outwards_and_nothing_covers_them(small_city):
    bpy.ops.wm.open_mainfile(filepath=str(small_city))
    bpy.data.objects["shop panes"].hide_viewport = True  # light passes through them
    for center, normal in lit_windows()[::5]:
        to_wall, wall_normal = first_hit(center - 0.01 * normal, -normal)
        assert to_wall < 0.05
        assert wall_normal.dot(normal) > 0.99
        assert first_hit(center + 0.01 * normal, normal)[0] > 0.3


def test_no_lamp_is_buried(small_city):
    bpy.ops.wm.open_mainfile(filepath=str(small_city))
    for item in lights_of("SPOT")[::3] + lights_of("AREA"):
        axis = item.matrix_world.to_3x3() @ Vector((0, 0, -1))
        assert first_hit(item.location, axis)[0] > 0.3, item.name
    for item in lights_of("POINT"):
        # A ball of 0.1 m that touches nothing, and is seen from where it hangs over the street.
        around = [first_hit(item.location, axis)[0] for axis in np.vstack([np.eye(3), -np.eye(3)])]
        assert min(around) > item.data.shadow_soft_size, item.name
        assert sorted(around)[1] > 0.3, item.name


def test_file_asks_cycles_for_an_unbiased_image(small_city):
    bpy.ops.wm.open_mainfile(filepath=str(small_city))
    cycles = bpy.context.scene.cycles
    assert bpy.context.scene.render.engine == "CYCLES"
    assert not (cycles.use_adaptive_sampling or cycles.use_denoising)
    assert cycles.sample_clamp_direct == cycles.sample_clamp_indirect == 0
    assert cycles.light_sampling_threshold == cycles.blur_glossy == 0


def test_nothing_but_the_scene_is_left_behind(small_city):
    assert [path.name for path in small_city.parent.iterdir()] == ["city-small.blend"]


def test_unknown_name_says_what_there_is(tmp_path):
    with pytest.raises(ValueError, match="'town'.*" + ", ".join(SCENES)):
        build_scene("town", tmp_path / "town.blend")


def test_too_few_lights_are_refused(tmp_path):
    with pytest.raises(ValueError, match="needs 200 to 10,000,000 lights, not 5"):
        build_scene("city", tmp_path / "city.blend", num_lights=5)
    assert not list(tmp_path.iterdir())
