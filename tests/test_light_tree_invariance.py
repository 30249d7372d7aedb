"""What does not change how often lights are picked: place, direction, unit of length, brightness,
order of the lights, number of threads; and how far that is so."""

import itertools

import numpy as np
import pytest
from core_scenes import (
    add_triangles,
    camera,
    fewer,
    floor_scene,
    materials,
    random_lamps,
    random_scene,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from tree_probe import NUM_PICKS, all_expected, build, random_points, tree_options, vec3

from lighttree_core import Settings, render
from lighttree_core.light_tree.options import CLAMPED, EQUAL, MEAN_AXIS, MOMENTS, TreeOptions
from lighttree_core.light_tree.sample import SAMPLERS
from lighttree_core.scene import DISK, LAMP_KINDS, POINT, SPHERE, SUN

SEEDS = st.integers(0, 2**32)
QUARTER_TURNS = {
    "about x": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "about y": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "about z": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "all axes on": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
}


def examples(num, without_jit):
    return settings(max_examples=fewer(num, without_jit), deadline=None, derandomize=True)


def rotate(scene, rotation):
    """Turn all lights of a scene, and its surfaces, about the origin."""
    lamps, matrix = scene.lamps, np.asarray(rotation, np.float64)
    for name in ("position", "axis_u", "axis_v", "axis_w"):
        column = getattr(lamps, name)
        column[:] = column.astype(np.float64) @ matrix.T
    scene.vertices = (scene.vertices.astype(np.float64) @ matrix.T).astype(np.float32)


def scale(scene, factor):
    """Scale lengths, and the light of what has no size so that it looks as bright as before."""
    lamps, factor = scene.lamps, np.float32(factor)
    lamps.position *= factor
    is_round, is_point = np.isin(lamps.kind, (SPHERE, DISK)), lamps.kind == POINT
    lamps.radius[is_round] *= factor
    lamps.radiance[is_point] *= factor * factor
    is_flat = ~is_round & ~is_point & (lamps.kind != SUN)
    lamps.axis_u[is_flat] *= factor
    lamps.axis_v[is_flat] *= factor
    scene.vertices = scene.vertices * factor


def on_a_grid(scene, step):
    """Move lamps and corners to multiples of a length, so that adding whole numbers is exact."""
    scene.lamps.position[:] = np.round(scene.lamps.position / step) * step
    scene.vertices = (np.round(scene.vertices / step) * step).astype(np.float32)


@examples(30, 3)
@given(seed=SEEDS, options=tree_options())
def test_moving_a_scene_far_away_changes_nothing_but_roundings(seed, options):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 30, 5)
    on_a_grid(scene, 1 / 128)
    points = [(np.round(np.array(p) * 128) / 128, n) for p, n in random_points(rng, 3)]
    before = build(scene, options=options)
    shift = np.array((512, -1024, 256), np.float32)
    scene.lamps.position += shift
    scene.vertices = scene.vertices + shift
    after = build(scene, options=options)
    for p, n in points:
        for num in NUM_PICKS:
            # Means and boxes are rounded to 2^-24 of 1024 m: 6e-5 m. Lamps are 0.1 m away or more
            # in nearly all cases, so squared distances change by 1e-3 or less.
            np.testing.assert_allclose(
                all_expected(after, vec3(p + shift), n, num),
                all_expected(before, vec3(p), n, num),
                rtol=1e-2,
                atol=1e-4,
            )


@pytest.mark.parametrize("rotation", QUARTER_TURNS.values(), ids=QUARTER_TURNS)
@examples(20, 3)
@given(seed=SEEDS, options=tree_options(bucket_kind="width", cone_axis=MEAN_AXIS))
def test_quarter_turns_change_nothing_but_roundings(rotation, seed, options):
    # Boxes lie along the axes, so these turns alone map boxes to boxes. A turn may exchange the
    # ends of an axis, which matters to buckets of equal count, filled from the lower end, and to
    # the union of cones, which depends on the order: these are left out.
    if options.split == EQUAL or options.buckets == 0:
        options = TreeOptions(width=options.width, importance=options.importance)
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 30, 5)
    before = build(scene, options=options)
    rotate(scene, rotation)
    after = build(scene, options=options)
    for p, n in random_points(rng, 3):
        for num in NUM_PICKS:
            np.testing.assert_allclose(
                all_expected(
                    after, vec3(rotation @ np.array(p)), vec3(rotation @ np.array(n)), num
                ),
                all_expected(before, p, n, num),
                rtol=2e-3,
                atol=1e-5,
            )


