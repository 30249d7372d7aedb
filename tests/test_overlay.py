"""The light tree in the viewport: its lines, its panel, and that it is drawn anew when it must."""

from types import SimpleNamespace

import blender_scenes as blend
import bpy
import numpy as np
import pytest

import lighttree_addon
from lighttree_addon import checkup, overlay
from lighttree_core.light_tree.level import Level

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]


@pytest.fixture
def scene():
    """Twenty points in two rows, a spot that looks down and a sun, before a camera."""
    scene = blend.new_file()
    scene.render.engine = "LIGHTTREE"
    for i in range(20):
        blend.add_lamp("POINT", location=(i % 10, 4 * (i // 10), 3))
    blend.add_lamp("SPOT", "Spot", {"energy": 1.0}, location=(0, 0, 9))
    blend.add_lamp("SUN", "Sun")
    blend.add_camera(location=(0, 0, 20))
    return scene


@pytest.fixture
def settings(scene):
    return bpy.context.window_manager.lighttree_overlay


def random_level(num=50):
    rng = np.random.default_rng(7)
    low = rng.uniform(-10, 10, (num, 3))
    axis = rng.normal(size=(num, 3))
    return Level(
        box_min=low,
        box_max=low + rng.uniform(0.1, 3, (num, 3)),
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
        theta_o=np.where(np.arange(num) % 5 == 0, np.pi, rng.uniform(0, 3, num)),
        power=rng.lognormal(0, 2, num),
        light_set=np.arange(num),
    )


def figures(points, colors, lines):
    """The points of each figure of lines that hang together, in order of the points."""
    group = np.arange(len(points))
    for _ in range(16):
        for a, b in (lines.T, lines.T[::-1]):
            np.minimum.at(group, a, group[b])
    for i in np.unique(group):
        assert len(np.unique(colors[group == i], axis=0)) == 1
        yield points[group == i].astype(float), colors[group == i][0]


def test_each_set_is_a_box_and_those_with_an_axis_a_cone():
    level = random_level()
    boxes = list(figures(*overlay.wires(level, False)))
    assert len(boxes) == 50
    by_power = np.argsort(-level.power)
    for i, (points, _) in zip(by_power, boxes, strict=True):
        np.testing.assert_allclose(points.min(0), level.box_min[i], atol=1e-5)
        np.testing.assert_allclose(points.max(0), level.box_max[i], atol=1e-5)
    cones = list(figures(*overlay.wires(level, True)))[50:]
    with_axis = [i for i in by_power if level.theta_o[i] < np.pi]
    for i, (points, color) in zip(with_axis, cones, strict=True):
        middle = (level.box_min[i] + level.box_max[i]) / 2
        half_diagonal = np.linalg.norm(level.box_max[i] - middle)
        np.testing.assert_allclose(points[0], middle, atol=1e-5)
        rim = points[1:] - points[0]
        length = np.linalg.norm(rim, axis=1)
        np.testing.assert_allclose(length, half_diagonal / 2, rtol=1e-4)
        np.testing.assert_allclose(
            rim @ level.axis[i] / length, np.cos(level.theta_o[i]), atol=1e-4
        )
        # All the way around: the mean of the rim lies on the axis.
        np.testing.assert_allclose(
            rim.mean(0),
            rim @ level.axis[i] @ np.ones(len(rim)) / len(rim) * level.axis[i],
            atol=1e-4,
        )
        np.testing.assert_array_equal(color, overlay.colors(level.power)[i])


def test_a_box_has_its_twelve_edges():
    points, _, lines = overlay.wires(random_level(1), False)
    ends = points[lines]
    sides = (ends[:, 0] != ends[:, 1]).sum(1)
    assert len(lines) == len({frozenset(line) for line in lines.tolist()}) == 12
    assert np.all(sides == 1)


def test_more_power_is_brighter_in_even_steps():
    power = 10.0 ** np.linspace(-4, 0, 41)
    linear = overlay.colors(power)[:, :3] ** 2.2
    lightness = np.cbrt(linear @ (0.2126, 0.7152, 0.0722))
    steps = np.diff(lightness)
    assert np.all(steps > 0) and steps.max() < 2.5 * steps.mean()
    # What is fainter than the ramp reaches has its end, and alike sets look alike.
    np.testing.assert_array_equal(*overlay.colors(np.array([1e-4, 1e-9, 1.0]))[:2])
    alike = overlay.colors(np.array([1.0, 0.98]))
    assert np.abs(alike[0] - alike[1]).max() < 0.02


def test_of_too_many_sets_the_brightest_are_drawn(settings, monkeypatch):
    monkeypatch.setattr(overlay, "MAX_SETS", 3)
    level = random_level()
    boxes = list(figures(*overlay.wires(level, False)))
    brightest = level.box_min[np.argsort(-level.power)[:3]]
    np.testing.assert_allclose([points.min(0) for points, _ in boxes], brightest, atol=1e-5)
    settings.show, settings.depth = True, 9
    assert overlay.describe(bpy.context)[:2] == [
        "21 sets of 21 lights",
        "The 3 brightest are drawn",
    ]


def test_points_are_seen():
    level = random_level(2)
    point = level._replace(box_max=level.box_min)
    assert np.all(
        [np.ptp(points, axis=0) > 0 for points, _ in figures(*overlay.wires(point, True))]
    )


def draw(panel):
    """(names of the settings, labels, buttons) that a panel shows."""
    drawn = [], [], []

    class Layout:
        def column(self, align=False):
            return self

        def prop(self, data, name, text="", slider=False):
            assert name in data.bl_rna.properties
            drawn[0].append(name)

        def label(self, text):
            drawn[1].append(text)

        def operator(self, name, icon):
            drawn[2].append(name)

    drawing = SimpleNamespace(layout=Layout())
    panel.draw_header(drawing, bpy.context)
    panel.draw(drawing, bpy.context)
    return drawn


def test_switching_it_on_looks_through_the_scene(settings):
    panel = bpy.types.RENDER_PT_lighttree_overlay
    assert panel.bl_parent_id == "RENDER_PT_lighttree_tree" and panel.poll(bpy.context)
    assert draw(panel) == (["show", "depth", "show_cones"], [], [])
    settings.show, settings.depth = True, 0
    assert checkup.found_in(bpy.context.scene)
    _, labels, buttons = draw(panel)
    assert labels[0] == "1 set of 21 lights" and not buttons
    assert labels[2] == "1 distant light left out: sun or world"
    settings.depth = 3
    _, labels, _ = draw(panel)
    assert labels[0] == "21 sets of 21 lights"
    # A point of 100 W sends all of it; the ramp reaches down to a tenth at least.
    assert labels[1].startswith("From ") and labels[1].endswith(" W, dim, to 100 W, bright")


def test_a_scene_that_cannot_be_looked_through_says_why(scene, settings):
    bpy.data.objects.remove(scene.camera)
    settings.show = True
    _, labels, buttons = draw(bpy.types.RENDER_PT_lighttree_overlay)
    assert "camera" in " ".join(labels) and buttons == ["lighttree.check_scene"]
    settings.show = False
    assert draw(bpy.types.RENDER_PT_lighttree_overlay)[1:] == ([], [])


def test_another_scene_has_nothing_to_draw_and_another_file_starts_without(settings, tmp_path):
    settings.show = True
    level, other = overlay.level_shown(bpy.context), bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    assert level and overlay.level_shown(bpy.context) is None
    path = str(tmp_path / "lights.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path, use_scripts=False)
    assert overlay.level_shown(bpy.context) is None
    assert not bpy.context.window_manager.lighttree_overlay.show


class Gpu:
    """In place of Blender's drawing, which needs a window; keeps what is built and drawn."""

    def __init__(self):
        self.built, self.drawn = [], []
        self.shader = SimpleNamespace(from_builtin=lambda name: self)
        self.state = SimpleNamespace(
            viewport_get=lambda: (0, 0, 800, 600),
            blend_set=lambda mode: None,
            depth_test_set=lambda mode: None,
        )

    def bind(self):
        pass

    def uniform_float(self, name, value):
        pass

    def batch(self, shader, kind, content, indices):
        self.built.append(content)
        return SimpleNamespace(draw=lambda shader: self.drawn.append(content))


@pytest.fixture
def redraw(monkeypatch):
    """A redraw of a viewport: how many batches it builds and draws."""
    gpu = Gpu()
    monkeypatch.setattr(overlay, "gpu", gpu)
    monkeypatch.setattr(overlay, "batch_for_shader", gpu.batch)

    def redraw():
        gpu.built.clear(), gpu.drawn.clear()
        window = bpy.context.window_manager.windows[0]
        area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
        with bpy.context.temp_override(window=window, area=area):
            overlay._draw()
        return len(gpu.built), len(gpu.drawn)

    return redraw


def test_lines_are_built_once_for_each_change(scene, settings, redraw):
    assert redraw() == (0, 0)
    settings.show = True
    assert [redraw(), redraw()] == [(2, 2), (0, 2)]
    settings.depth = 2
    assert [redraw(), redraw()] == [(2, 2), (0, 2)]
    settings.show_cones = False
    assert [redraw(), redraw()] == [(2, 2), (0, 2)]
    bpy.ops.lighttree.check_scene()
    assert [redraw(), redraw()] == [(2, 2), (0, 2)]
    settings.show = False
    assert redraw() == (0, 0)
    settings.show = True
    assert redraw() == (0, 2)
    scene.render.engine = "CYCLES"
    assert redraw() == (0, 0)


def test_what_is_gone_since_is_drawn_as_it_was_found(settings, redraw):
    settings.show = True
    redraw()
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    bpy.data.lights.remove(bpy.data.lights[0])
    settings.depth = 0
    assert redraw() == (2, 2)
    bpy.ops.wm.read_homefile(use_empty=True)
    assert redraw() == (0, 0)


def test_a_sun_alone_has_nothing_to_draw(settings, redraw):
    for item in list(bpy.data.objects):
        if item.type == "LIGHT" and item.name != "Sun":
            bpy.data.objects.remove(item)
    settings.show = True
    assert redraw() == (0, 0)
    _, labels, _ = draw(bpy.types.RENDER_PT_lighttree_overlay)
    assert labels == ["0 sets of 0 lights", "1 distant light left out: sun or world"]


def test_registering_twice_leaves_one_handler():
    lighttree_addon.unregister()
    handlers = []
    with pytest.MonkeyPatch.context() as patch:
        views = bpy.types.SpaceView3D
        patch.setattr(views, "draw_handler_add", lambda *what: handlers.append(what) or what)
        patch.setattr(views, "draw_handler_remove", lambda what, region: handlers.remove(what))
        for _ in range(2):
            lighttree_addon.register()
            assert handlers == [(overlay._draw, (), "WINDOW", "POST_VIEW")]
            lighttree_addon.unregister()
            assert handlers == []
    lighttree_addon.register()
