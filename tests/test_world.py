"""Worlds: their images lie where Cycles has them, and what is left out is noted."""

import math

import bpy
import numpy as np
import pytest
from blender_scenes import (
    add_backdrop,
    add_camera,
    add_node,
    add_probe,
    enable_nodes,
    new_file,
    new_world,
    radians,
    render,
)

from lighttree_addon.nodes import Notes
from lighttree_addon.sky.image import MODELS
from lighttree_addon.world import read_world
from lighttree_core.environment import build_environment, environment_radiance
from lighttree_core.scene import (
    ALL_BOUNCES,
    ALL_RAYS,
    CAMERA_RAY,
    DIFFUSE_RAY,
    GLOSSY_RAY,
    Camera,
    Materials,
    Scene,
)

pytestmark = pytest.mark.blender

HEIGHT, WIDTH = 4, 8


def new_image(texels=None, is_float=True, name="Sky"):
    """An image; texels: (H, W, 3), random by default."""
    if texels is None:
        texels = np.random.default_rng(7).uniform(0.2, 1, (HEIGHT, WIDTH, 3))
    height, width = texels.shape[:2]
    image = bpy.data.images.new(name, width, height, float_buffer=is_float)
    pixels = np.concatenate([texels, np.ones((height, width, 1))], axis=2)
    image.pixels.foreach_set(pixels.ravel().astype(np.float32))
    image.pack()
    return image


def new_sky(image=None, strength=1.0):
    """A world of an Environment Texture: its tree, the texture's node, the Background node."""
    tree, background = new_world()
    background.inputs["Strength"].default_value = strength
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = new_image() if image is None else image
    tree.links.new(texture.outputs[0], background.inputs["Color"])
    return tree, texture, background


def read():
    """(background, environment, notes) of the scene's world."""
    notes = Notes()
    background, environment = read_world(bpy.context.scene.world, notes)
    return background, environment, notes.sentences()


def table():
    """The world as the renderer looks it up."""
    background, environment, _ = read()
    nothing = np.zeros((0, 3))
    scene = Scene(
        camera=Camera(np.eye(3, 4), 1, 1, 1, 1),
        vertices=nothing.astype(np.float32),
        triangles=nothing.astype(np.int32),
        triangle_material=np.zeros(0, np.int32),
        materials=Materials.empty(),
        background=background.astype(np.float32),
        environment=environment,
    )
    return build_environment(scene)


def assert_seen_as_in_cycles(tmp_path, rtol=0.02, num_points=4, dark=1e-3):
    """Cameras that look along about +X and -Y see of the sky what Cycles renders.

    dark: share of the mean that is a small error anywhere.
    """
    environment = table()
    for place in (radians(97, 3, -90), radians(120, 20, 180)):
        scene = bpy.context.scene
        camera = add_camera(settings={"angle": math.radians(100)}, rotation=place)
        scene.cycles.samples = 4 * num_points**2
        seen = render(tmp_path)
        matrix = np.array(camera.matrix_world)[:3, :3]
        half = math.tan(math.radians(50))
        expected = np.zeros_like(seen)
        # Means over a grid of points in each pixel.
        places = (np.arange(8 * num_points) + 0.5) / (8 * num_points) * 2 - 1
        for i, y in enumerate(places):
            for j, x in enumerate(places):
                direction = matrix @ np.array((x * half, y * half, -1))
                direction /= np.linalg.norm(direction)
                direction = tuple(np.float32(a) for a in direction)
                pixel = i // num_points, j // num_points
                expected[pixel] += environment_radiance(environment, direction)
        atol = dark * seen.mean()
        np.testing.assert_allclose(seen, expected / num_points**2, rtol=rtol, atol=atol)


TURN = radians(20, 30, 40)
MAPPINGS = {
    "point": ("POINT", TURN, (1, 1, 1)),
    "texture": ("TEXTURE", TURN, (1, 1, 1)),
    "vector": ("VECTOR", TURN, (2, 2, 2)),
    "normal": ("NORMAL", TURN, (1, 1, 1)),
    "mirrored": ("POINT", radians(0, 0, 70), (-1, 1, 1)),
    "texture-mirrored": ("TEXTURE", TURN, (0.5, -0.5, 0.5)),
}


def test_an_image_lies_where_cycles_has_it(tmp_path):
    new_file()
    new_sky(strength=2.0)
    assert_seen_as_in_cycles(tmp_path)
    background, environment, notes = read()
    np.testing.assert_allclose(background, 2.0)
    assert environment.image.shape == (HEIGHT, WIDTH, 3)
    assert (environment.visible, environment.max_bounces) == (ALL_RAYS, ALL_BOUNCES)
    assert notes == []