@examples(20, 4)
@given(seed=SEEDS)
def test_any_rotation_leaves_lights_without_extent_in_one_node_alike(seed):
    # Boxes of larger sets and lights, along the axes, do change: with them the share of a set.
    rng = np.random.default_rng(seed)
    scene = floor_scene(random_lamps(rng, 14, kinds=(POINT, SUN)))
    before = build(scene)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    rotate(scene, rotation)
    after = build(scene)
    for p, n in random_points(rng, 3):
        p_after, n_after = vec3(rotation @ np.array(p)), vec3(rotation @ np.array(n))
        for num in NUM_PICKS:
            np.testing.assert_allclose(
                all_expected(after, p_after, n_after, num),
                all_expected(before, p, n, num),
                rtol=5e-3,
                atol=1e-4,
            )


@examples(30, 4)
@given(
    seed=SEEDS,
    options=tree_options(),
    log_length=st.integers(-12, 12),
    log_light=st.integers(-30, 30),
)
def test_powers_of_two_of_length_and_brightness_change_no_bit(seed, options, log_length, log_light):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, 30, 5)
    points = list(random_points(rng, fewer(3, 1)))
    # No rounding changes, so any constant that has a unit without saying so shows.
    before = [build(scene, strategy, options) for strategy in SAMPLERS]
    factor = np.float32(2.0**log_length)
    scale(scene, factor)
    scene.lamps.radiance *= np.float32(2.0**log_light)
    scene.materials.emission *= np.float32(2.0**log_light)
    scene.background *= np.float32(2.0**log_light)
    after = [build(scene, strategy, options) for strategy in SAMPLERS]
    for p, n in points:
        for num, (one, other) in itertools.product(NUM_PICKS, zip(before, after, strict=True)):
            np.testing.assert_array_equal(
                all_expected(other, vec3(np.array(p) * factor), n, num),
                all_expected(one, p, n, num),
            )


@pytest.mark.parametrize("factor", [1e-4, 0.03, 1e4])
def test_other_factors_of_length_change_nothing_but_roundings(factor):
    rng = np.random.default_rng(7)
    scene = random_scene(rng, 30, 5)
    points = list(random_points(rng, fewer(20, 2)))
    before = build(scene)
    scale(scene, factor)
    after = build(scene)
    for p, n in points:
        for num in NUM_PICKS:
            np.testing.assert_allclose(
                all_expected(after, vec3(np.array(p) * factor), n, num),
                all_expected(before, p, n, num),
                rtol=2e-3,
                atol=1e-5,
            )


@examples(20, 3)
@given(seed=SEEDS, options=tree_options(cone_axis=MEAN_AXIS, importance=MOMENTS))
def test_the_order_of_lights_changes_nothing_but_roundings(seed, options):
    # A union of cones depends on the order in which they are united, so it is left out.
    rng = np.random.default_rng(seed)
    scene = floor_scene(random_lamps(rng, 40, kinds=tuple(set(LAMP_KINDS) - {SUN})))
    points = list(random_points(rng, 3))
    before = build(scene, options=options)
    order = rng.permutation(40)
    lamps = scene.lamps
    for name in ("kind", "position", "axis_u", "axis_v", "axis_w", "radiance"):
        setattr(lamps, name, getattr(lamps, name)[order])
    for name in ("radius", "cos_cone", "blend", "spread"):
        setattr(lamps, name, getattr(lamps, name)[order])
    after = build(scene, options=options)
    for p, n in points:
        for num in NUM_PICKS:
            np.testing.assert_allclose(
                all_expected(after, p, n, num),
                all_expected(before, p, n, num)[order],
                rtol=1e-4,
                atol=1e-6,
            )


def test_the_order_of_the_corners_of_a_two_sided_triangle_changes_nothing():
    scene = floor_scene()
    scene.materials = materials((0.5, 0.0), (0.0, 1.0))
    corners = np.array([(-1, -1, 2), (1, -1, 2.5), (0, 1, 3)], float)
    add_triangles(scene, [corners, corners + (3, 0, 0)], 1)
    expected = all_expected(build(scene), vec3((0, 0, 0)), vec3((0, 0, 1)))
    other = floor_scene()
    other.materials = scene.materials
    add_triangles(other, [corners[[2, 0, 1]], corners[::-1] + (3, 0, 0)], 1)
    # Turned over, its front becomes its back: rows are all fronts first, then all backs.
    turned = all_expected(build(other), vec3((0, 0, 0)), vec3((0, 0, 1)))[[0, 3, 2, 1]]
    np.testing.assert_allclose(turned, expected, rtol=1e-5)


@pytest.mark.parametrize("importance", [MOMENTS, CLAMPED])
def test_a_seed_gives_one_image_for_any_number_of_threads(importance):
    scene = random_scene(np.random.default_rng(7), 40)
    scene.camera = camera(fewer(32, 6), fewer(24, 4))
    chosen = Settings(samples=fewer(8, 1), seed=3, tree=TreeOptions(importance=importance))
    images = [
        render(scene, Settings(**{**vars(chosen), "threads": threads})).mean for threads in (1, 2)
    ]
    np.testing.assert_array_equal(images[1], images[0])
