"""Light told apart by where it comes from: what is told apart adds up, and changes no bit."""

from dataclasses import replace

import numpy as np
from core_scenes import add_triangles, camera, fewer, random_scene

from lighttree_core import Settings, render

SETTINGS = Settings(samples=fewer(8, 1), light_passes=True)


def walled_floor():
    """Lamps and emitting triangles over a floor that a wall stands on."""
    scene = random_scene(np.random.default_rng(7))
    add_triangles(scene, [[[-2, -9, 0], [-2, 9, 0], [-2, 0, 6]]], 0, "Wall")
    scene.camera = camera(16, 9)
    return scene


def diffuse(film):
    light = film.light_pass("diffuse_direct") + film.light_pass("diffuse_indirect")
    return film.light_pass("diffuse_color") * light


def test_light_of_matt_surfaces_is_emission_and_diffuse_light():
    scene = walled_floor()
    scene.background[:] = 0
    film = render(scene, SETTINGS)
    assert film.light_pass("diffuse_direct").any() and film.light_pass("diffuse_indirect").any()
    total = film.light_pass("emission") + diffuse(film)
    np.testing.assert_allclose(total, film.mean, rtol=1e-4, atol=1e-6)


def test_light_passes_change_no_bit_of_the_image():
    scene = walled_floor()
    with_passes, without = (
        render(scene, SETTINGS),
        render(scene, replace(SETTINGS, light_passes=False)),
    )
    np.testing.assert_array_equal(with_passes.radiance_sum, without.radiance_sum)
    np.testing.assert_array_equal(with_passes.albedo, without.albedo)
    assert without.light_sums == {}


def test_direct_light_is_that_of_a_render_without_bounces():
    scene = walled_floor()
    film, direct = render(scene, SETTINGS), render(scene, replace(SETTINGS, max_bounces=0))
    assert not direct.light_pass("diffuse_indirect").any()
    for name in ("emission", "diffuse_direct", "diffuse_color"):
        np.testing.assert_allclose(film.light_pass(name), direct.light_pass(name), rtol=1e-5)
