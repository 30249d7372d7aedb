"""Values of textures against a plain numpy reference and Cycles."""

import numpy as np
import pytest
from core_scenes import fewer, floor_scene

from lighttree_core import Settings
from lighttree_core.scene import (
    BLUE,
    CLIP,
    CLOSEST,
    COLOR_ATTRIBUTE,
    EXTEND,
    FACING,
    GREEN,
    LINEAR,
    LUMINANCE_OF_RGB,
    MIRROR,
    OPACITY,
    RED,
    REPEAT,
    RGB,
    Textures,
)
from lighttree_core.textures import texture_value
from lighttree_core.world import World, build_world

EXTENSIONS = {"REPEAT": REPEAT, "EXTEND": EXTEND, "CLIP": CLIP, "MIRROR": MIRROR}
INTERPOLATIONS = {"Linear": LINEAR, "Closest": CLOSEST}
PAD_MODES = {REPEAT: "wrap", EXTEND: "edge", CLIP: "constant", MIRROR: "symmetric"}
NUM = fewer(200, 20)
UP = tuple(np.float32([0, 0, 1]))

all_extensions = pytest.mark.parametrize("extension", EXTENSIONS)
both_interpolations = pytest.mark.parametrize("interpolation", INTERPOLATIONS)
byte_and_float = pytest.mark.parametrize("is_float", [False, True], ids=["byte", "float"])


def random_image(rng, is_float, shape=(5, 7)):
    if is_float:
        return rng.lognormal(0, 1, (*shape, 4)).astype(np.float32)
    return rng.integers(0, 256, (*shape, 4)).astype(np.uint8)


def textures_of(image, num_textures=1, **columns) -> Textures:
    """Textures that all show one image, sRGB if it is of bytes; columns: scalars or rows."""
    table = Textures.empty(num_textures, 1)
    table.size[0] = image.shape[1], image.shape[0]
    table.is_float[0] = image.dtype == np.float32
    table.is_srgb[0] = not table.is_float[0]
    name = "float_texels" if table.is_float[0] else "texels"
    setattr(table, name, image.reshape(-1, 4))
    for name, values in columns.items():
        getattr(table, name)[:] = values
    return table


def textured_scene(image, uvs, **columns):
    """A scene with so many triangles as there are (n, 3, 2) uvs, for what reads no geometry."""
    scene = floor_scene()
    scene.uvs = np.asarray(uvs, np.float32).reshape(1, -1, 3, 2)
    scene.textures = textures_of(image, **columns)
    return scene


def world_of(scene) -> World:
    return build_world(scene, Settings())


def values(scene, barycentric, texture_id=0, triangles=None, direction=UP):
    """Values at one point of each triangle, seen along a direction."""
    world = world_of(scene)
    triangles = range(len(barycentric)) if triangles is None else triangles
    return np.array(
        [
            texture_value(
                world.geometry,
                world.textures,
                texture_id,
                int(t),
                np.float32(b[0]),
                np.float32(b[1]),
                direction,
            )
            for t, b in zip(triangles, barycentric, strict=True)
        ]
    )


