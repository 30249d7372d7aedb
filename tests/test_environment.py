"""The world around the scene: lookups by known answers, sampling by its own density."""

import numpy as np
import oracle
import pytest
from core_scenes import add_triangles, fewer, floor_scene, make_clear, materials
from tree_probe import vec3

from lighttree_core import Settings, environment, render
from lighttree_core.environment import (
    build_environment,
    environment_radiance,
    pdf_environment,
    sample_environment,
)
from lighttree_core.jit import FAR, HALF
from lighttree_core.light_points import light_radiance, pdf_light_point, sample_light_point
from lighttree_core.lights import bound_lights, build_lights
from lighttree_core.sampling import uniform_pair
from lighttree_core.scene import (
    ALL_BOUNCES,
    CAMERA_RAY,
    GLOSSY_RAY,
    Environment,
)

UP = vec3((0, 0, 1))
NUM = fewer(16384, 512)


def sky_scene(image, color=(1.0, 1.0, 1.0), turn=None, **kwargs):
    """A floor under an image, (H, W) or (H, W, 3), turned by a rotation of directions."""
    image = np.asarray(image, np.float32)
    image = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    turn = np.eye(3) if turn is None else turn
    scene = floor_scene(background=np.array(color, np.float32))
    scene.environment = Environment(image, np.asarray(turn, np.float32), **kwargs)
    return scene


