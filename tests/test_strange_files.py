"""Files of the kinds that strangers have: both engines render them alike, or it is said why not."""

import bpy
import numpy as np
import OpenEXR
import pytest
from strange_files import FILES, build_file

from lighttree_addon.engine import LightTreeEngine
from lighttree_batch.blend import extract, open_blend
from lighttree_batch.methods import METHODS, configure, write_float_exr_to
from lighttree_batch.views import View

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]

SIZE, SAMPLES, SEEDS = (24, 24), 32, 3
# What makes the engines' images differ, which they must not silently.
DIFFERS = {
    "grease_pencil": "Grease Pencil",
    "a_volume": "volumes",
    "zero_scale": "lie in the place of others",
    "degenerate_and_loose_faces": "lie in the place of others",
    "a_million_metres_away": "places are rounded to 0.062 m",
}
TOLD = {
    "vertices_that_are_not_numbers": "Broken: its faces with a vertex at no finite place",
    "missing_library": "library.blend: missing",
    "damaged_library": "library.blend",
    "library_without_the_object": "Linked: not in",
    "missing_image": "missing",
    "drivers_and_scripts": "Scripts do not run",
    **DIFFERS,
}


def shoot(method, seed, folder):
    """(H, W, 3) of the open file."""
    scene = bpy.context.scene
    settings = {"resolution": SIZE, "bounces": 1, "threads": 2, "seed": seed}
    configure(bpy.data, scene, METHODS[method], **settings, budget={"samples": SAMPLES})
    write_float_exr_to(scene.render, str(folder / "image.exr"))
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(folder / "image.exr"), separate_channels=True) as file:
        return np.stack([file.channels()[name].pixels for name in "RGB"], -1).astype(np.float64)


@pytest.mark.parametrize("name", FILES)
def test_engines_agree_on_a_strange_file(name, tmp_path):
    path = build_file(name, tmp_path)
    before = sorted(tmp_path.rglob("*"))
    camera = "auto" if name == "no_camera" else None
    scene, warnings = open_blend(str(path), View(camera))
    shown = [getattr(scene.render, key) for key in ("engine", "use_freestyle", "use_compositing")]
    told = " ".join([*warnings, *extract(scene).not_modelled])
    assert shown == [
        getattr(scene.render, key) for key in ("engine", "use_freestyle", "use_compositing")
    ]
    assert TOLD.get(name, "") in told and bool(told) == (name in TOLD), told
    if name in DIFFERS:
        return
    ours = np.array([shoot("lighttree", seed, tmp_path) for seed in range(SEEDS)])
    ((film, _),) = LightTreeEngine.rendered
    assert film.dropped_samples == 0 and np.isfinite(ours).all()
    theirs = np.array([shoot("cycles", seed, tmp_path) for seed in range(SEEDS)])
    means = [images.mean(axis=(1, 2, 3)) for images in (ours, theirs)]
    error = np.hypot(*(mean.std(ddof=1) / SEEDS**0.5 for mean in means))
    a, b = (mean.mean() for mean in means)
    assert abs(a - b) <= 4 * error + 0.01 * abs(b), (a, b, error)
    (tmp_path / "image.exr").unlink()
    assert sorted(tmp_path.rglob("*")) == before
