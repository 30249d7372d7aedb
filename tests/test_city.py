"""The renderer on an exported city of 200 lights.

tests/scenes/city-tiny.npz was made by:
    lighttree scene city-small --lights 200 -o city-tiny.blend
    lighttree export city-tiny.blend -o city-tiny.npz
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from core_scenes import JIT_IS_OFF, fewer

from lighttree_core import Scene, Settings, render

SCENE = Path(__file__).parent / "scenes" / "city-tiny.npz"


@pytest.fixture(scope="module")
def city() -> Scene:
    """The city from its street camera, a few pixels large."""
    scene = Scene.load(SCENE)
    width, height = fewer(48, 4), fewer(27, 2)
    scene.camera = dataclasses.replace(
        scene.camera, width_px=width, height_px=height, crop_px=(0, 0, width, height)
    )
    return scene


@pytest.fixture(scope="module")
def films(city):
    """Films of every sampler, of the same number of samples."""
    settings = Settings(samples=fewer(64, 2), seed=7)
    return {
        name: render(city, dataclasses.replace(settings, **change))
        for name, change in {
            "tree": {},
            "single": {"split_lights": 1},
            "balance": {"mis": "balance"},
            "power": {"sampler": "power"},
            "uniform": {"sampler": "uniform"},
        }.items()
    }


@pytest.mark.parametrize("name", ["single", "balance", "power", "uniform"])
def test_all_samplers_converge_to_one_image(films, name):
    tree, other = films["tree"], films[name]
    difference = other.mean.mean((0, 1)) - tree.mean.mean((0, 1))
    variance = (other.variance + tree.variance).sum((0, 1)) / tree.depth.size**2
    assert np.all(np.abs(difference) < 4 * np.sqrt(variance))


@pytest.mark.skipif(JIT_IS_OFF, reason="so few samples do not tell how noisy they are")
def test_the_tree_leaves_far_less_noise(films):
    # Relative, as reports tell it: a few glints of bulbs in wet asphalt hold most of the variance.
    noise = {name: (film.variance / (film.mean**2 + 1e-3)).mean() for name, film in films.items()}
    assert noise["tree"] < noise["single"]
    for other in ("power", "uniform"):
        assert noise["tree"] * 3 < noise[other]


def test_no_sample_is_dropped_and_none_is_negative(films):
    for film in films.values():
        assert film.dropped_samples == 0
        assert film.mean.min() >= 0
