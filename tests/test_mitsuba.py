"""A second opinion on geometry, units and surfaces, from Mitsuba 3."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import mitsuba_scenes
import numpy as np
import pytest
from core_scenes import JIT_IS_OFF, add_triangles, camera, floor_scene, lamps_down, materials

from lighttree_batch.metrics import compare_models
from lighttree_core import Scene, Settings, render
from lighttree_core.scene import COLOR, GLASS, GLOSSY, IOR, POINT, ROUGHNESS, SUN, Closures

pytest.importorskip("mitsuba")
pytestmark = pytest.mark.skipif(JIT_IS_OFF, reason="so few samples would tell nothing")

SIZE_PX, SAMPLES, NUM_SEEDS, MAX_BOUNCES = 48, 256, 4, 5
FLOOR, WALL, LAMP, BALL = range(4)
# Mitsuba shadows microfacets from either side apart, we correlated by height (Heitz 2014).
SMITH = 0.005


def square(center, u, v):
    """Two triangles around a centre; they face u x v."""
    corners = [np.add(center, np.dot(s, (u, v))) for s in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.array([corners[:3], [corners[i] for i in (0, 2, 3)]], float)


def ball(center, radius, rings=12):
    """(n, 3, 3) corners of flat triangles around a ball, facing outwards."""
    theta = np.linspace(0, np.pi, rings + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, 2 * rings + 1)
    points = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi]
    points = np.stack(points, -1) * radius + center
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    # At a pole, one of the two triangles of a cell has no area.
    lower, upper = np.stack([a, b, c], -2)[:-1], np.stack([a, c, d], -2)[1:]
    return np.concatenate([lower.reshape(-1, 3, 3), upper.reshape(-1, 3, 3)])


def room(kind=None, roughness=0.0, color=(1, 1, 1)) -> Scene:
    """A ball with one closure, or matt, by a red wall and a lit square, under a blue sky."""
    scene = floor_scene(size=8.0, camera=camera(SIZE_PX, SIZE_PX, (0, -6, 2), 0.4))
    scene.camera.world_from_camera[:, :3] = [[1, 0, 0], [0, 0.28, -0.96], [0, 0.96, 0.28]]
    scene.background[:] = 0.1, 0.15, 0.3
    scene.materials = materials((0.5, 0), ((0.7, 0.2, 0.1), 0), (0, (9, 8, 7)), (0.8, 0))
    scene.materials.emission[LAMP, 1] = 0
    add_triangles(scene, square((-1.6, 1, 1.5), (0, 2, 0), (0, 0, 1.5)), WALL)
    add_triangles(scene, square((1.2, 0.5, 2.6), (0, 0.6, 0), (0.5, 0, 0.4)), LAMP)
    add_triangles(scene, ball((0, 0.5, 0.9), 0.8), BALL)
    if kind is not None:
        scene.materials.num_closures[BALL], scene.closures = 1, Closures.empty(1)
        scene.closures.kind[:], scene.closures.weight[:] = kind, 1
        scene.closures.multiscatter[:] = False
        scene.closures.values[0, COLOR : COLOR + 3] = color
        scene.closures.values[0, [ROUGHNESS, IOR]] = roughness, 1.5
    return scene


def diffuse() -> Scene:
    scene = room()
    scene.lamps = lamps_down([POINT, SUN], [(1, -1, 2), (0, 0, 0)])
    scene.lamps.radiance[:] = (5, 4, 3), (0.5, 0.6, 0.7)
    return scene


@pytest.mark.parametrize(
    "scene, tolerance",
    [
        (diffuse(), 0.0),
        (room(GLASS), 0.0),
        (room(GLASS, 0.4), SMITH),
        (room(GLOSSY, 0.5, (0.95, 0.7, 0.4)), SMITH),
    ],
    ids=("diffuse", "glass", "rough glass", "rough conductor"),
)
def test_mitsuba_renders_the_same_picture(scene, tolerance, tmp_path):
    ours = [
        render(scene, Settings(samples=SAMPLES, max_bounces=MAX_BOUNCES, seed=s))
        for s in range(NUM_SEEDS)
    ]
    ours = [film.mean for film in ours]
    shots = scene, MAX_BOUNCES, SAMPLES, range(NUM_SEEDS), tmp_path
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        theirs = process.submit(mitsuba_scenes.shoot, *shots).result()
    moments = [(np.mean(x, 0), np.var(x, 0, ddof=1) / NUM_SEEDS) for x in (ours, theirs)]
    check = compare_models(*moments[0], *moments[1])
    error = tolerance + 3 * check.mean_ratio_sigma
    assert abs(check.mean_ratio - 1) < 1e-3 + error, check
    assert check.mean_ratio_sigma < 3e-3
    assert tolerance or check.share_within_3 >= 0.95, check