@pytest.mark.parametrize("name", MAPPINGS)
def test_a_mapping_turns_an_image_as_in_cycles(name, tmp_path):
    new_file()
    kind, rotation, scale = MAPPINGS[name]
    tree, texture, _ = new_sky()
    place = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.vector_type = kind
    mapping.inputs["Rotation"].default_value = rotation
    mapping.inputs["Scale"].default_value = scale
    tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    assert_seen_as_in_cycles(tmp_path)
    assert read()[2] == []


def test_bytes_are_decoded_by_the_srgb_curve(tmp_path):
    new_file()
    # The same all over: Cycles decodes after it has interpolated, LightTree before.
    new_sky(new_image(np.full((2, 4, 3), (0.2, 0.5, 0.8)), is_float=False))
    assert_seen_as_in_cycles(tmp_path)


def test_what_nodes_do_to_an_image_is_kept(tmp_path):
    new_file()
    tree, texture, background = new_sky()
    grey = tree.nodes.new("ShaderNodeRGBToBW")
    tree.links.new(texture.outputs[0], grey.inputs[0])
    tree.links.new(grey.outputs[0], background.inputs["Color"])
    glow = add_node(tree, "ShaderNodeBackground", Color=(0.1, 0.2, 0.3), Strength=2.0)
    add = tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(background.outputs[0], add.inputs[0])
    tree.links.new(glow.outputs[0], add.inputs[1])
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputWorld")
    tree.links.new(add.outputs[0], output.inputs["Surface"])
    assert_seen_as_in_cycles(tmp_path)
    assert read()[2] == []


def test_texels_that_are_no_numbers_are_black():
    new_file()
    texels = np.ones((2, 4, 3))
    texels[0, 1] = math.inf, 1.0, 1.0
    new_sky(new_image(texels))
    assert read()[1].image[0, 1].tolist() == [0, 0, 0]


def test_worlds_without_image():
    new_file()
    bpy.context.scene.world = None
    assert read()[0].tolist() == [0, 0, 0]
    _, background = new_world()
    background.inputs["Color"].default_value = (0.5, 0.25, 0.125, 1.0)
    background.inputs["Strength"].default_value = 4.0
    color, environment, notes = read()
    np.testing.assert_allclose(color, (2, 1, 0.5), rtol=1e-6)
    assert environment.image.size == 0 and notes == []


def test_what_sees_a_world_and_for_how_long():
    new_file()
    _, _, background = new_sky()
    world = bpy.context.scene.world
    world.cycles_visibility.diffuse = world.cycles_visibility.transmission = False
    world.cycles.max_bounces = 3
    _, environment, notes = read()
    assert environment.visible == CAMERA_RAY | GLOSSY_RAY == ALL_RAYS & ~(DIFFUSE_RAY | 8)
    assert environment.max_bounces == 3 and notes == []
    # Cycles does not sample a constant world, and so never counts.
    background.id_data.links.remove(background.inputs["Color"].links[0])
    assert read()[1].max_bounces == ALL_BOUNCES


def test_a_colour_that_only_the_camera_sees_is_kept():
    new_file()
    tree, _, background = new_sky()
    assert read()[1].camera_color.shape == (0, 3)
    add_backdrop(tree, background, (0, 1, 0)).inputs["Strength"].default_value = 2.0
    background, environment, notes = read()
    assert background.tolist() == [1, 1, 1] and environment.image.size > 0
    assert environment.camera_color.tolist() == [[0, 2, 0]] and notes == []
    # The camera sees nothing of a world that is hidden from it, in Cycles too.
    bpy.context.scene.world.cycles_visibility.camera = False
    assert read()[1].camera_color.shape == (0, 3)


def test_an_image_that_only_the_camera_sees_is_noted():
    new_file()
    tree, texture, background = new_sky()
    backdrop = add_backdrop(tree, background)
    tree.links.new(texture.outputs[0], backdrop.inputs["Color"])
    assert read()[1].camera_color.shape == (0, 3) and read()[2] == []  # it is the same
    backdrop.inputs["Strength"].default_value = 2.0
    _, environment, notes = read()
    assert environment.camera_color.shape == (0, 3)
    assert notes == ["World World: the camera sees of it what other rays see."]


def _mirror_ball(tree, texture):
    texture.projection = "MIRROR_BALL"
    return "its projection Mirror ball is not modelled"


def _moved(tree, texture):
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = (0, 0, 1)
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs[0])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    return "the Location of Mapping is not modelled"


