"""Every test that needs Blender starts from an empty file; kernels as Python do not warn."""

import os
import sys

import numba
import pytest
from shot_batch import save_shot

EXIT_STATUS = pytest.StashKey()


def pytest_configure(config):
    # Kernels divide by zero on purpose and then choose another number; as plain Python, numpy says.
    if numba.config.DISABLE_JIT:
        config.addinivalue_line(
            "filterwarnings", "ignore:(divide by zero|invalid value|overflow) encountered in scalar"
        )


def pytest_collection_modifyitems(items):
    """Mark tests of the core: those whose file imports neither the add-on nor batches."""
    for item in items:
        source = item.path.read_text(encoding="utf-8")
        if not item.get_closest_marker("blender") and not any(
            name in source for name in ("lighttree_addon", "lighttree_batch")
        ):
            item.add_marker("core")


def pytest_sessionfinish(session, exitstatus):
    session.config.stash[EXIT_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    # Up to 4.5 Blender may hang when Python ends; by now all results have been told.
    bpy = sys.modules.get("bpy")
    if bpy and bpy.app.version < (5, 0):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash.get(EXIT_STATUS, 1))


@pytest.fixture(autouse=True)
def empty_blend_file(request):
    if request.node.get_closest_marker("blender"):
        import bpy

        bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def registered():
    """The add-on, switched on."""
    import lighttree_addon

    lighttree_addon.register()
    yield
    lighttree_addon.unregister()


@pytest.fixture(scope="session")
def shot(tmp_path_factory):
    """A cube whose lamp is dimmed from frame 1 to frame 10."""
    path = tmp_path_factory.mktemp("shot") / "shot.blend"
    save_shot(path, 1)
    return path
