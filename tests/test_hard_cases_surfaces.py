"""Hard cases of light trees that need textures, mapped normals, gloss and light from behind."""

import numpy as np
import pytest
from core_scenes import add_triangles, camera, fewer, floor_scene, lamps_down, materials
from tree_probe import ORIGIN, UP, all_expected, build

from lighttree_core import Settings, render
from lighttree_core.scene import (
    CLOSEST,
    COLOR,
    DIFFUSE,
    GLOSSY,
    POINT,
    ROUGHNESS,
    TRANSLUCENT,
    Closures,
    Textures,
)

# 4.5 sigma: one false alarm in 150,000.
SIGMAS = 4.5
SQUARE = np.array([[(-1, -1), (1, -1), (1, 1)], [(-1, -1), (1, 1), (-1, 1)]], float)
FACING_DOWN = SQUARE[:, ::-1]


def placed(square, height, center=(0.0, 0.0)):
    """Triangles of a square of 2 m at some height."""
    corners = np.full((2, 3, 3), float(height))
    corners[..., :2] = square + center
    return corners


def floor_of(kind, **values):
    """A floor with one closure, seen from below the emitters by one pixel at the origin."""
    scene = floor_scene(camera=camera(1, 1, position=(0, 0, 1), half_width=1e-3))
    scene.materials = materials((0.0, 0.0), (0.0, 1.0))
    scene.materials.num_closures[0] = 1
    scene.closures = Closures.empty(1)
    scene.closures.kind[:], scene.closures.weight[:] = kind, 1
    for column, value in values.items():
        scene.closures.values[0, int(column[1:])] = value
    return scene


def emit_texture(scene, texels):
    """Let material 1 emit the texels of an image, (h, w); it covers the square at 2 m once."""
    height, width = texels.shape
    add_triangles(scene, placed(FACING_DOWN, 2.0), 1)
    scene.uvs = np.zeros((1, len(scene.triangles), 3, 2), np.float32)
    scene.uvs[0, -2:] = (FACING_DOWN + 1) / 2
    scene.textures = Textures.empty(1, 1)
    scene.textures.interpolation[:] = CLOSEST
    scene.textures.size[0], scene.textures.is_float[0] = (width, height), True
    rgba = np.repeat(texels.reshape(-1, 1), 4, axis=1)
    scene.textures.float_texels = rgba.astype(np.float32)
    scene.materials.emission_texture[1] = 0
    scene.materials.emission[1, 1] = 0


def irradiance(texels, at=(0.0, 0.0), n=400):
    """W/m^2 on the floor under those texels, by the midpoint rule."""
    place = (np.arange(n) + 0.5) / n
    x, y = 2 * place[None] - 1 - at[0], 2 * place[:, None] - 1 - at[1]
    rows = (place * len(texels)).astype(int)
    columns = (place * texels.shape[1]).astype(int)
    dist_sq = x**2 + y**2 + 4
    return (texels[rows][:, columns] * 4 / dist_sq**2).sum() * (2 / n) ** 2


def assert_mean(film, expected, share=0.0):
    """A one-pixel image has this mean; share: of it that the expectation itself may be off."""
    tolerance = SIGMAS * np.sqrt(film.variance[0, 0, 1]) + share * abs(expected)
    assert abs(film.mean[0, 0, 1] - expected) < tolerance


def test_hard_case_26_an_emission_texture_with_one_hot_texel_is_sampled_there():
    texels = np.zeros((16, 16))
    texels[12, 3] = 500.0
    scene = floor_scene(camera=camera(1, 1, position=(0, 0, 1), half_width=1e-3))
    scene.materials = materials((0.5, 0.0), (0.0, 1.0))
    emit_texture(scene, texels)
    # Only the triangle with the texel is a light, and no other is ever picked.
    expected = all_expected(build(scene), ORIGIN, UP)
    assert np.sort(expected).tolist() == [0, 1]
    film = render(scene, Settings(samples=fewer(2**15, 256), max_bounces=0))
    assert_mean(film, 0.5 / np.pi * irradiance(texels), 1e-3)
    # Its samples weigh no more than those of the whole triangle: radiance x area x cos^2 / d^2.
    most = 0.5 / np.pi * 500 * 2 / 4
    assert film.radiance_sum_sq[0, 0, 1] <= film.radiance_sum[0, 0, 1] * most * 1.01
    texels[:] = 0
    scene.textures.float_texels[:] = 0
    assert not all_expected(build(scene), ORIGIN, UP).any()
    assert not render(scene, Settings(samples=4, max_bounces=0)).mean.any()


