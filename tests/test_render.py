"""Images against known answers, and what a user may rely on: seeds, threads, limits, cancelling."""

import dataclasses
import threading
import time

import numpy as np
import oracle
import pytest
from core_scenes import add_triangles, camera, fewer, floor_scene, furnace, random_scene

from lighttree_core import Settings, render
from lighttree_core.light_tree.sample import SAMPLERS
from lighttree_core.scene import POINT, Lamps, SceneError

NUM = fewer(256, 4)


def one_lamp(intensity=10.0, height=2.0) -> Lamps:
    lamps = Lamps.empty(1)
    lamps.kind[0], lamps.position[0], lamps.radiance[0] = POINT, (0, 0, height), intensity
    lamps.names = ["Lamp"]
    return lamps


def test_one_lamp_over_a_floor_matches_the_formula():
    scene = floor_scene(one_lamp(), albedo=0.5)
    film = render(scene, Settings(samples=NUM, max_bounces=0))
    # The formula, averaged over 16 x 16 points of each pixel.
    points = (np.arange(16 * 16) + 0.5) * 10 / 256 - 5
    x, y = points, points[16 * 3 + 8 : -16 * 3 - 8]
    dist_sq = x[None] ** 2 + y[:, None] ** 2 + 4
    expected = (10 * 2 / dist_sq**1.5 * 0.5 / np.pi).reshape(9, 16, 16, 16).mean((1, 3))
    np.testing.assert_allclose(film.mean[..., 0], expected, rtol=fewer(2e-3, 1e-1))
    np.testing.assert_allclose(film.depth, 5, rtol=1e-6)
    np.testing.assert_allclose(film.normal[..., 2], 1, rtol=1e-6)
    np.testing.assert_allclose(film.albedo, 0.5, rtol=1e-6)


@pytest.mark.parametrize("mis", ["power", "balance"])
@pytest.mark.parametrize("max_bounces", [0, 1, 3])
def test_furnace_has_the_radiance_of_its_series(max_bounces, mis):
    film = render(
        furnace(albedo=0.5, emission=1.0),
        Settings(samples=NUM, max_bounces=max_bounces, mis=mis, roulette_depth=1),
    )
    expected = sum(0.5**k for k in range(max_bounces + 2))
    mean, variance = film.mean.mean(), film.variance.mean() / film.depth.size
    assert abs(mean - expected) < 4 * np.sqrt(variance) + 1e-5


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("split_lights", [1, 4])
def test_every_sampler_gives_the_oracle_irradiance(sampler, split_lights):
    scene = random_scene(np.random.default_rng(7), 12, 6)
    scene.lamps.position[:, 2] += 1
    scene.camera = camera(1, 1, position=(0.5, 0.5, 0.4), half_width=1e-3)
    settings = Settings(
        samples=fewer(16384, 64), max_bounces=0, sampler=sampler, split_lights=split_lights
    )
    film = render(scene, settings)
    irradiance = oracle.irradiance(scene, np.array([0.5, 0.5, 0]), np.array([0, 0, 1.0]), 128)
    expected = irradiance * 0.5 / np.pi
    # 4 deviations, and one percent for what the triangles hide of each other and of the sky.
    tolerance = 4 * np.sqrt(film.variance[0, 0]) + fewer(1e-2, 1e-1) * expected
    assert np.all(np.abs(film.mean[0, 0] - expected) < tolerance)


def test_what_is_hidden_is_dark():
    scene = floor_scene(one_lamp())
    add_triangles(scene, [[[-9, -9, 1], [9, -9, 1], [0, 9, 1]]], 0)
    scene.camera = camera(4, 4, position=(0, 0, 0.5), half_width=0.1)
    assert render(scene, Settings(samples=4, max_bounces=0)).mean.max() == 0


def test_scaling_the_scene_scales_nothing_seen():
    scene = random_scene(np.random.default_rng(7), 0, 6)
    settings = Settings(samples=4, max_bounces=1)
    expected = render(scene, settings).mean
    for factor in (np.float32(2.0**-13), np.float32(2.0**13)):
        scaled = dataclasses.replace(scene, vertices=scene.vertices * factor)
        scaled.camera = camera(position=(0, 0, 5 * factor))
        # A power of two changes no rounding, so all paths are the same.
        np.testing.assert_allclose(render(scaled, settings).mean, expected, rtol=1e-4, atol=1e-6)


