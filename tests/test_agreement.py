"""A whole city, rendered to low noise by both engines: the same picture."""

import blender_scenes as blend
import bpy
import numpy as np
import pytest

import lighttree_addon
from lighttree_batch.methods import METHODS, configure
from lighttree_batch.metrics import compare_models
from lighttree_batch.scenes import build_scene

pytestmark = [pytest.mark.blender, pytest.mark.slow]

NUM_SEEDS = 6
SECONDS = 20


@pytest.fixture(autouse=True)
def registered():
    lighttree_addon.register()
    yield
    lighttree_addon.unregister()


def converge(method, tmp_path):
    """(mean, its variance) of renders with seeds of their own."""
    images = []
    for seed in range(NUM_SEEDS):
        configure(
            bpy.data,
            bpy.context.scene,
            METHODS[method],
            resolution=(160, 96),
            bounces=4,
            threads=2,
            seed=seed,
            budget={"seconds": SECONDS},
        )
        bpy.context.scene.render.image_settings.file_format = "OPEN_EXR"
        bpy.context.scene.render.image_settings.color_depth = "32"
        images.append(blend.render(tmp_path))
    return np.mean(images, 0), np.var(images, 0, ddof=1) / NUM_SEEDS


@pytest.mark.parametrize("camera", ["street", "roof", "alley"])
def test_converged_engines_agree_on_a_city(camera, tmp_path):
    path = tmp_path / "city.blend"
    build_scene("city-small", path)
    bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=False)
    bpy.context.scene.camera = bpy.data.objects[camera]
    check = compare_models(*converge("lighttree", tmp_path), *converge("cycles", tmp_path))
    assert check.mean_ratio == pytest.approx(1, abs=5e-3)
    assert check.share_within_3 >= 0.95
