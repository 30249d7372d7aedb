"""Camera rays: filters, apertures and what is in focus, against their formulas."""

import dataclasses

import numpy as np
import pytest
from core_scenes import camera, fewer, floor_scene, point_lamps

from lighttree_core import Settings, render
from lighttree_core.camera import (
    BLACKMAN_HARRIS,
    BOX,
    FILTERS,
    GAUSSIAN,
    build_camera_table,
    build_filter_table,
    camera_ray,
    eval_filter,
    filter_offset,
    filter_reach,
    sample_aperture,
    sample_polygon,
    spawn_ray,
)

NUM = fewer(20000, 2000)
LENS = {"lens_radius": 0.2, "focus_distance": 4.0}
KINDS = pytest.mark.parametrize("orthographic", [False, True])


def random_pairs(num=NUM):
    return np.random.default_rng(7).random((num, 2), np.float32)


def at_depth(table, depth, x, y, u_lens):
    """(n, 2) where rays through a point of the image of a camera that looks down are at a depth."""
    places = []
    for u in u_lens:
        origin, direction, cos_axis = (np.array(a) for a in camera_ray(table, x, y, tuple(u)))
        places.append((origin + direction * (depth / cos_axis))[:2])
    return np.array(places)


def assert_uniform(counts):
    """Chi-square: its mean is the degrees of freedom, its variance twice that."""
    expected, freedom = counts.sum() / counts.size, counts.size - 1
    chi_square = np.sum((counts - expected) ** 2) / expected
    assert abs(chi_square - freedom) < 5 * np.sqrt(2 * freedom)


@KINDS
def test_all_rays_of_an_image_point_meet_in_the_plane_of_focus(orthographic):
    sharp = build_camera_table(camera(orthographic=orthographic, shift_x=0.3))
    lens = build_camera_table(camera(orthographic=orthographic, shift_x=0.3, **LENS))
    places = at_depth(lens, 4.0, np.float32(3), np.float32(8), random_pairs(50))
    expected = at_depth(sharp, 4.0, np.float32(3), np.float32(8), [(0.0, 0.0)])
    np.testing.assert_allclose(places, np.tile(expected, (50, 1)), atol=2e-6)


@KINDS
@pytest.mark.parametrize("depth", [1.0, 3.0, 9.0])
def test_a_point_out_of_focus_is_spread_over_its_circle_of_confusion(orthographic, depth):
    table = build_camera_table(camera(orthographic=orthographic, **LENS))
    places = at_depth(table, depth, np.float32(12), np.float32(2), random_pairs())
    # Similar triangles, with the lens as one side and the plane of focus as their tip.
    radius = 0.2 * abs(1 - depth / 4)
    middle = np.array([12 / 8 - 1, (2 / 4.5 - 1) * 9 / 16]) * (1 if orthographic else depth)
    distance = np.linalg.norm(places - middle, axis=1)
    assert distance.max() < radius * (1 + 1e-4) and distance.max() > radius * 0.99
    # The squared distance in a uniform disk is uniform.
    share = (distance / radius) ** 2
    assert_uniform(np.bincount(np.minimum((share * 16).astype(int), 15), minlength=16))


@pytest.mark.parametrize("num_corners", [3, 4, 5, 8])
def test_a_polygon_is_covered_evenly_and_not_left(num_corners):
    rotation = np.float32(0.3)
    points = np.array([sample_polygon(num_corners, rotation, tuple(u)) for u in random_pairs()])
    sides = 0.3 + 2 * np.pi / num_corners * np.arange(num_corners)
    # How far out each point lies towards each side, 1 on the side itself.
    outward = points @ np.array([np.cos(sides), np.sin(sides)]) / np.cos(np.pi / num_corners)
    share, sector = outward.max(1) ** 2, outward.argmax(1)
    assert share.max() < 1 + 1e-5
    assert np.linalg.norm(points, axis=1).max() > 0.95
    ring = np.minimum((share * 8).astype(int), 7)
    assert_uniform(np.bincount(sector * 8 + ring, minlength=8 * num_corners))


def test_the_lens_ratio_makes_the_aperture_narrower():
    wide = build_camera_table(camera(lens_ratio=0.5, **LENS))
    narrow = build_camera_table(camera(lens_ratio=2.0, num_blades=4, **LENS))
    reach = [
        np.abs([sample_aperture(t, tuple(u)) for u in random_pairs(2000)]).max(0)
        for t in (wide, narrow)
    ]
    # The corners of a square lie on the diagonals.
    np.testing.assert_allclose(reach[0], (0.4, 0.2), rtol=0.02)
    np.testing.assert_allclose(reach[1], np.array((0.1, 0.2)) * np.sqrt(0.5), rtol=0.02)


def test_fewer_than_three_blades_make_a_round_aperture():
    tables = [build_camera_table(camera(num_blades=n, **LENS)) for n in (0, 2)]
    assert sample_aperture(tables[0], (0.9, 0.2)) == sample_aperture(tables[1], (0.9, 0.2))