def _stretched(tree, texture):
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = (1, 1, 2)
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs[0])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    return "the Scale of Mapping is not modelled"


def _other_coordinates(tree, texture):
    place = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(place.outputs["Window"], texture.inputs["Vector"])
    return "Window of Texture Coordinate is not modelled"


def _everywhere_the_same(tree, texture):
    mapping = tree.nodes.new("ShaderNodeMapping")
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    return "Mapping is a constant"


def _old_mapping(tree, texture):
    texture.texture_mapping.rotation = (0, 0, 1)
    return "the Texture Mapping of Environment Texture is not modelled"


FAULTS = (_mirror_ball, _moved, _stretched, _other_coordinates, _everywhere_the_same, _old_mapping)


@pytest.mark.parametrize("spoil", FAULTS)
def test_an_image_without_direction_becomes_its_mean(spoil):
    new_file()
    tree, texture, _ = new_sky(new_image(np.full((2, 4, 3), (0.1, 0.2, 0.3))))
    fault = spoil(tree, texture)
    background, environment, notes = read()
    np.testing.assert_allclose(background, (0.1, 0.2, 0.3), rtol=1e-5)
    assert environment.image.size == 0
    assert notes == [
        f"World World: Environment Texture has no direction, as {fault}.",
        "World World: image Sky in Environment Texture is replaced by its mean.",
    ]


SKIES = {
    "low-sun": {"sun_elevation": math.radians(15), "sun_rotation": math.radians(30)},
    "high-up": {"sun_elevation": math.radians(130), "altitude": 3000.0, "air_density": 2.0},
    "dusk": {"sun_elevation": math.radians(-2), "sun_rotation": math.radians(200)},
}


def add_sky(sky_type, **settings):
    """A world of a Sky Texture."""
    tree, background = new_world()
    node = tree.nodes.new("ShaderNodeTexSky")
    node.sky_type = sky_type
    for key, value in settings.items():
        setattr(node, key, value)
    tree.links.new(node.outputs[0], background.inputs["Color"])
    return node


def sky_types():
    """The models of an atmosphere that this version of Blender has."""
    items = bpy.types.ShaderNodeTexSky.bl_rna.properties["sky_type"].enum_items
    return [item.identifier for item in items if item.identifier in MODELS]


@pytest.mark.parametrize("name", SKIES)
@pytest.mark.parametrize("sky_type", sky_types())
def test_a_sky_is_that_of_cycles(sky_type, name, tmp_path):
    new_file()
    add_sky(sky_type, sun_disc=False, **SKIES[name])
    # 1024 paths a pixel, of which those at the horizon see much change.
    assert_seen_as_in_cycles(tmp_path, rtol=0.04, num_points=16, dark=0.03)
    assert read()[2] == []


@pytest.mark.parametrize("sky_type", sky_types())
def test_the_disc_of_a_sky_lights_as_in_cycles(sky_type, tmp_path):
    add_probe(4096)
    add_sky(sky_type, sun_elevation=math.radians(40), sun_size=math.radians(2))
    background, environment, _ = read()
    height, width = environment.image.shape[:2]
    theta = (1 - (np.arange(height) + 0.5) / height) * math.pi
    ring = np.cos(theta).clip(0) * np.sin(theta) * (math.pi / height) * (2 * math.pi / width)
    expected = background * (environment.image.sum(axis=1) * ring[:, None]).sum(axis=0) / math.pi
    # The sun's disc is small, so Cycles' rays find it seldom or by chance.
    np.testing.assert_allclose(render(tmp_path).mean(axis=(0, 1)), expected, rtol=0.01)


def test_other_skies_are_noted():
    new_file()
    add_sky("HOSEK_WILKIE")
    _, environment, notes = read()
    assert environment.image.size == 0
    assert len(notes) == 1 and "comes from Sky Texture, which is not modelled" in notes[0]


def test_a_missing_image_is_magenta_as_in_cycles():
    new_file()
    _, texture, _ = new_sky()
    texture.image = None
    background, environment, notes = read()
    assert background.tolist() == [1, 0, 1] and environment.image.size == 0
    assert "missing image file (none chosen)" in notes[0]


def test_closest_interpolation_is_noted():
    new_file()
    _, texture, _ = new_sky()
    texture.interpolation = "Closest"
    note = "World World: Closest interpolation of Environment Texture is rendered as Linear."
    assert read()[2] == [note]


def test_a_world_of_nodes_without_output_is_black():
    new_file()
    world = bpy.data.worlds.new("World")
    bpy.context.scene.world = world
    enable_nodes(world).nodes.clear()
    assert read()[0].tolist() == [0, 0, 0]
