"""Means of textures over triangles: those of many points, and no hot texel is missed."""

import math

import numpy as np
import pytest
from core_scenes import fewer, floor_scene
from test_textures import (
    EXTENSIONS,
    INTERPOLATIONS,
    all_extensions,
    both_interpolations,
    byte_and_float,
    curved,
    random_image,
    reference,
    textured_scene,
)

from lighttree_core.scene import (
    BLUE,
    CLOSEST,
    COLOR_ATTRIBUTE,
    FACING,
    GREEN,
    LUMINANCE_OF_RGB,
    OPACITY,
    RED,
    RGB,
    Textures,
)
from lighttree_core.texture_means import texture_means

NUM_TRIANGLES = fewer(20, 5)


def sampled_means(scene, num_samples):
    """Means over triangles from random points."""
    b = np.random.default_rng(3).uniform(0, 1, (num_samples, 2))
    b[b.sum(axis=1) > 1] = 1 - b[b.sum(axis=1) > 1]
    means = []
    for corners in scene.uvs[0].astype(np.float64):
        points = np.column_stack([1 - b.sum(axis=1), b]) @ corners
        table = scene.textures
        height, width = table.size[0, ::-1]
        texels = table.float_texels if table.is_float[0] else table.texels
        image = texels.reshape(height, width, 4)
        columns = table.extension[0], table.interpolation[0]
        means.append(reference(image, points, *columns)[:, :3].mean(axis=0))
    return np.array(means)


@all_extensions
@both_interpolations
@byte_and_float
def test_means_are_those_of_many_points(extension, interpolation, is_float):
    rng = np.random.default_rng(7)
    image = random_image(rng, is_float)
    # From parts of a texel to some images across.
    num = NUM_TRIANGLES
    center = rng.uniform(-1, 2, (num, 1, 2))
    uvs = center + rng.normal(size=(num, 3, 2)) * 10 ** rng.uniform(-3, -0.3, (num, 1, 1))
    scene = textured_scene(image, np.clip(uvs, -3, 4))
    scene.textures.extension[0] = EXTENSIONS[extension]
    scene.textures.interpolation[0] = INTERPOLATIONS[interpolation]
    found = texture_means(scene, 0, np.arange(num))
    # Where a border of texels cuts a triangle, 16 samples at least tell the parts to a fifth or so.
    spread = image[..., :3].std() / (1 if is_float else 255)
    atol = (0.25 if interpolation == "Closest" else 0.1) * spread
    np.testing.assert_allclose(found, sampled_means(scene, 20_000), rtol=0.03, atol=atol)


def quad_uvs(x0, y0, x1, y1):
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    return corners[[[0, 1, 2], [0, 2, 3]]]


@pytest.mark.parametrize("shape", [(64, 64), (300, 517), (8, 1000)])
def test_a_hot_texel_is_not_missed(shape):
    rng = np.random.default_rng(7)
    for _ in range(fewer(20, 2)):
        row, column = (int(rng.integers(n)) for n in shape)
        image = np.zeros((*shape, 4), np.float32)
        image[row, column] = 1e4
        scene = textured_scene(image, quad_uvs(0, 0, 1, 1))
        means = texture_means(scene, 0, np.arange(2))[:, 0]
        # Within the lattice of samples, and what the borders of blocks and triangles blur.
        assert means.mean() == pytest.approx(1e4 / np.prod(shape), rel=0.5)


