"""A small batch, of a cube with a lamp that is dimmed, and what to expect of its images."""

import shutil
import subprocess
import sys

import numpy as np

from lighttree_batch.images import read_exr

SAVE_SHOT = """
import bpy, sys
bpy.ops.wm.read_factory_settings()
lamp = bpy.data.objects["Light"].data
for frame, energy in ((1, 1000.0), (10, 10.0)):
    lamp.energy = energy
    lamp.keyframe_insert("energy", frame=frame)
bpy.context.scene.frame_set(int(sys.argv[2]))
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1], compress=False)
"""
JOB = """
methods = ["lighttree", "cycles"]
samples = [16, 256]
seeds = 1
resolution = [48, 27]
reference_samples = 512
[[scene]]
files = ["shot.blend"]
frames = [1, 10]
"""


def save_shot(path, frame):
    command = [sys.executable, "-c", SAVE_SHOT, str(path), str(frame)]
    subprocess.run(command, check=True, capture_output=True)


def prepare(folder, shot, job=JOB):
    """A folder with a job file and its scene: the command that runs it."""
    folder.mkdir()
    shutil.copy(shot, folder)
    (folder / "jobs.toml").write_text(job)
    return [sys.executable, "-m", "lighttree_batch", "batch", str(folder / "jobs.toml")]


def find_images(folder):
    found = folder.rglob("*.exr")
    return {str(p.relative_to(folder)) for p in found if ".unfinished" not in p.parts}


def assert_same_images(expected_folder, folder):
    """The same images; bit by bit where there is no Cycles, whose sums depend on threads."""
    assert find_images(expected_folder) == find_images(folder)
    for name in find_images(folder):
        if "lighttree" in name:
            (expected, told), (found, header) = (
                read_exr(place / name) for place in (expected_folder, folder)
            )
            assert all(np.array_equal(expected[key], found[key]) for key in expected), name
            assert told.get("key") == header.get("key")
