"""The light tree in the viewport: boxes and cones of the sets of lights at one depth.

It is drawn as Check Scene last found it. How one looks at a tree is no setting of the render, so
it is kept with Blender's window, not with the scene, and another file starts without it.
"""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from bpy.props import BoolProperty, IntProperty, StringProperty
from gpu_extras.batch import batch_for_shader

from lighttree_core import SceneError
from lighttree_core.light_tree.level import NO_SET, Level, sets_at

from . import checkup
from .engine import LightTreeEngine
from .viewport import redraw_views

# Of more sets than this the brightest are drawn, lest the viewport stall.
MAX_SETS = 20_000
# The ramp of powers spans at most this and at least the other.
MAX_RATIO, MIN_RATIO = 1e4, 10.0
# From dim to bright in even steps to the eye: matplotlib's "plasma" (CC0) from where it is seen on
# dark grey.
RAMP = (
    (0.287, 0.011, 0.627),
    (0.557, 0.047, 0.643),
    (0.768, 0.245, 0.498),
    (0.915, 0.449, 0.343),
    (0.993, 0.687, 0.192),
    (0.940, 0.975, 0.131),
)
# Half of a box's side is at least this share of the diagonal around all: points show, and flat
# lights stand off their surfaces.
LEAST_SHARE = 1e-4
# Of lines behind something.
HIDDEN_ALPHA = 0.2
CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)]) * 2 - 1
EDGES = np.array([(i, i | 1 << k) for i in range(8) for k in range(3) if not i >> k & 1])
RIM = 12
# Around the rim, which follows the apex, and from the apex to every third of it.
CONE_LINES = np.array(
    [(i, i % RIM + 1) for i in range(1, RIM + 1)] + [(0, i) for i in range(1, RIM + 1, 3)]
)


