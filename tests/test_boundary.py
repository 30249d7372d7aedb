"""What may import what."""

import subprocess
import sys

import pytest


def test_the_core_never_loads_blender():
    code = "import sys, lighttree_core; sys.exit('bpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.blender
def test_the_add_on_registers_again_and_again():
    import bpy

    import lighttree_addon

    for _ in range(3):
        lighttree_addon.register()
        assert bpy.context.scene.lighttree.samples > 0
        lighttree_addon.unregister()
        assert not hasattr(bpy.types.Scene, "lighttree")
