"""Random numbers are stratified, and every warp has the density that its twin tells."""

import numpy as np
import pytest
from core_scenes import fewer

from lighttree_core import sampling, spherical

NUM = fewer(4096, 256)


def test_every_aligned_run_of_numbers_is_stratified():
    for first, size in ((0, 64), (64, 64), (48, 16), (8, 4)):
        values = [sampling.uniform(1, 5, first + i, 3) for i in range(size)]
        assert sorted(int(size * u) for u in values) == list(range(size))


def test_pairs_are_a_net_in_base_2():
    points = np.array([sampling.uniform_pair(1, 5, i, 3) for i in range(64)])
    for columns in (1, 2, 4, 8, 16, 32, 64):
        cells = {(int(columns * x), int(64 / columns * y)) for x, y in points}
        assert len(cells) == 64


def test_pixels_seeds_and_dimensions_are_unrelated():
    base = np.array([sampling.uniform(1, 5, i, 3) for i in range(NUM)])
    for other in ((1, 6, 3), (2, 5, 3), (1, 5, 4)):
        values = np.array([sampling.uniform(other[0], other[1], i, other[2]) for i in range(NUM)])
        # The correlation of independent numbers has a deviation of 1 / sqrt(NUM).
        assert abs(np.corrcoef(base, values)[0, 1]) < 5 / np.sqrt(NUM)


def _pairs():
    return [sampling.uniform_pair(3, 0, i, 0) for i in range(NUM)]


def test_cosine_hemisphere_has_its_density():
    z = np.array([sampling.sample_cosine_hemisphere(u)[2] for u in _pairs()])
    pdf = [sampling.pdf_cosine_hemisphere(np.float32(c)) for c in z]
    assert np.all(z >= 0)
    # E[cos] = 2/3 with a deviation of 1/sqrt(18 NUM) at most; the points are better than random.
    assert abs(z.mean() - 2 / 3) < 3 / np.sqrt(18 * NUM)
    np.testing.assert_allclose(pdf, z / np.pi, rtol=1e-6)


@pytest.mark.parametrize("one_minus_cos", [1e-9, 0.01, 1.0, 2.0])
def test_cone_has_its_density(one_minus_cos):
    heights = np.array([sampling.sample_cone(u, np.float32(one_minus_cos))[1] for u in _pairs()])
    assert np.all((heights >= 0) & (heights <= one_minus_cos))
    assert abs(heights.mean() / one_minus_cos - 0.5) < 3 / np.sqrt(12 * NUM)
    solid_angle = 1 / sampling.pdf_cone(np.float32(one_minus_cos))
    assert solid_angle == pytest.approx(2 * np.pi * one_minus_cos, rel=1e-6)


def test_points_of_a_triangle_are_uniform():
    b = np.array([sampling.sample_triangle(u) for u in _pairs()])
    assert np.all(b >= 0) and np.all(b.sum(1) <= 1)
    # Each barycentric coordinate has the mean 1/3 and the variance 1/18.
    np.testing.assert_allclose(b.mean(0), 1 / 3, atol=3 / np.sqrt(18 * NUM))


def _grid(num=200):
    g = (np.arange(num) + 0.5) / num
    return np.stack(np.meshgrid(g, g, indexing="ij"), -1).reshape(-1, 2)


@pytest.mark.parametrize("seed", range(4))
def test_solid_angles_and_their_samples_match_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    corner, u = rng.normal(size=(2, 3))
    v = np.cross(u, rng.normal(size=3))
    s, t = _grid().T
    points = corner + s[:, None] * u + t[:, None] * v
    normal = np.cross(u, v)
    area = np.linalg.norm(normal)
    dist = np.linalg.norm(points, axis=1)
    weight = np.abs(points @ normal) / dist**3 / len(points)  # solid angle of a cell
    wi = points / dist[:, None]
    corner, u, v = tuple(corner), tuple(u), tuple(v)
    far_u, far_v = tuple(np.add(corner, u)), tuple(np.add(corner, v))

    rectangle = spherical.solid_angle_rectangle(corner, u, v)
    triangle = spherical.solid_angle_triangle(corner, far_u, far_v)
    in_triangle = s + t < 1
    for omega, cells, sample in (
        (
            rectangle,
            slice(None),
            lambda x: spherical.sample_spherical_rectangle(corner, u, v, x[0], x[1])[0],
        ),
        (
            triangle,
            in_triangle,
            lambda x: spherical.sample_spherical_triangle(
                corner, far_u, far_v, triangle, x[0], x[1]
            ),
        ),
    ):
        total = weight[cells].sum()
        assert omega == pytest.approx(total, rel=0.02)  # cells cut by the triangle's edge
        samples = np.array([sample(x) for x in _pairs()])
        expected = (wi[cells] * weight[cells, None]).sum(0) / total
        spread = np.sqrt((wi[cells] ** 2 * weight[cells, None]).sum(0) / total - expected**2)
        assert np.all(np.abs(samples.mean(0) - expected) < 3 * spread / np.sqrt(NUM) + 0.01)
    assert area > 0