@KINDS
@pytest.mark.parametrize("lens_radius", [0.0, 0.5])
def test_rays_run_from_clip_plane_to_clip_plane(orthographic, lens_radius):
    table = build_camera_table(
        camera(orthographic=orthographic, clip_start=0.25, clip_end=7.0, lens_radius=lens_radius)
    )
    for pixel in range(0, 16 * 9, 5):
        origin, direction, max_distance = (np.array(a) for a in spawn_ray(table, 3, pixel, 1))
        assert np.linalg.norm(direction) == pytest.approx(1, abs=1e-6)
        assert origin[2] == pytest.approx(5 - 0.25, abs=1e-5)
        assert (origin + direction * max_distance)[2] == pytest.approx(5 - 7, abs=1e-5)


def test_a_lens_without_radius_is_a_pinhole():
    scene = floor_scene(point_lamps([(0, 0, 2)]))
    expected = render(scene, Settings(samples=2)).mean
    scene.camera = dataclasses.replace(
        scene.camera, focus_distance=0.5, num_blades=5, blade_rotation=1.0, lens_ratio=3.0
    )
    np.testing.assert_array_equal(render(scene, Settings(samples=2)).mean, expected)
    scene.camera = dataclasses.replace(scene.camera, lens_radius=0.5)
    assert np.any(render(scene, Settings(samples=2)).mean != expected)


def test_depth_is_along_the_axis_whatever_the_lens():
    scene = floor_scene(camera=camera(clip_start=0.5, **LENS))
    np.testing.assert_allclose(render(scene, Settings(samples=1)).depth, 5, rtol=1e-5)


@pytest.mark.parametrize("width_px", [0.5, 1.5, 4.0])
@pytest.mark.parametrize("kind", FILTERS)
def test_offsets_are_spread_as_the_filter_says(kind, width_px):
    table, reach = build_filter_table(kind, width_px), filter_reach(kind, width_px)
    u = (np.arange(NUM) + 0.5) / NUM
    offset = np.array([filter_offset(table, np.float32(x)) for x in u])
    # The middles of many slices of the kernel, and how much of it lies below each offset.
    x = (np.arange(100_000) + 0.5) / 50_000 * reach - reach
    below = np.cumsum(eval_filter(kind, width_px, x))
    assert np.all(np.diff(offset) >= 0) and abs(offset).max() <= reach
    # Each of 2 x 1023 steps between entries holds its share, evenly spread.
    np.testing.assert_allclose(np.interp(offset, x, below / below[-1]), u, atol=1 / 2046)


@pytest.mark.parametrize("kind", FILTERS)
def test_filters_are_symmetric(kind):
    table = build_filter_table(kind, 1.5)
    for k in range(0, 2**24, 2**17 + 1):
        left, right = (filter_offset(table, np.float32(i / 2**24)) for i in (k, 2**24 - k))
        assert left == -right


def test_filters_are_as_wide_as_in_cycles():
    assert filter_reach(BOX, 9.0) == 0.5
    assert filter_reach(BLACKMAN_HARRIS, 1.5) == 1.5
    assert filter_reach(GAUSSIAN, 1.5) == 2.25
    assert eval_filter(GAUSSIAN, 1.5, np.array(0.75)) == pytest.approx(np.exp(-2))
    window = eval_filter(BLACKMAN_HARRIS, 1.5, np.array([0.0, 0.75, 1.5]))
    np.testing.assert_allclose(window, [1.0, 0.21747, 6e-5], rtol=1e-5)


def test_a_box_is_the_pixel_and_no_more():
    table = build_camera_table(camera(3, 2, half_width=1.5, orthographic=True))
    for pixel in range(6):
        places = np.array([spawn_ray(table, 3, pixel, s)[0][:2] for s in range(64)]) + (1.5, 1.0)
        assert {tuple(cell) for cell in np.floor(places).astype(int)} == {(pixel % 3, pixel // 3)}
        assert_uniform(np.histogram(places[:, 0] % 1, 4, (0, 1))[0])


def test_a_wider_filter_softens_an_edge():
    scene = floor_scene(camera=camera(16, 2, half_width=8.0, orthographic=True))
    scene.vertices[[1, 2], 0] = 0  # the floor ends between two pixels
    scene.background[:] = 1
    num = fewer(1024, 64)
    profile = {
        kind: render(scene, Settings(samples=num, max_bounces=0, filter=kind)).mean[0, :, 0]
        for kind in FILTERS
    }
    floor, sky = profile[BOX][0], 1.0
    np.testing.assert_allclose(profile[BOX], [floor] * 8 + [sky] * 8, rtol=1e-2)
    for kind in (GAUSSIAN, BLACKMAN_HARRIS):
        x = (np.arange(10_000) + 0.5) / 10_000 * filter_reach(kind, 1.5)
        value = eval_filter(kind, 1.5, x)
        beyond = value[x > 0.5].sum() / value.sum() / 2  # what of the filter leaves its pixel
        share = (profile[kind] - floor) / (sky - floor)
        # 4 deviations of a share counted in so many samples.
        assert share[7] == pytest.approx(beyond, abs=4 * np.sqrt(beyond / num))
        assert share[8] == pytest.approx(1 - beyond, abs=4 * np.sqrt(beyond / num))
        assert share[5] == pytest.approx(0, abs=1e-2)  # 2.5 px away, more than either reaches