def test_threads_and_passes_do_not_change_a_bit():
    scene = random_scene(np.random.default_rng(7))
    scene.camera = camera(40, 30)
    films = [render(scene, Settings(samples=fewer(20, 2), threads=t)) for t in (1, 2, 3)]
    for film in films[1:]:
        np.testing.assert_array_equal(film.radiance_sum, films[0].radiance_sum)
        np.testing.assert_array_equal(film.depth, films[0].depth)


def test_a_border_shows_the_same_pixels_as_the_whole():
    scene = random_scene(np.random.default_rng(7))
    scene.camera = camera(16, 12)
    whole = render(scene, Settings(samples=2)).mean
    scene.camera = camera(16, 12, crop_px=(3, 2, 9, 11))
    np.testing.assert_array_equal(render(scene, Settings(samples=2)).mean, whole[2:11, 3:9])


def test_seeds_differ_and_repeat():
    scene = random_scene(np.random.default_rng(7))
    first, again, other = (render(scene, Settings(samples=2, seed=s)).mean for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_variance_foretells_the_spread_of_seeds():
    scene = random_scene(np.random.default_rng(7))
    films = [render(scene, Settings(samples=fewer(16, 2), seed=s)) for s in range(fewer(16, 4))]
    spread = np.var([film.mean for film in films], axis=0, ddof=1).mean()
    told = np.mean([film.variance for film in films])
    assert spread < told * fewer(1.1, 3)  # an upper bound: samples of a pixel are stratified
    assert told < 20 * spread


def test_a_scene_without_lights_is_black_and_an_empty_one_too():
    assert render(floor_scene(), Settings(samples=1)).mean.max() == 0
    scene = floor_scene()
    scene.vertices = np.zeros((0, 3), np.float32)
    scene.triangles = np.zeros((0, 3), np.int32)
    scene.triangle_material = np.zeros(0, np.int32)
    scene.background[:] = (0.25, 0.5, 1)
    film = render(scene, Settings(samples=1))
    np.testing.assert_array_equal(film.mean[0, 0], (0.25, 0.5, 1))


def test_negative_light_takes_light_away():
    lamps = one_lamp()
    pair = Lamps.empty(2)
    for name in ("kind", "position", "radiance"):
        getattr(pair, name)[:] = getattr(lamps, name)
    pair.radiance[1] *= -0.5
    pair.names = ["Lamp", "Thief"]
    settings = Settings(samples=NUM, max_bounces=0)
    film, half = render(floor_scene(pair), settings), render(floor_scene(lamps), settings)
    error = np.abs(film.mean.mean() - half.mean.mean() / 2)
    assert error < 4 * np.sqrt(film.variance.mean() / film.depth.size) + 1e-6


def test_a_time_limit_is_kept():
    scene = random_scene(np.random.default_rng(7))
    scene.camera = camera(64, 48)
    films = []
    for _ in range(3):  # a busy machine may hold up one or two
        films.append(render(scene, Settings(samples=10**6, time_limit_s=1.0)))
        if films[-1].seconds_render < fewer(1.1, 60):
            break
    assert films[-1].seconds_render < fewer(1.1, 60)
    assert all(film.num_samples >= 1 for film in films)


def test_cancel_is_heard_within_a_fifth_of_a_second():
    scene = random_scene(np.random.default_rng(7))
    scene.camera = camera(fewer(256, 8), fewer(256, 8))
    stop = threading.Event()
    asked = []

    def cancel():
        asked.append(time.perf_counter())
        return stop.is_set()

    threading.Timer(0.5, stop.set).start()
    film = render(scene, Settings(samples=10**5), cancel=cancel)
    assert film.cancelled
    assert max(np.diff(asked)) < fewer(0.2, 10)


def test_progress_runs_from_nothing_to_all():
    told = []
    render(
        floor_scene(one_lamp()),
        Settings(samples=8),
        progress=lambda share, message: told.append((share, message)),
    )
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 1
    assert all(message for _, message in told)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"samples": 0}, "samples"),
        ({"sampler": "magic"}, "magic"),
        ({"mis": "none"}, "mis"),
        ({"threads": -1}, "threads"),
    ],
)
def test_settings_that_make_no_sense_are_named(change, word):
    with pytest.raises(ValueError, match=word):
        render(floor_scene(), Settings(**change))


def test_a_lamp_that_is_not_finite_is_named():
    lamps = one_lamp()
    lamps.radiance[0, 1] = np.nan
    with pytest.raises(SceneError, match="'Lamp'"):
        render(floor_scene(lamps))
