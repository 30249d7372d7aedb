"""The camera: where each pixel looks, its lens, filter and film; and what is refused."""

import itertools
import math

import blender_scenes as blend
import bpy
import numpy as np
import pytest
from blender_scenes import add_camera, add_lamp, add_object, extract, new_file, new_scene, radians

from lighttree_core.scene import SceneError

pytestmark = pytest.mark.blender

SIZE, DEPTHS = 32, (2.5, 4.0, 4.0, 6.0, 9.0)
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


def test_frame_is_the_scenes_own():
    new_scene()
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 101, 51, 33
    camera = extract().camera
    assert (camera.width_px, camera.height_px) == (33, 16)  # Blender truncates
    assert camera.crop_px == (0, 0, 33, 16)
    assert camera.shape == (16, 33)


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


def test_border_is_rounded_as_by_blender_in_32_bits():
    new_scene()
    _set_border(0.7, 1, 0.25, 0.75)
    render = bpy.context.scene.render
    render.resolution_x = render.resolution_y = 100
    assert extract().camera.crop_px == (70, 25, 100, 75)  # 0.7 in 32 bits x 100 is below 70


def test_stereoscopy_is_refused():
    new_scene()
    bpy.context.scene.render.use_multiview = True
    with pytest.raises(SceneError, match=r"Stereoscopy is on, .* Output properties"):
        extract()


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


@pytest.mark.parametrize("kind, radius", [("PERSP", 0.035 / 4), ("ORTHO", 1 / 4)])
def test_the_lens_is_that_of_the_camera(kind, radius):
    new_file()
    dof = add_camera(settings={"type": kind, "lens": 35}).data.dof
    dof.aperture_fstop, dof.aperture_blades, dof.aperture_rotation = 2.0, 6, 0.5
    dof.aperture_ratio, dof.focus_distance = 1.5, 3.0
    assert extract().camera.lens_radius == 0
    dof.use_dof = True
    scene = extract()
    camera = scene.camera
    assert camera.lens_radius == pytest.approx(radius)
    assert (camera.num_blades, camera.blade_rotation, camera.lens_ratio) == (6, 0.5, 1.5)
    assert camera.focus_distance == 3.0
    assert scene.not_modelled == []


def test_what_is_in_focus_is_an_object_at_its_distance_along_the_axis():
    new_file()
    dof = add_camera(location=(1, 2, 9), scale=(2, 2, 3)).data.dof
    dof.use_dof, dof.focus_distance = True, 100.0
    dof.focus_object = add_object("Target", None, location=(4, -2, 2))
    assert extract().camera.focus_distance == pytest.approx(7)


def test_what_is_in_focus_is_a_bone():
    new_file()
    dof = add_camera(location=(0, 0, 9)).data.dof
    rig = add_object("Rig", bpy.data.armatures.new("Rig"), location=(0, 0, 1))
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("Head")
    bone.head, bone.tail = (0, 0, 2), (0, 0, 3)
    bpy.ops.object.mode_set(mode="OBJECT")
    dof.use_dof, dof.focus_object, dof.focus_subtarget = True, rig, "Head"
    assert extract().camera.focus_distance == pytest.approx(6)
    dof.focus_subtarget = "Tail"  # there is no such bone
    assert extract().camera.focus_distance == pytest.approx(8)


def test_field_of_view_is_that_of_the_lens():
    render = new_file().render
    render.resolution_x, render.resolution_y = 20, 10
    add_camera(settings={"sensor_width": 36.0, "lens": 18.0})
    camera = extract().camera
    assert math.isclose(camera.half_width, 1.0)
    assert math.isclose(camera.half_height, 0.5)


def glowing_squares(depths, strength, num_samples, kind="PERSP"):
    """Squares that glow, each in its own colour and about 6 px wide, before a black world."""
    scene = new_file(num_samples)
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.lighttree.samples = num_samples
    rng = np.random.default_rng(7)
    for depth in depths:
        inputs = {"Color": rng.uniform(0.2, 1, 3), "Strength": strength}
        glow = blend.new_material("Glow", "ShaderNodeEmission", **inputs)
        reach = depth if kind == "PERSP" else 4.0
        place = (*rng.uniform(-0.3, 0.3, 2) * reach, -depth)
        blend.add_plane(0.2 * reach, glow, name="Square", location=place)
    add_camera(settings={"type": kind, "ortho_scale": 4.0, "lens": 35.0})
    return scene


def assert_engines_agree(tmp_path, atol, channels="RGB"):
    """Tiles of 4 x 4 px are as bright in both engines."""
    tiles = []
    for engine in ("CYCLES", "LIGHTTREE"):
        bpy.context.scene.render.engine = engine
        image = blend.render(tmp_path, channels)
        tiles.append(image.reshape(SIZE // 4, 4, SIZE // 4, 4, len(channels)).mean((1, 3)))
    np.testing.assert_allclose(*tiles, atol=atol)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("num_blades, ratio", [(0, 1.0), (3, 1.0), (5, 2.0)])
def test_engines_agree_on_what_is_out_of_focus(kind, num_blades, ratio, registered, tmp_path):
    scene = glowing_squares((2.5, 9.0), 10.0, 4096, kind)
    dof = scene.camera.data.dof
    dof.use_dof, dof.focus_distance = True, 4.0
    # Apertures that show as spots some 10 px wide, those of the nearer square upside down.
    dof.aperture_fstop = 0.01 if kind == "PERSP" else 0.4
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = num_blades, 0.4, ratio
    # Up to 1 in 10 of 2 x 65536 samples meet a square of radiance 10 at most: 5 deviations of
    # independent ones, which these are better than.
    assert_engines_agree(tmp_path, atol=0.083)


@pytest.mark.parametrize(
    "kind, width_px", [("box", 1.5), ("gaussian", 1.5), ("blackman-harris", 1.5), ("gaussian", 4.0)]
)
def test_engines_agree_on_pixel_filters(kind, width_px, registered, tmp_path):
    scene = glowing_squares(DEPTHS, 1.0, 1024)
    scene.cycles.pixel_filter_type = kind.upper().replace("-", "_")
    scene.cycles.filter_width = scene.lighttree.filter_width_px = width_px
    scene.lighttree.filter = kind
    assert_engines_agree(tmp_path, atol=0.004)
    image = blend.render(tmp_path)
    scene.lighttree.filter = "box" if kind != "box" else "gaussian"
    assert abs(blend.render(tmp_path) - image).max() > 0.05


def test_engines_agree_on_a_transparent_film(registered, tmp_path):
    scene = glowing_squares(DEPTHS, 1.0, 1024)
    scene.render.film_transparent = True
    scene.render.image_settings.color_mode = "RGBA"
    _, background = blend.new_world()
    background.inputs["Color"].default_value = (0.2, 0.5, 1.0, 1.0)
    assert_engines_agree(tmp_path, 0.004, "RGBA")
    image = blend.render(tmp_path, "RGBA")
    assert image[..., 3].min() == 0 and image[..., 3].max() == 1
    assert np.all(image[image[..., 3] == 0] == 0)  # premultiplied
    scene.render.film_transparent = False
    assert np.all(blend.render(tmp_path, "RGBA")[..., 3] == 1)


def test_glass_that_is_transparent_is_noted():
    new_scene()
    scene = bpy.context.scene
    scene.cycles.film_transparent_glass = True
    assert extract().not_modelled == []
    scene.render.film_transparent = True
    assert extract().film_transparent
    assert extract().not_modelled == ["Scene: the film is not transparent behind glass."]