def wires(level: Level, show_cones: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines of the brightest of some sets: points (m, 3), colours (m, 4), ends of lines (k, 2)."""
    order = np.argsort(-level.power, kind="stable")[:MAX_SETS]
    low, high, axis, theta = (
        column[order] for column in (level.box_min, level.box_max, level.axis, level.theta_o)
    )
    middle, half = (low + high) / 2, (high - low) / 2
    least = LEAST_SHARE * np.linalg.norm(level.box_max.max(0) - level.box_min.min(0)) or 0.1
    half = np.maximum(half, least)
    points = (middle[:, None] + half[:, None] * CORNERS).reshape(-1, 3)
    lines, color = _repeat(EDGES, len(CORNERS), len(order)), colors(level.power)[order]
    point_colors = np.repeat(color, len(CORNERS), axis=0)
    if show_cones:
        has_cone = theta < np.pi
        length = np.linalg.norm(half[has_cone], axis=1) / 2
        cones = middle[has_cone, None] + length[:, None, None] * _cones(
            axis[has_cone], theta[has_cone]
        )
        lines = np.concatenate([lines, len(points) + _repeat(CONE_LINES, RIM + 1, len(cones))])
        points = np.concatenate([points, cones.reshape(-1, 3)])
        point_colors = np.concatenate([point_colors, np.repeat(color[has_cone], RIM + 1, axis=0)])
    return points.astype(np.float32), point_colors, lines


def _repeat(lines, num_points, num) -> np.ndarray:
    """The lines of `num` like figures of so many points each."""
    return (np.arange(num)[:, None, None] * num_points + lines).reshape(-1, 2).astype(np.int32)


def _cones(axis, theta) -> np.ndarray:
    """(n, RIM + 1, 3): the apex, at the origin, and the rim at distance one from it."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    phi = np.arange(RIM)[:, None] * 2 * np.pi / RIM
    rim = np.cos(phi) * across[:, None] + np.sin(phi) * np.cross(axis, across)[:, None]
    theta = theta[:, None, None]
    rim = np.cos(theta) * axis[:, None] + np.sin(theta) * rim
    return np.concatenate([np.zeros_like(rim[:, :1]), rim], axis=1)


def power_range(power) -> tuple[float, float]:
    """The powers of the ramp's two ends, W."""
    high = power.max()
    return min(max(power.min(), high / MAX_RATIO), high / MIN_RATIO), high


def colors(power) -> np.ndarray:
    """(n, 4) float32 colours of sets by the logarithm of their powers."""
    low, high = power_range(power)
    t = np.log(np.maximum(power, low) / low) / np.log(high / low) * (len(RAMP) - 1)
    stops = np.array(RAMP)
    channels = [np.interp(t, np.arange(len(RAMP)), stops[:, k]) for k in range(3)]
    return np.stack([*channels, np.ones(len(t))], axis=1).astype(np.float32)


class Shown:
    """The level that was asked for last, and its lines once they are drawn."""

    found: checkup.Checkup | None = None
    depth = 0
    level: Level | None = None
    batches = None
    has_cones = False


def level_shown(context) -> Level | None:
    """The sets of this scene at the chosen depth; None if nobody looked through the scene."""
    found, depth = checkup.last, context.window_manager.lighttree_overlay.depth
    if found is not Shown.found or depth != Shown.depth:
        Shown.found, Shown.depth, Shown.batches = found, depth, None
        Shown.level = sets_at(found.tree, found.bounds, depth) if found else None
    return Shown.level if checkup.found_in(context.scene) else None


def describe(context) -> list[str]:
    """What is drawn, in lines for a panel."""
    level = level_shown(context)
    num_sets, num_lights = len(level.power), int((level.light_set != NO_SET).sum())
    lines = [f"{num_sets:,} set{_s(num_sets)} of {num_lights:,} light{_s(num_lights)}"]
    if num_sets > MAX_SETS:
        lines.append(f"The {MAX_SETS:,} brightest are drawn")
    if num_sets:
        low, high = power_range(level.power)
        lines.append(f"From {low:.3g} W, dim, to {high:.3g} W, bright")
    num_distant = int(Shown.found.bounds.is_distant.sum())
    if num_distant:
        lines.append(f"{num_distant} distant light{_s(num_distant)} left out: sun or world")
    return lines


def _s(num) -> str:
    return "" if num == 1 else "s"


def _draw() -> None:
    context = bpy.context
    settings = context.window_manager.lighttree_overlay
    is_shown = settings.show and context.space_data.overlay.show_overlays
    if not is_shown or context.engine != LightTreeEngine.bl_idname:
        return
    level = level_shown(context)
    if level is None or not len(level.power):
        return
    shader = gpu.shader.from_builtin("POLYLINE_FLAT_COLOR")
    if Shown.batches is None or Shown.has_cones != settings.show_cones:
        points, point_colors, lines = wires(level, settings.show_cones)
        Shown.batches = [
            batch_for_shader(
                shader,
                "LINES",
                {"pos": points, "color": point_colors * np.float32((1, 1, 1, alpha))},
                indices=lines,
            )
            for alpha in (1, HIDDEN_ALPHA)
        ]
        Shown.has_cones = settings.show_cones
    shader.bind()
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    shader.uniform_float("lineWidth", context.preferences.system.ui_scale)
    gpu.state.blend_set("ALPHA")
    for batch, test in zip(Shown.batches, ("LESS_EQUAL", "GREATER"), strict=True):
        gpu.state.depth_test_set(test)
        batch.draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _redraw(settings, context) -> None:
    redraw_views(context)


def _switched(settings, context) -> None:
    """Look through the scene if nobody did."""
    settings.problem = ""
    if settings.show and not checkup.found_in(context.scene):
        try:
            checkup.look(context)
        except SceneError as error:
            settings.problem = str(error)
    redraw_views(context)


class LightTreeOverlay(bpy.types.PropertyGroup):
    """`window_manager.lighttree_overlay`."""

    show: BoolProperty(
        name="Viewport Overlay",
        description="Draw the sets of lights of the tree in the viewports, as Check Scene last "
        "found them. Each has its box, coloured by its power",
        update=_switched,
    )
    depth: IntProperty(
        name="Depth",
        description="How far down the tree to look: at 0 all lights are one set, further down "
        "sets are smaller, in the end each light is by itself",
        default=1,
        min=0,
        soft_max=8,
        max=100,
        update=_redraw,
    )
    show_cones: BoolProperty(
        name="Cones",
        description="Draw the cone of the directions that the lights of a set point to, unless "
        "they point everywhere",
        default=True,
        update=_redraw,
    )
    problem: StringProperty(options={"HIDDEN"})


_handler = None


def register():
    global _handler
    bpy.utils.register_class(LightTreeOverlay)
    bpy.types.WindowManager.lighttree_overlay = bpy.props.PointerProperty(type=LightTreeOverlay)
    _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister():
    bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    del bpy.types.WindowManager.lighttree_overlay
    bpy.utils.unregister_class(LightTreeOverlay)
    Shown.found = Shown.level = Shown.batches = None