def random_turn(rng):
    """A rotation."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


def random_directions(rng, num):
    """(num, 3) uniform unit vectors."""
    directions = rng.normal(size=(num, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None]


def pair(i):
    """Two stratified random numbers, as float32 as kernels have them."""
    return tuple(np.float32(x) for x in uniform_pair(7, 0, i, 0))


def samples(table, num=NUM):
    """`num` sampled directions, (num, 3), and their densities."""
    drawn = [sample_environment(table, pair(i)) for i in range(num)]
    return np.array([wi for wi, _ in drawn], float), np.array([pdf for _, pdf in drawn], float)


def sun_image(rng, height=16, width=32):
    """Dim noise with one texel as bright as all of it."""
    image = rng.uniform(0.5, 1.5, (height, width, 3))
    image[height * 11 // 16, width * 20 // 32] = 300.0
    return image


def test_texels_lie_where_cycles_has_them():
    image = np.arange(4 * 8, dtype=float).reshape(4, 8)
    table = build_environment(sky_scene(image, (1, 2, 0.5)))
    for row in range(4):
        for column in range(8):
            theta = np.pi * (1 - (row + 0.5) / 4)
            phi = np.pi * (1 - 2 * (column + 0.5) / 8)
            direction = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
            found = environment_radiance(table, vec3(direction))
            np.testing.assert_allclose(found, image[row, column] * np.array([1, 2, 0.5]), atol=2e-5)


def test_lookups_between_texels_are_bilinear_and_wrap_around():
    image = np.zeros((4, 8))
    image[2, 0], image[2, 7] = 8.0, 16.0
    table = build_environment(sky_scene(image))
    theta = np.pi * (1 - 2.5 / 4)

    def at(across):
        phi = np.pi * (1 - 2 * across)
        direction = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
        return environment_radiance(table, vec3(direction))[0]

    for across, expected in ((0.25 / 8, 10.0), (7.75 / 8, 14.0), (1.25 / 8, 2.0), (6.5 / 8, 0.0)):
        assert at(across) == pytest.approx(expected, abs=2e-5)


def test_a_turned_image_is_looked_up_in_its_own_frame():
    rng = np.random.default_rng(7)
    image, turn = rng.uniform(0, 1, (5, 9, 3)), random_turn(rng)
    still, turned = (build_environment(sky_scene(image, turn=t)) for t in (None, turn))
    for direction in random_directions(rng, 20):
        np.testing.assert_allclose(
            environment_radiance(turned, vec3(direction)),
            environment_radiance(still, vec3(turn @ direction)),
            atol=1e-5,
        )


@pytest.mark.parametrize("turned", [False, True])
def test_samples_give_the_light_of_the_whole_sky_and_tell_their_density(turned):
    rng = np.random.default_rng(7)
    scene = sky_scene(sun_image(rng), (1, 0.5, 2), random_turn(rng) if turned else None)
    table = build_environment(scene)
    directions, pdf = samples(table)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    assert np.all(pdf > 0)
    radiance = np.array([environment_radiance(table, vec3(wi)) for wi in directions])
    values = radiance / pdf[:, None]
    # A fine grid over the sphere; as for the samples, 4 deviations as if they were random.
    num = fewer(256, 64)
    z, phi = np.meshgrid((np.arange(num) + 0.5) / num * 2 - 1, np.arange(2 * num) / num * np.pi)
    around = np.sqrt(1 - z**2)
    grid = np.stack([around * np.cos(phi), around * np.sin(phi), z], axis=-1).reshape(-1, 3)
    expected = 4 * np.pi * np.mean([environment_radiance(table, vec3(d)) for d in grid], axis=0)
    tolerance = 4 * values.std(0) / np.sqrt(NUM) + fewer(0.01, 0.05) * expected
    np.testing.assert_array_less(np.abs(values.mean(0) - expected), tolerance)
    # Importance: far better than the sun's share of the sphere would have it.
    assert np.all(values.std(0) < 1.0 * expected)


def test_the_density_integrates_to_one_and_is_nowhere_zero_where_light_is():
    rng = np.random.default_rng(7)
    image = sun_image(rng) * (rng.random((16, 32, 1)) < 0.1)
    table = build_environment(sky_scene(image))
    directions = random_directions(rng, fewer(20000, 1000))
    pdf = np.array([pdf_environment(table, vec3(d)) for d in directions])
    radiance = np.array([environment_radiance(table, vec3(d))[0] for d in directions])
    assert np.all(pdf[radiance > 1e-3] > 0)
    mean = 4 * np.pi * pdf.mean()
    assert abs(mean - 1) < 4 * 4 * np.pi * pdf.std() / np.sqrt(len(pdf))
    areas = np.diff(table.row_height)[:, None] * (2 * np.pi / table.density.shape[1])
    assert np.sum(table.density * areas) == pytest.approx(1, rel=1e-5)


def test_samples_fall_into_cells_as_often_as_their_density_says():
    table = build_environment(sky_scene(sun_image(np.random.default_rng(7), 4, 6)))
    directions, _ = samples(table)
    row = (1 - np.arccos(np.clip(directions[:, 2], -1, 1)) / np.pi) * 4
    column = (0.5 - np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi)) * 6
    counts = np.zeros((4, 6))
    np.add.at(counts, (row.astype(int).clip(0, 3), column.astype(int).clip(0, 5)), 1)
    expected = table.density * np.diff(table.row_height)[:, None] * (2 * np.pi / 6)
    tolerance = 4 * np.sqrt(expected / NUM) + 2 / NUM
    np.testing.assert_array_less(np.abs(counts / NUM - expected), tolerance)


def test_cells_of_large_images_are_as_bright_as_the_texels_they_cover(monkeypatch):
    monkeypatch.setattr(environment, "MAX_ROWS", 6)
    monkeypatch.setattr(environment, "MAX_COLUMNS", 10)
    rng = np.random.default_rng(7)
    image = 1e-6 * rng.uniform(1, 2, (16, 32))
    image[5, 9] = 1e6
    table = build_environment(sky_scene(image))
    assert table.density.shape == (6, 10)
    assert np.all(table.density > 0)  # the dark is not lost beside the sun
    wi, pdf = sample_environment(table, (HALF, HALF))
    assert pdf == table.density.max()
    assert environment_radiance(table, vec3(wi))[0] > 0
    shrunk = environment._shrink(image, 6)
    assert shrunk.sum() == pytest.approx(image.sum(), rel=1e-12)


def test_an_image_without_light_is_no_light():
    for image, color in ((np.zeros((2, 4)), (1, 1, 1)), (np.ones((2, 4)), (0, 0, 0))):
        lights, _, background = build_lights(sky_scene(image, color))
        assert background == -1 and len(lights.kind) == 0
        assert environment_radiance(lights.environment, UP) == (0, 0, 0)


def test_a_world_without_image_is_the_same_in_all_directions():
    scene = floor_scene(background=np.array([1, 2, 3], np.float32))
    lights, _, background = build_lights(scene)
    assert environment_radiance(lights.environment, UP) == (1, 2, 3)
    assert light_radiance(lights, background, UP, FAR) == (1, 2, 3)


def test_the_light_tree_is_told_the_mean_of_the_sky():
    rng = np.random.default_rng(7)
    scene = sky_scene(sun_image(rng), (1, 0.5, 2), visible=GLOSSY_RAY, max_bounces=3)
    lights, _, background = build_lights(scene)
    table = lights.environment
    directions, pdf = samples(table)
    radiance = np.array([environment_radiance(table, vec3(wi)) for wi in directions])
    values = radiance @ oracle.LUMINANCE / pdf / 4
    tolerance = 4 * values.std() / np.sqrt(NUM) + 0.01 * values.mean()
    assert bound_lights(lights).flux[background] == pytest.approx(values.mean(), abs=tolerance)
    assert lights.visible[background] == GLOSSY_RAY
    assert lights.max_bounces[background] == 3


@pytest.mark.parametrize("has_image", [False, True])
@pytest.mark.parametrize("two_sided", [False, True])
def test_the_background_is_sampled_on_the_sides_that_count(has_image, two_sided):
    rng = np.random.default_rng(7)
    scene = floor_scene(background=np.array([1, 2, 3], np.float32))
    if has_image:
        scene = sky_scene(sun_image(rng))
    lights, _, background = build_lights(scene)
    p, n = vec3((1, 2, 3)), vec3(random_directions(rng, 1)[0])
    irradiance, num = np.zeros((NUM, 2, 3)), NUM
    for i in range(num):
        wi, distance, pdf = sample_light_point(lights, background, p, n, two_sided, pair(i))
        wi, distance = vec3(wi), np.float32(distance)
        assert distance == FAR
        repeated = pdf_light_point(lights, background, p, n, two_sided, wi, distance)
        # A cosine is rounded by up to 3 * 2^-24, in each context in its own way.
        assert repeated == pytest.approx(pdf, rel=1e-6, abs=2**-22)
        cos = np.dot(n, wi)
        if pdf > 0:
            radiance = np.array(light_radiance(lights, background, wi, distance))
            irradiance[i, int(cos < 0)] = abs(cos) * radiance / pdf
    mean, error = irradiance.mean(0), 4 * irradiance.std(0) / np.sqrt(num)
    if has_image:
        assert np.all(mean > 0)  # an image is sampled by its own brightness, on all sides
    else:
        expected = (
            np.pi * np.array([[1, 2, 3], [1, 2, 3]]) * ([[1], [1]] if two_sided else [[1], [0]])
        )
        np.testing.assert_array_less(np.abs(mean - expected), error + 1e-5)


def test_environment_flags_default_to_all():
    lights, _, background = build_lights(sky_scene(np.ones((2, 4))))
    assert lights.visible[background] & CAMERA_RAY and lights.casts_shadow[background]
    assert lights.max_bounces[background] == ALL_BOUNCES


def test_the_camera_may_see_a_colour_of_its_own_even_through_panes():
    def shot(camera_color):
        scene = floor_scene(background=np.array([1, 2, 3], np.float32), size=4.0)
        scene.materials = materials((0.5, 0), (0, 0))
        make_clear(scene, 1)
        # One pane beside the floor and one over it.
        pane = np.array([(0, 0, 0), (2, 0, 0), (0, 2, 0)])
        add_triangles(scene, [pane + (2.5, 0, 1), pane + (-1, -1, 1)], 1)
        scene.environment.camera_color = np.array(camera_color, np.float32).reshape(-1, 3)
        return render(scene, Settings(samples=4))

    own, same = shot([(4, 0, 1)]).mean, shot([]).mean
    is_sky = (same == (1, 2, 3)).all(axis=-1)
    assert 20 < is_sky.sum() < 110
    np.testing.assert_array_equal(own[is_sky], np.broadcast_to((4, 0, 1), own[is_sky].shape))
    middle = slice(3, 6), slice(6, 10)
    assert not is_sky[middle].any()
    np.testing.assert_array_equal(own[middle], same[middle])
