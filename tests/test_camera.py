"""The camera: where each pixel looks, and what is refused."""

import itertools
import math

import bpy
import numpy as np
import pytest
from blender_scenes import add_camera, add_lamp, extract, new_file, new_scene, radians

from lighttree_core.scene import SceneError

pytestmark = pytest.mark.blender

PLACE = {"location": (1, 2, 3), "rotation": radians(60, 10, 30), "scale": (2, 2, 3)}
FITS = list(
    itertools.product(
        ("PERSP", "ORTHO"), ("AUTO", "HORIZONTAL", "VERTICAL"), ((64, 40), (40, 64)), (1.0, 2.0)
    )
)


@pytest.mark.parametrize("kind, fit, size, aspect", FITS)
def test_pixels_look_where_blender_projects_them_from(kind, fit, size, aspect):
    scene = new_file()
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.pixel_aspect_y = aspect
    settings = {
        "type": kind,
        "sensor_fit": fit,
        "sensor_height": 20,
        "shift_x": 0.2,
        "shift_y": 0.1,
    }
    thing = add_camera(settings={**settings, "ortho_scale": 5, "lens": 35}, **PLACE)
    camera = extract().camera
    projection = thing.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1], scale_x=1, scale_y=aspect
    )
    corners = np.array([(0, 0), size, (size[0] * 0.3, size[1] * 0.8)])
    ndc = 2 * corners / size - 1
    plane = ndc * (camera.half_width, camera.half_height) + (camera.shift_x, camera.shift_y)
    points = np.column_stack([plane, np.full(3, -1.0), np.ones(3)])
    clip = points @ np.array(projection).T
    np.testing.assert_allclose(clip[:, :2] / clip[:, 3:], ndc, atol=1e-5)


def test_camera_is_placed_without_its_scale():
    new_file()
    add_camera(settings={"clip_start": 0.5, "clip_end": 7.0}, **PLACE)
    camera = extract().camera
    rotation = camera.world_from_camera[:, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(camera.world_from_camera[:, 3], (1, 2, 3))
    assert (camera.clip_start, camera.clip_end) == (0.5, 7.0)
    assert camera.world_from_camera.dtype == np.float64


def test_frame_is_the_scenes_own_unless_given():
    new_scene()
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 101, 51, 33
    camera = extract().camera
    assert (camera.width_px, camera.height_px) == (33, 16)  # Blender truncates
    assert camera.crop_px == (0, 0, 33, 16)
    camera = extract(width_px=30, height_px=10).camera
    assert (camera.width_px, camera.height_px, camera.shape) == (30, 10, (10, 30))


def _set_border(min_x, max_x, min_y, max_y):
    render = bpy.context.scene.render
    render.resolution_x = render.resolution_y = 32
    render.use_border = True
    render.border_min_x, render.border_max_x = min_x, max_x
    render.border_min_y, render.border_max_y = min_y, max_y


def test_border_is_cropped_to_whole_pixels():
    new_scene()
    _set_border(0.26, 0.5, 0.1, 0.99)
    assert extract().camera.crop_px == (8, 3, 16, 31)


def test_empty_border_is_refused():
    new_scene()
    _set_border(0.25, 0.251, 0.0, 1.0)
    with pytest.raises(SceneError, match=r"render border is 0 x 32 pixels: .*Ctrl Alt B"):
        extract()


def test_scene_without_camera_is_refused():
    new_file()
    with pytest.raises(SceneError, match=r"no camera: add one \(Shift A > Camera\)"):
        extract()


def test_panorama_is_refused():
    new_scene()
    bpy.context.scene.camera.data.type = "PANO"
    with pytest.raises(SceneError, match=r"Camera Camera is of type PANO.* Perspective or Ortho"):
        extract()


def test_lamp_as_camera_is_refused():
    new_file()
    bpy.context.scene.camera = add_lamp("SPOT", name="Projector")
    with pytest.raises(SceneError, match="Camera Projector is of type LIGHT"):
        extract()


def test_depth_of_field_is_noted():
    new_scene()
    bpy.context.scene.camera.data.dof.use_dof = True
    assert extract().not_modelled == ["Camera Camera: without depth of field, all is in focus."]


def test_field_of_view_is_that_of_the_lens():
    new_file()
    add_camera(settings={"sensor_width": 36.0, "lens": 18.0})
    camera = extract(width_px=20, height_px=10).camera
    assert math.isclose(camera.half_width, 1.0)
    assert math.isclose(camera.half_height, 0.5)
