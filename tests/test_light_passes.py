"""Light told apart by where it comes from: what is told apart adds up, and changes no bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from core_scenes import add_triangles, camera, fewer, furnace, random_scene

from lighttree_core import Scene, Settings, render

CITY = Path(__file__).parent / "scenes" / "city-tiny.npz"
SETTINGS = Settings(samples=fewer(8, 1), light_passes=True)


def diffuse(film):
    light = film.light_pass("diffuse_direct") + film.light_pass("diffuse_indirect")
    return film.light_pass("diffuse_color") * light


def test_light_of_matt_surfaces_is_emission_and_diffuse_light():
    scene = random_scene(np.random.default_rng(7))
    scene.background[:] = 0
    add_triangles(scene, [[[-2, -9, 0], [-2, 9, 0], [-2, 0, 6]]], 0, "Wall")
    scene.camera = camera(16, 9)
    film = render(scene, SETTINGS)
    assert film.light_pass("diffuse_direct").any() and film.light_pass("diffuse_indirect").any()
    total = film.light_pass("emission") + diffuse(film)
    np.testing.assert_allclose(total, film.mean, rtol=1e-4, atol=1e-6)


def test_what_is_neither_is_reflected_or_background():
    scene = small_city()
    film = render(scene, SETTINGS)
    rest = film.mean - film.light_pass("emission") - diffuse(film)
    assert rest.min() > -1e-5 * film.mean.max() and rest.max() > 0.1


def small_city():
    """A wet street, of few pixels."""
    scene = Scene.load(CITY)
    size = 16, 9
    shape = {"width_px": size[0], "height_px": size[1], "crop_px": (0, 0, *size)}
    return replace(scene, camera=replace(scene.camera, **shape))


def test_light_passes_change_no_bit_of_the_image():
    scene = small_city()
    with_passes, without = (
        render(scene, SETTINGS),
        render(scene, replace(SETTINGS, light_passes=False)),
    )
    np.testing.assert_array_equal(with_passes.radiance_sum, without.radiance_sum)
    np.testing.assert_array_equal(with_passes.albedo, without.albedo)
    assert without.light_sums == {}


def test_direct_light_is_that_of_a_render_without_bounces():
    scene = random_scene(np.random.default_rng(7))
    scene.camera = camera(16, 9)
    film, direct = render(scene, SETTINGS), render(scene, replace(SETTINGS, max_bounces=0))
    assert not direct.light_pass("diffuse_indirect").any()
    for name in ("emission", "diffuse_direct", "diffuse_color"):
        np.testing.assert_allclose(film.light_pass(name), direct.light_pass(name), rtol=1e-5)


def test_a_furnace_has_the_known_share_of_direct_light():
    film = render(furnace(albedo=0.5, emission=1.0), SETTINGS)
    # All light arriving is 1, so what falls on the walls directly is 1; each bounce adds a half.
    np.testing.assert_allclose(film.light_pass("emission"), 1.0, rtol=1e-5)
    np.testing.assert_allclose(film.light_pass("diffuse_color"), 0.5, rtol=1e-5)
    np.testing.assert_allclose(film.light_pass("diffuse_direct").mean(), 1.0, rtol=0.05)
    sums = sum(0.5**k for k in range(1, SETTINGS.max_bounces + 1))
    mean = film.light_pass("diffuse_indirect").mean()
    np.testing.assert_allclose(mean, sums, rtol=fewer(5, 40) / 100)
