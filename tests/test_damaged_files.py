"""Two hundred damaged scenes and images: each is told in a sentence, or whole where it counts."""

import time
from pathlib import Path

import blender_scenes as blend
import bpy
import numpy as np
import pytest

from lighttree_batch.images import ImageError, write_exr
from lighttree_batch.methods import InputError
from lighttree_batch.metrics import read_rgb
from lighttree_batch.process import RenderError, RenderProcess
from lighttree_core import Scene, SceneError

pytestmark = pytest.mark.blender

PATIENCE_S = 60
CITY = Path(__file__).parent / "scenes" / "city-tiny.npz"


def damage(whole: bytes, rng) -> bytes:
    """Bytes that are cut short, flipped, wiped out, doubled, or of another file."""
    kind, damaged = rng.integers(5), bytearray(whole)
    first = rng.integers(0, len(whole))
    last = rng.integers(first, min(len(whole), first + rng.choice([16, len(whole)])) + 1)
    if kind == 0:
        return bytes(damaged[:first])
    if kind == 1:
        damaged[first] ^= 1 << rng.integers(8)
    elif kind == 2:
        damaged[first:last] = bytes(last - first)
    elif kind == 3:
        damaged[first:first] = damaged[first:last]
    else:
        damaged[first:last] = rng.bytes(last - first)
    return bytes(damaged)


def each_damaged(path, num, read, allowed):
    """Read `num` damaged copies of a file; the sentences of those that are refused."""
    rng, whole, told = np.random.default_rng(7), path.read_bytes(), []
    for i in range(num):
        copy = path.with_name(f"{i}{path.suffix}")
        copy.write_bytes(damage(whole, rng))
        start = time.monotonic()
        try:
            read(copy)
        except allowed as error:
            told.append(str(error))
            assert "\n" not in told[-1] and "Traceback" not in told[-1]
        assert time.monotonic() - start < PATIENCE_S
    return told


def test_damaged_exported_scenes_are_refused(tmp_path):
    path = tmp_path / "scene.npz"
    path.write_bytes(CITY.read_bytes())

    def read(copy):
        Scene.load(copy).check()

    told = each_damaged(path, 80, read, SceneError)
    assert len(told) > 40 and all(".npz: " in sentence for sentence in told)


def test_damaged_images_are_refused(tmp_path):
    path = tmp_path / "image.exr"
    pixels = np.random.default_rng(1).random((3, 24, 32)).astype(np.float32)
    write_exr(path, dict(zip("RGB", pixels, strict=True)), {"samples": 1})
    told = each_damaged(path, 60, read_rgb, ImageError)
    # OpenEXR has no checksums: another number in a pixel is not noticed.
    assert len(told) > 15 and all(".exr: " in sentence for sentence in told)


def test_damaged_blends_are_refused_or_rendered_by_a_process_that_may_die(tmp_path):
    blend.new_file()
    blend.add_plane(6, blend.new_material("Grey"))
    blend.add_lamp("POINT", location=(0, 0, 2))
    blend.add_camera(location=(0, 0, 5))
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    with RenderProcess() as process:

        def read(copy):
            job = {"do": "export", "file": str(copy), "out": str(tmp_path / "out.npz")}
            process.ask(job)

        told = each_damaged(path, 60, read, (InputError, RenderError))
    assert len(told) > 20