def decode(encoded):
    return np.where(encoded < 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def reference(image, points, extension, interpolation):
    """RGBA at (n, 2) points of the image, -3 to 4, from a padded copy."""
    height, width = image.shape[:2]
    padded = np.pad(
        image.astype(np.float64) / (255 if image.dtype == np.uint8 else 1),
        ((4 * height,) * 2, (4 * width,) * 2, (0, 0)),
        PAD_MODES[extension],
    )
    x, y = ((points + 4) * (width, height) - 0.5 * (interpolation == LINEAR)).T
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    rgba = padded[j, i]
    if interpolation == LINEAR:
        tx, ty = (x - i)[:, None], (y - j)[:, None]
        lower = rgba * (1 - tx) + padded[j, i + 1] * tx
        rgba = lower * (1 - ty) + (padded[j + 1, i] * (1 - tx) + padded[j + 1, i + 1] * tx) * ty
    if image.dtype == np.uint8:
        rgba[:, :3] = decode(rgba[:, :3])
    return rgba


def random_points(rng, num=NUM):
    """(num, 3, 2) corners and (num, 2) barycentric coordinates, and the (num, 2) points there."""
    uvs = rng.uniform(-1.5, 2.5, (num, 3, 2)).astype(np.float32)
    barycentric = np.sort(rng.uniform(0, 1, (num, 2)), axis=1)
    barycentric[:, 1] -= barycentric[:, 0]
    weights = np.column_stack([1 - barycentric.sum(axis=1), barycentric])
    return uvs, barycentric, np.einsum("nk,nkj->nj", weights, uvs)


@all_extensions
@both_interpolations
@byte_and_float
def test_images_match_the_reference(extension, interpolation, is_float):
    rng = np.random.default_rng(7)
    image = random_image(rng, is_float)
    uvs, barycentric, points = random_points(rng)
    columns = {
        "extension": EXTENSIONS[extension],
        "interpolation": INTERPOLATIONS[interpolation],
    }
    found = values(textured_scene(image, uvs, **columns), barycentric)
    np.testing.assert_array_equal(found, found.astype(np.float32))
    # Points beside a border of texels may be rounded across it; none of these are.
    expected = reference(image, points, *columns.values())[:, :3]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_points_are_mapped_into_the_image():
    rng = np.random.default_rng(7)
    image = random_image(rng, is_float=False)
    uvs, barycentric, points = random_points(rng)
    turned = np.array([[0.5, -0.3, 0.2], [0.4, 0.6, -0.1]], np.float32)
    found = values(textured_scene(image, uvs, image_from_uv=turned), barycentric)
    points = points @ turned[:, :2].T + turned[:, 2]
    expected = reference(image, points, REPEAT, LINEAR)[:, :3]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_colours_are_decoded_after_interpolation():
    image = np.zeros((1, 2, 4), np.uint8)
    image[0, 1] = 255
    middle = np.full((1, 3, 2), 0.5)
    found = values(textured_scene(image, middle), [(0.2, 0.3)])
    np.testing.assert_allclose(found, decode(np.float64(0.5)), rtol=1e-5)


@pytest.mark.parametrize(
    "output, expected",
    [
        (RGB, (0.1, 0.3, 0.7)),
        (OPACITY, 0.4),
        (LUMINANCE_OF_RGB, 0.2126 * 0.1 + 0.7152 * 0.3 + 0.0722 * 0.7),
        (RED, 0.1),
        (GREEN, 0.3),
        (BLUE, 0.7),
    ],
)
def test_outputs_are_scaled_and_biased(output, expected):
    image = np.array([[[0.1, 0.3, 0.7, 0.4]]], np.float32)
    scale, bias = np.array([2, 3, -1], np.float32), np.array([0.5, 0, 1], np.float32)
    scene = textured_scene(image, np.zeros((1, 3, 2)), output=output, scale=scale, bias=bias)
    expected = bias + scale * expected
    np.testing.assert_allclose(values(scene, [(0.3, 0.3)])[0], expected, rtol=1e-6)


def test_each_texture_has_its_own_image_and_map():
    scene = textured_scene(np.zeros((2, 2, 4), np.float32), np.zeros((1, 3, 2)), num_textures=2)
    table = scene.textures
    scene.uvs = np.array([[[(0, 0)] * 3], [[(0.9, 0.9)] * 3]], np.float32)
    table.source[:], table.uv_map[:], table.interpolation[:] = (1, 0), (0, 1), CLOSEST
    table.size = np.array([(2, 2), (3, 1)], np.int32)
    table.is_float, table.is_srgb = np.array([True, False]), np.array([False, False])
    # The bytes start with an image that no texture shows.
    table.first_texel = np.array([0, 5], np.int64)
    table.float_texels[3] = 7
    table.texels = np.zeros((8, 4), np.uint8)
    table.texels[5] = 51
    np.testing.assert_allclose(values(scene, [(0, 0)], texture_id=0), 0.2, rtol=1e-6)
    np.testing.assert_allclose(values(scene, [(0, 0)], texture_id=1), 7)


def test_colour_attributes_are_interpolated():
    rng = np.random.default_rng(7)
    scene = floor_scene()
    scene.colors = rng.uniform(0, 1, (2, 2, 3, 3)).astype(np.float32)
    scene.textures = Textures.empty(2)
    scene.textures.kind[:], scene.textures.source[:] = COLOR_ATTRIBUTE, 1
    scene.textures.output[1] = OPACITY
    found = values(scene, [(0.2, 0.5)] * 2)
    expected = np.einsum("k,tkc->tc", (0.3, 0.2, 0.5), scene.colors[1])
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    np.testing.assert_allclose(values(scene, [(0.2, 0.5)], texture_id=1), 1)


def curved(scene, rows):
    """Add a curve, (N, 3) numbers for each texture, to the textures of a scene."""
    table = scene.textures
    for texture_id, row in enumerate(rows):
        table.curve[texture_id] = len(table.size)
        table.size = np.concatenate([table.size, np.int32([[len(row), 1]])])
        table.is_float, table.is_srgb = (
            np.append(table.is_float, True),
            np.append(table.is_srgb, False),
        )
        table.first_texel = np.append(table.first_texel, len(table.float_texels))
        texels = np.pad(np.float32(row), ((0, 0), (0, 1)))
        table.float_texels = np.concatenate([table.float_texels, texels])


def through(row, taken):
    """What a curve makes of (n, 3) numbers."""
    places = np.linspace(0, 1, len(row))
    return np.transpose([np.interp(taken[:, k], places, row[:, k]) for k in range(3)])


@pytest.mark.parametrize("output", [RGB, OPACITY, LUMINANCE_OF_RGB, GREEN])
def test_what_is_taken_goes_through_a_curve(output):
    rng = np.random.default_rng(7)
    image, rows = random_image(rng, is_float=False), rng.random((2, 9, 3))
    uvs, barycentric, _ = random_points(rng)
    scale, bias = np.array([2, 3, -1], np.float32), np.array([0.5, 0, 1], np.float32)
    scene = textured_scene(image, uvs, num_textures=2, output=output, scale=scale, bias=bias)
    plain = (values(scene, barycentric) - bias) / scale
    curved(scene, rows)
    for texture_id, row in enumerate(rows):
        found = values(scene, barycentric, texture_id)
        np.testing.assert_allclose(found, bias + scale * through(row, plain), atol=1e-4)


@pytest.mark.parametrize("is_smooth", [False, True])
def test_how_much_a_surface_faces_the_ray(is_smooth):
    rng = np.random.default_rng(7)
    scene, row = floor_scene(), rng.random((9, 3))
    scene.textures = Textures.empty(2)
    scene.textures.kind[:] = FACING
    curved(scene, [row])
    scene.check()
    normals = np.broadcast_to(np.float32(UP), (2, 3, 3))
    if is_smooth:
        normals = normals + rng.uniform(-0.5, 0.5, (2, 3, 3)).astype(np.float32)
        scene.corner_normals = normals
    n = np.einsum("k,tkc->tc", (0.3, 0.2, 0.5), normals)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for direction in rng.normal(size=(NUM, 3)):
        direction = (direction / np.linalg.norm(direction)).astype(np.float32)
        cosines = np.repeat(abs(n @ direction)[:, None], 3, axis=1)
        for texture_id, expected in ((0, through(row, cosines)), (1, cosines)):
            found = values(scene, [(0.2, 0.5)] * 2, texture_id, direction=tuple(direction))
            np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("extension", EXTENSIONS.values())
def test_far_points_stay_in_the_image(extension):
    image = np.ones((3, 5, 4), np.float32)
    for far in (1e6, -1e6, 1e12, -1e12):
        scene = textured_scene(image, np.full((1, 3, 2), far), extension=extension)
        expected = 0 if extension == CLIP else 1
        np.testing.assert_allclose(values(scene, [(0.3, 0.3)]), expected, rtol=1e-6)


@pytest.mark.blender
@byte_and_float
def test_lookups_equal_cycles(is_float, tmp_path):
    import blender_scenes as blend
    import bpy

    rng = np.random.default_rng(7)
    image = random_image(rng, is_float)
    image[..., 3] = 1 if is_float else 255
    num = 24  # squares, each of one pixel and one point of the image, along each side
    for extension in EXTENSIONS:
        for interpolation in INTERPOLATIONS:
            uvs = rng.uniform(-1, 2, (num * num, 1, 2)).repeat(3, axis=1)
            columns = EXTENSIONS[extension], INTERPOLATIONS[interpolation]
            blend.new_file(samples=1)
            bpy.context.scene.render.resolution_x = num
            bpy.context.scene.render.resolution_y = num
            material = blend.new_material(shader="ShaderNodeEmission")
            node = material.node_tree.nodes.new("ShaderNodeTexImage")
            node.image = blender_image(bpy, image)
            node.extension, node.interpolation = extension, interpolation
            emission = next(n for n in material.node_tree.nodes if n.type == "EMISSION")
            material.node_tree.links.new(node.outputs["Color"], emission.inputs["Color"])
            blend.add_object("Squares", squares_mesh(bpy, num, uvs[:, 0], material))
            blend.add_camera(ortho_scale=num, location=(num / 2, num / 2, 1))
            scene = textured_scene(image, uvs)
            scene.textures.extension[0], scene.textures.interpolation[0] = columns
            expected = values(scene, [(0.25, 0.25)] * num**2).reshape(num, num, 3)
            np.testing.assert_allclose(blend.render(tmp_path), expected, rtol=1e-4, atol=1e-5)


def blender_image(bpy, pixels):
    is_float = pixels.dtype == np.float32
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("Image", width, height, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = "Linear Rec.709" if is_float else "sRGB"
    image.pixels.foreach_set((pixels / (1 if is_float else 255)).astype(np.float32).ravel())
    image.update()
    image.pack()
    return image


def squares_mesh(bpy, num, uvs, material):
    """Squares of 1 m from the origin on, the corners of each at one point of the UV map."""
    mesh = bpy.data.meshes.new("Squares")
    x, y = (a.ravel() for a in np.meshgrid(np.arange(num), np.arange(num)))
    corners = [np.column_stack([x + i, y + j, 0 * x]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    mesh.from_pydata(vertices.tolist(), [], np.arange(len(vertices)).reshape(-1, 4).tolist())
    layer = mesh.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", uvs.repeat(4, axis=0).astype(np.float32).ravel())
    mesh.materials.append(material)
    return mesh
