"""Every test that needs Blender starts from an empty file."""

import pytest


@pytest.fixture(autouse=True)
def empty_blend_file(request):
    if request.node.get_closest_marker("blender"):
        import bpy

        bpy.ops.wm.read_factory_settings(use_empty=True)
