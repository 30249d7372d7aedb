"""The film: sums of samples, whole or not, and what is told of them."""

import numpy as np
import pytest

from lighttree_core.film import Film, add_samples, add_values


def column(*values):
    return np.array(values, np.float32)[:, None]


def test_alpha_is_what_the_film_does_not_let_through():
    film = Film.empty((1, 3))
    film.num_samples = 2
    seen = column(0, 1, 0.25, 0, 1, 0.5)  # sample after sample
    add_values(seen, 3, 2, film.transparency_sum.reshape(-1, 1))
    np.testing.assert_array_equal(film.alpha, [[1, 0, 0.625]])
    assert film.alpha.dtype == np.float32


def test_alpha_is_one_without_a_transparent_film():
    film = Film.empty((2, 2))
    np.testing.assert_array_equal(film.alpha, 1)
    film.num_samples = 8
    np.testing.assert_array_equal(film.alpha, 1)


def test_alpha_stays_between_0_and_1():
    film = Film.empty((1, 2))
    film.num_samples = 1
    add_values(column(1.5, -0.5), 2, 1, film.transparency_sum.reshape(-1, 1))
    np.testing.assert_array_equal(film.alpha, [[0, 1]])


def test_what_is_not_finite_is_black_and_opaque():
    film = Film.empty((1, 2))
    film.num_samples = 1
    radiance = np.array([[np.nan, 0, 0], [1, 2, 3]], np.float32)
    num_dropped = add_samples(
        radiance, 2, 1, film.radiance_sum.reshape(-1, 3), film.radiance_sum_sq.reshape(-1, 3)
    )
    add_values(column(np.inf, 0.5), 2, 1, film.transparency_sum.reshape(-1, 1))
    assert num_dropped == 1
    np.testing.assert_array_equal(film.mean[0], [(0, 0, 0), (1, 2, 3)])
    np.testing.assert_array_equal(film.alpha, [[1, 0.5]])


def test_sums_do_not_depend_on_how_samples_are_cut_into_passes():
    seen = np.random.default_rng(7).random((5 * 4, 3)).astype(np.float32)
    at_once, in_parts = np.zeros((4, 3)), np.zeros((4, 3))
    add_values(seen, 4, 5, at_once)
    add_values(seen[:8], 4, 2, in_parts)
    add_values(seen[8:], 4, 3, in_parts)
    np.testing.assert_array_equal(at_once, in_parts)
    assert at_once.sum() == pytest.approx(seen.sum())
