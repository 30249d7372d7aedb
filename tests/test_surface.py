"""Hits: their side, safe starting points and shading normals."""

import numpy as np
import pytest
from core_scenes import fewer, floor_scene

from lighttree_core import Settings
from lighttree_core.scene import BACK, FRONT, Scene, Textures
from lighttree_core.surface import hit_side, load_surface
from lighttree_core.world import World, build_world

NUM = fewer(200, 20)
TILTED = (0.8, 0.4, 0.7)  # of a normal map: 0.6 along u, -0.2 along v, 0.4 along the normal
DOWN = (0.0, 0.0, -1.0)
UP = (0.0, 0.0, 1.0)


def world_of(corners, normals=None, uvs=None, color=TILTED) -> World:
    """`scene_of` for kernels."""
    return build_world(scene_of(corners, normals, uvs, color), Settings())


def scene_of(corners, normals=None, uvs=None, color=TILTED) -> Scene:
    """Triangles with (n, 3, 3) corners and perhaps normals there; a normal map of one colour."""
    scene = floor_scene()
    corners = np.asarray(corners, np.float32)
    scene.vertices = corners.reshape(-1, 3)
    scene.triangles = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    scene.textures = Textures.empty(1, 1)
    scene.textures.size[0], scene.textures.is_float[0] = 1, True
    scene.textures.float_texels = np.array([[*color, 1]], np.float32)
    if normals is not None:
        scene.corner_normals = np.asarray(normals, np.float32)
    if uvs is not None:
        scene.uvs = np.asarray(uvs, np.float32).reshape(1, -1, 3, 2)
    scene.triangle_material = np.zeros(len(corners), np.int32)
    return scene


def floats(a):
    """Numbers as kernels take them."""
    return tuple(np.float32(x) for x in a)


def surface(world, triangle, barycentric, direction):
    """(p_front, p_back, n_geo, n_shade, side), vectors as float64."""
    *vectors, side = load_surface(world.geometry, triangle, *floats(barycentric), floats(direction))
    return *(np.array(a, np.float64) for a in vectors), side


def unit(a):
    a = np.asarray(a, np.float64)
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def weights(barycentric):
    return np.array([1 - sum(barycentric), *barycentric])


def random_barycentric(rng):
    a, b = np.sort(rng.uniform(0, 1, 2))
    return a, b - a


def sphere(num=24):
    """(n, 3, 3) corners of a unit sphere made of triangles, counter-clockwise from outside."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, num + 1), np.linspace(0, 2 * np.pi, 2 * num + 1))
    p = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    corners = np.concatenate(
        [np.stack(q, axis=2).reshape(-1, 3, 3) for q in ((a, b, c), (a, c, d))]
    )
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    return corners[area > 1e-9]


SQUARE = [[(0, 0, 0), (1, 0, 0), (1, 1, 0)]]
SQUARE_UVS = [[(0, 0), (1, 0), (1, 1)]]


@pytest.mark.parametrize("far", [0.0, 1e3, 1e6])
def test_rays_start_on_the_side_they_are_meant_for(far):
    rng = np.random.default_rng(7)
    for _ in range(NUM):
        offset = rng.uniform(-far, far, 3)
        # Smaller triangles than this have no plane where float32 is so coarse.
        size = 10 ** rng.uniform(-4, 2) + 1e-4 * far
        world = world_of([offset + size * rng.normal(size=(3, 3))])
        v0, v1, v2 = world.geometry.vertices.astype(np.float64)
        plane = unit(np.cross(v1 - v0, v2 - v0))
        direction = unit(rng.normal(size=3))
        p_front, p_back, n_geo, n_shade, side = surface(
            world, 0, random_barycentric(rng), direction
        )
        expected = FRONT if direction @ plane < 0 else BACK
        if abs(direction @ plane) > 1e-2:
            assert side == hit_side(world.geometry, 0, floats(direction)) == expected
        np.testing.assert_allclose(n_geo, plane if side == FRONT else -plane, atol=2e-3)
        np.testing.assert_array_equal(n_shade, n_geo)
        assert (p_front - v0) @ n_geo > 0 > (p_back - v0) @ n_geo
        # No farther than rounding asks for.
        reach = np.abs(world.geometry.vertices).max()
        assert np.linalg.norm(p_front - p_back) < 4e-6 * reach


def test_normals_of_a_sphere_are_those_of_the_sphere():
    rng = np.random.default_rng(7)
    corners = sphere()
    world = world_of(corners, corners)
    for triangle in rng.integers(len(corners), size=NUM):
        b = random_barycentric(rng)
        p = weights(b) @ corners[triangle]
        for outwards, direction in ((1, -p), (-1, p)):
            _, _, n_geo, n_shade, side = surface(world, int(triangle), b, unit(direction))
            assert side == (FRONT if outwards == 1 else BACK)
            # Corners lie on the sphere, so interpolated normals point where p lies.
            np.testing.assert_allclose(n_shade, outwards * unit(p), atol=1e-6)
            assert n_geo @ n_shade > 0.99


def test_shading_normals_follow_the_geometric_side():
    # The normals lean so far that a steep ray from the front sees them from behind.
    leaning = unit([(1, 0, 0.1)] * 3)
    world = world_of(SQUARE, [leaning])
    direction = unit((1, 0, -0.05))
    _, _, n_geo, n_shade, side = surface(world, 0, (0.2, 0.2), direction)
    assert side == FRONT and n_geo[2] == 1
    np.testing.assert_allclose(n_shade, leaning[0], rtol=1e-6)
    _, _, _, n_shade, side = surface(world, 0, (0.2, 0.2), -direction)
    assert side == BACK
    np.testing.assert_allclose(n_shade, -leaning[0], rtol=1e-6)


def test_normals_that_cancel_are_replaced():
    world = world_of(SQUARE, [[(1, 0, 0), (-1, 0, 0), (0, 0, 0)]])
    for direction in (DOWN, UP):
        _, _, n_geo, n_shade, _ = surface(world, 0, (0.5, 0.0), direction)
        np.testing.assert_array_equal(n_shade, n_geo)