def test_a_hot_texel_counts_for_the_triangle_that_shows_it():
    image = np.zeros((512, 512, 4), np.float32)
    image[300, 200] = 1e4
    # The image in 16 strips of two triangles.
    strips = [quad_uvs(0, k / 16, 1, (k + 1) / 16) for k in range(16)]
    scene = textured_scene(image, np.concatenate(strips))
    means = texture_means(scene, 0, np.arange(32))[:, 0].reshape(16, 2).mean(axis=1)
    expected = np.where(np.arange(16) == 300 * 16 // 512, 16 * 1e4 / 512**2, 0)
    np.testing.assert_allclose(means, expected, rtol=0.5)


def test_means_of_many_repetitions_and_copies():
    rng = np.random.default_rng(7)
    image = random_image(rng, is_float=True, shape=(30, 50))
    scene = textured_scene(image, np.tile(quad_uvs(0, 0, 200, 100), (10, 1, 1)))
    means = texture_means(scene, 0, np.arange(19))
    assert means.shape == (19, 3)
    np.testing.assert_allclose(means, np.tile(image[..., :3].mean((0, 1)), (19, 1)), rtol=1e-3)
    assert texture_means(scene, 0, np.arange(0)).shape == (0, 3)


def test_means_of_lines_and_points():
    # From black to white over ten texels; the map of some triangles has no area.
    image = np.repeat(np.linspace(0, 1, 10, dtype=np.float32), 4).reshape(1, 10, 4)
    line, point = [(0.1, 0.5), (0.4, 0.5), (0.8, 0.5)], [(0.95, 0.5)] * 3
    sliver = [(0.0, 0.0), (1.0, 1e-7), (1.0, 0.0)]
    scene = textured_scene(image, [line, point, sliver])
    means = texture_means(scene, 0, np.arange(3))[:, 0]
    expected = [np.interp(1.3 / 3, (0.05, 0.95), (0, 1)), 1, np.interp(2 / 3, (0.05, 0.95), (0, 1))]
    np.testing.assert_allclose(means, expected, atol=0.06)


def test_means_of_all_outputs():
    image = np.array([[[0.1, 0.3, 0.7, 0.4]]], np.float32)
    scale, bias = np.array([2, 3, -1], np.float32), np.array([0.5, 0, 1], np.float32)
    for output, taken in (
        (RGB, np.array([0.1, 0.3, 0.7])),
        (OPACITY, 0.4),
        (LUMINANCE_OF_RGB, 0.2126 * 0.1 + 0.7152 * 0.3 + 0.0722 * 0.7),
        (RED, 0.1),
        (GREEN, 0.3),
        (BLUE, 0.7),
    ):
        scene = textured_scene(image, quad_uvs(0, 0, 9, 9), output=output, scale=scale, bias=bias)
        found = texture_means(scene, 0, np.array([1]))
        np.testing.assert_allclose(found, (bias + scale * taken)[None], rtol=1e-6)


def test_means_of_colour_attributes():
    scene = floor_scene()
    scene.colors = np.random.default_rng(7).uniform(0, 1, (2, 2, 3, 3)).astype(np.float32)
    scene.textures = Textures.empty(1)
    scene.textures.kind[:], scene.textures.source[:] = COLOR_ATTRIBUTE, 1
    found = texture_means(scene, 0, np.array([1, 0, 1]))
    np.testing.assert_allclose(found, scene.colors[1, [1, 0, 1]].mean(axis=1), rtol=1e-6)


def test_means_of_what_hangs_on_the_angle_are_of_light_from_everywhere():
    # 1 - cosine^2, of which the mean, weighed by the cosine, is 1/2.
    scene = floor_scene()
    scene.textures = Textures.empty(1)
    scene.textures.kind[:], scene.textures.scale[:], scene.textures.bias[:] = FACING, 2, 1
    curved(scene, [np.repeat(1 - np.linspace(0, 1, 65)[:, None] ** 2, 3, axis=1)])
    found = texture_means(scene, 0, np.array([0, 1]))
    np.testing.assert_allclose(found, np.full((2, 3), 2), rtol=1e-4)


@pytest.mark.parametrize("repeats", [0.1, 1, 20])
def test_curves_come_before_means(repeats):
    # A few texels are above the step of the curve, the mean of all is not.
    rng = np.random.default_rng(7)
    image = random_image(rng, is_float=False, shape=(64, 64))
    image[..., 0] = np.where(rng.random((64, 64)) < 0.1, 250, 20)
    scene = textured_scene(image, quad_uvs(0, 0, repeats, repeats), output=RED)
    scene.textures.interpolation[:] = CLOSEST
    curved(scene, [np.repeat(np.linspace(0, 1, 65)[:, None] > 0.5, 3, axis=1)])
    found = texture_means(scene, 0, np.arange(2)).mean()
    texels = image[: math.ceil(64 * repeats), : math.ceil(64 * repeats), 0]
    np.testing.assert_allclose(found, (texels == 250).mean(), rtol=0.4 if repeats < 1 else 0.02)


def test_means_of_curves_of_colour_attributes():
    scene = floor_scene()
    scene.colors = np.random.default_rng(7).uniform(0, 1, (1, 2, 3, 3)).astype(np.float32)
    scene.textures = Textures.empty(1)
    scene.textures.kind[:] = COLOR_ATTRIBUTE
    row = np.linspace(0, 1, 257)[:, None] ** (2, 3, 4)
    curved(scene, [row])
    found = texture_means(scene, 0, np.array([1, 0]))
    expected = (scene.colors[0, [1, 0]] ** (2, 3, 4)).mean(axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-4)
