"""Every test that needs Blender starts from an empty file; kernels as Python do not warn."""

import numba
import pytest


def pytest_configure(config):
    # Kernels divide by zero on purpose and then choose another number; as plain Python, numpy says.
    if numba.config.DISABLE_JIT:
        config.addinivalue_line(
            "filterwarnings", "ignore:(divide by zero|invalid value|overflow) encountered in scalar"
        )


@pytest.fixture(autouse=True)
def empty_blend_file(request):
    if request.node.get_closest_marker("blender"):
        import bpy

        bpy.ops.wm.read_factory_settings(use_empty=True)