@pytest.mark.parametrize("tilt_deg", [30, 70])
def test_hard_case_31_a_light_between_two_horizons_leaves_no_black_band(tilt_deg):
    scene = floor_of(DIFFUSE, **{f"c{ROUGHNESS}": 0.0, f"c{COLOR + 1}": 0.5})
    tilt = np.radians(tilt_deg)
    normal = (np.sin(tilt), 0.0, np.cos(tilt))
    scene.textures = Textures.empty(1, 1)
    scene.textures.size[0], scene.textures.is_float[0] = (1, 1), True
    scene.textures.float_texels = np.float32([[*((np.array(normal) + 1) / 2), 1.0]])
    scene.closures.normal_texture[0] = 0
    # One light before the slope, one behind it, both low: each is above one of the horizons.
    wall = placed(SQUARE, 0.0)[..., [2, 0, 1]]  # in the plane x = 0
    for x, order in ((4.0, -1), (-4.0, 1)):
        add_triangles(scene, wall[:, ::order] + (x, 0, 0.5), 1)
    scene.materials.emission[1] = 1.0
    corners = np.concatenate([scene.vertices[t] for t in scene.triangles])
    scene.uvs = np.ascontiguousarray(corners[:, :2].reshape(1, -1, 3, 2))
    settings = Settings(samples=fewer(2**15, 256), max_bounces=0)
    both = render(scene, settings)
    scene.materials.light_sampled[:] = False
    by_rays = render(scene, settings)
    assert both.mean[0, 0, 1] > 0.005
    spread = np.sqrt(both.variance[0, 0, 1] + by_rays.variance[0, 0, 1])
    assert abs(both.mean[0, 0, 1] - by_rays.mean[0, 0, 1]) < SIGMAS * spread


def test_hard_case_32_translucent_surfaces_find_light_that_is_only_behind():
    for position, is_behind in (((0, 0, -2), True), ((0, 0, 2), False)):
        scene = floor_of(TRANSLUCENT, **{f"c{COLOR + 1}": 0.5})
        scene.lamps = lamps_down(POINT, [position, (3, 0, -2)], 10.0)
        film = render(scene, Settings(samples=fewer(2**13, 256), max_bounces=0))
        # Both at 2 m and at sqrt(13) m below; what is above gives nothing.
        expected = 0.5 / np.pi * 10 * (is_behind / 4 + 2 / 13**1.5)
        assert_mean(film, expected, 1e-4)


@pytest.mark.parametrize("alpha", [0.001, 0.03, 0.3])
def test_hard_case_33_a_wet_road_reflects_thousands_of_windows_without_spikes(alpha):
    values = {f"c{ROUGHNESS}": np.sqrt(alpha), **{f"c{COLOR + k}": 1.0 for k in range(3)}}
    scene = floor_of(GLOSSY, **values)
    # None overlaps another in its plane, where a ray would meet but one of them.
    side = fewer(32, 6)
    centers = (np.stack(np.mgrid[:side, :side], axis=-1).reshape(-1, 2) - side / 2) * 1.3
    for height in (4.0, 7.0):
        squares = [placed(0.3 * FACING_DOWN, height, center + height / 9) for center in centers]
        add_triangles(scene, np.concatenate(squares), 1)
    scene.materials.emission[1, 1] = 0
    scene.camera = camera(8, 8, position=(0, 0, 3.9), half_width=0.5)
    settings = Settings(samples=fewer(2048, 32), max_bounces=0)
    both = render(scene, settings)
    scene.materials.light_sampled[:] = False
    by_rays = render(scene, settings)
    spread = np.sqrt((both.variance + by_rays.variance)[..., 1].sum())
    assert abs((both.mean - by_rays.mean)[..., 1].sum()) < SIGMAS * spread
    # Light sampling may not add noise to what reflection alone finds: weights keep its spikes out.
    assert both.variance[..., 1].sum() < 1.1 * by_rays.variance[..., 1].sum()
    assert both.dropped_samples == 0
