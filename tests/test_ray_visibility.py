"""Objects that rays of some kinds do not meet, as if they were not there for these."""

from dataclasses import replace

import numpy as np
import pytest
from core_scenes import add_triangles, camera, fewer, floor_scene, lamps_down, make_clear, materials

from lighttree_core import SceneError, Settings, render
from lighttree_core.lights import build_lights
from lighttree_core.scene import (
    ALL_RAYS,
    CAMERA_RAY,
    DIFFUSE_RAY,
    GLOSSY,
    GLOSSY_RAY,
    POINT,
    RECTANGLE,
    SHADOW_RAY,
    TRANSPARENT,
    TRIANGLE,
    Closures,
)

EVERY = ALL_RAYS | SHADOW_RAY
CORNER = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
ROOF = 40 * CORNER - (10, 10, 0)
SETTINGS = Settings(samples=fewer(16, 4), max_bounces=2)


def roofed(visible, heights=(2,), emission=0.0, lamp_height=3, clear_too=False):
    """A floor under roofs that hide it and its lamp from the camera, for rays that meet them."""
    scene = floor_scene(lamps_down([POINT], [(0, 0, lamp_height)]))
    scene.materials = materials((0.5, 0), (0.25, emission), (0, 0))
    if clear_too:
        make_clear(scene, 2)
    for height in heights:
        add_triangles(scene, [ROOF + (0, 0, height)], 1, "Roof")
        if clear_too:
            add_triangles(scene, [ROOF + (0, 0, height + 0.1)], 2, "Pane")
    is_roof = np.array(scene.object_names) == "Roof"
    scene.object_visible = np.where(is_roof, visible, EVERY).astype(np.int32)
    return scene


@pytest.mark.parametrize("clear_too", [False, True])
def test_what_no_ray_meets_is_not_there(clear_too):
    # More roofs than rays may pass transparent surfaces.
    hidden = render(roofed(0, np.linspace(1, 2, 20), clear_too=clear_too), SETTINGS)
    bare = roofed(0, (), clear_too=clear_too)
    if clear_too:
        assert hidden.mean.max() == 0  # twenty panes are too many
        hidden = render(roofed(0, (1, 2), clear_too=True), SETTINGS)
        for height in (1, 2):
            add_triangles(bare, [ROOF + (0, 0, height + 0.1)], 2, "Pane")
        bare.object_visible = np.zeros(0, np.int32)
    expected = render(bare, SETTINGS)
    assert expected.mean.min() > 0
    for name in ("mean", "normal", "albedo", "depth"):
        np.testing.assert_allclose(getattr(hidden, name), getattr(expected, name), rtol=1e-3)


def test_the_camera_sees_through_what_still_hides_light():
    hidden = render(roofed(EVERY & ~CAMERA_RAY), SETTINGS)
    assert hidden.mean.max() == 0  # the floor, in the roof's shadow
    np.testing.assert_allclose(hidden.depth, 5, rtol=1e-5)
    lit = render(roofed(EVERY & ~CAMERA_RAY, lamp_height=1), SETTINGS).mean
    open_above = render(roofed(0, lamp_height=1), SETTINGS).mean
    assert (lit > 1.01 * open_above).mean() > 0.9  # by what the roof's inside throws back


def test_what_casts_no_shadow_is_seen_all_the_same():
    scene, settings = roofed(EVERY & ~SHADOW_RAY), replace(SETTINGS, max_bounces=0)
    np.testing.assert_allclose(render(scene, settings).depth, 3, rtol=1e-5)
    scene.camera = camera(position=(0, 0, 1.5))
    below = render(scene, settings).mean
    bare = render(floor_scene(scene.lamps, camera=scene.camera), settings).mean
    np.testing.assert_allclose(below, bare, rtol=1e-4)


def test_a_light_hidden_from_the_camera_still_lights():
    seen, hidden = (
        render(roofed(visible, emission=(0, 3, 0), lamp_height=1), SETTINGS)
        for visible in (EVERY, EVERY & ~CAMERA_RAY)
    )
    np.testing.assert_allclose(seen.mean[..., 1], 3, atol=1)
    assert np.all(hidden.mean[..., 1] > 1.2 * hidden.mean[..., 0])


def test_the_far_clip_plane_is_as_far_behind_what_is_hidden():
    for clip_end, is_seen in ((5.1, True), (4.9, False)):
        scene = roofed(0, np.linspace(1, 2, 5))
        scene.camera = camera(clip_end=clip_end)
        assert (render(scene, SETTINGS).mean.min() > 0) == is_seen


def test_lamps_before_what_is_hidden_are_seen():
    scene = roofed(0, clear_too=True)
    # Nothing is glossy, but so the kernels are those of a city.
    scene.closures = Closures.empty(2)
    scene.closures.kind[:], scene.closures.weight[:] = (TRANSPARENT, GLOSSY), 1
    scene.lamps = lamps_down([RECTANGLE], [(0, 0, 3)])
    scene.lamps.visible[:] = ALL_RAYS
    scene.lamps.axis_u[:] *= 10
    scene.lamps.axis_v[:] *= 10
    scene.lamps.axis_w[:] *= -1
    seen = render(scene, SETTINGS).mean
    scene.object_visible[:] = EVERY
    np.testing.assert_array_equal(render(scene, SETTINGS).mean[4, 7:9], seen[4, 7:9])
    assert seen[4, 7:9].min() > 0


def test_emitters_are_lights_of_the_rays_that_meet_them():
    def lights_of(visible):
        scene = roofed(visible, emission=1.0)
        return build_lights(scene)[0]

    for visible in (
        EVERY,
        EVERY & ~CAMERA_RAY & ~SHADOW_RAY,
        GLOSSY_RAY | CAMERA_RAY,
        DIFFUSE_RAY,
    ):
        lights = lights_of(visible)
        is_triangle = lights.kind == TRIANGLE
        assert is_triangle.sum() == 2
        assert set(lights.visible[is_triangle]) == {visible & ALL_RAYS}
    # What only the camera sees, or shadow rays, lights nothing.
    assert not np.any(lights_of(CAMERA_RAY | SHADOW_RAY).kind == TRIANGLE)


@pytest.mark.parametrize("visible", [[EVERY], [EVERY, 0, 0]])
def test_a_damaged_table_is_refused(visible):
    scene = roofed(0)
    scene.object_visible = np.array(visible, np.int32)
    with pytest.raises(SceneError, match="visibility of objects"):
        scene.check()
