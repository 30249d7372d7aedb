"""Camera rays: the pixel filter, the lens, and where each ray starts and ends.

Every sample belongs to one pixel: the filter is not a weight but the density of the points that
rays of a pixel go through (Ernst et al. 2006, Filter Importance Sampling). The lens is thin: all
rays of a point of the image meet where a pinhole sees it on the plane of focus (Potmesil &
Chakravarty 1981). Apertures have the size, shape and orientation that Cycles gives them.
"""

import math
from typing import NamedTuple

import numpy as np

from .jit import HALF, ONE, TWO, TWO_PI, ZERO, f32, flag, i64, kernel, table
from .sampling import LENS, PIXEL, dim, sample_disk, sample_triangle, uniform_pair
from .scene import Camera
from .vec import from_frame, madd, scale

FILTERS = BOX, GAUSSIAN, BLACKMAN_HARRIS = "box", "gaussian", "blackman-harris"
FILTER_TABLE_SIZE = 1024
# Steps of the sum that a filter's table is made of.
NUM_FILTER_STEPS = 1 << 16
LEAST_FOCUS_DISTANCE = 1e-5


@table
class CameraTable(NamedTuple):
    """`scene.Camera` for kernels, and the filter of its pixels: see `filter_offset`."""

    world_from_camera: f32[:, ::1]
    half_width: f32
    half_height: f32
    shift_x: f32
    shift_y: f32
    clip_start: f32
    clip_end: f32
    lens_radius: f32
    lens_ratio: f32
    focus_distance: f32
    blade_rotation: f32
    num_blades: i64
    orthographic: flag
    width_px: i64
    height_px: i64
    filter_table: f32[::1]


def build_camera_table(
    camera: Camera, filter_kind: str = BOX, filter_width_px: float = 1.5
) -> CameraTable:
    """A camera as kernels read it."""
    return CameraTable(
        world_from_camera=camera.world_from_camera,
        half_width=camera.half_width,
        half_height=camera.half_height,
        shift_x=camera.shift_x,
        shift_y=camera.shift_y,
        clip_start=camera.clip_start,
        clip_end=camera.clip_end,
        lens_radius=camera.lens_radius,
        lens_ratio=camera.lens_ratio,
        focus_distance=max(camera.focus_distance, LEAST_FOCUS_DISTANCE),
        blade_rotation=camera.blade_rotation,
        num_blades=camera.num_blades if camera.num_blades >= 3 else 0,
        orthographic=camera.orthographic,
        width_px=camera.width_px,
        height_px=camera.height_px,
        filter_table=build_filter_table(filter_kind, filter_width_px),
    )


def filter_reach(kind: str, width_px: float) -> float:
    """How far from its middle a filter reaches, in pixels; a box is one pixel wide at any width."""
    return {BOX: 0.5, GAUSSIAN: 1.5 * width_px, BLACKMAN_HARRIS: width_px}[kind]


def eval_filter(kind: str, width_px: float, x: np.ndarray) -> np.ndarray:
    """A filter, not normalised, x pixels from its middle along one axis and within its reach.

    Gaussian and width as in Cycles; the window is Harris' of 1978, four terms, 92 dB.
    """
    if kind == BOX:
        return np.ones_like(x)
    if kind == GAUSSIAN:
        return np.exp(-8 * (x / width_px) ** 2)
    angle = np.pi * x / width_px
    return (
        0.35875
        + 0.48829 * np.cos(angle)
        + 0.14128 * np.cos(2 * angle)
        + 0.01168 * np.cos(3 * angle)
    )


def build_filter_table(kind: str, width_px: float) -> np.ndarray:
    """(n,) float32 distances from the middle, in pixels, at equal steps of the share within."""
    x = np.linspace(0, filter_reach(kind, width_px), NUM_FILTER_STEPS + 1)
    value = eval_filter(kind, width_px, x)
    within = np.concatenate([[0], np.cumsum(value[1:] + value[:-1])])
    share = np.linspace(0, 1, FILTER_TABLE_SIZE)
    return np.interp(share, within / within[-1], x).astype(np.float32)


@kernel
def filter_offset(table, u):
    """Offset from the middle of a pixel along one axis, in px, distributed as its filter."""
    signed = TWO * u - ONE
    place = abs(signed) * np.float32(len(table) - 1)
    i = min(int(place), len(table) - 2)
    distance = table[i] + (place - np.float32(i)) * (table[i + 1] - table[i])
    return distance if signed > ZERO else -distance


@kernel
def sample_polygon(num_corners, rotation, u):
    """A uniform point, (x, y), of the regular polygon within the unit circle.

    rotation: angle of the middle of a side, from the x axis.
    """
    place = u[0] * np.float32(num_corners)
    corner = np.float32(int(place))
    b1, b2 = sample_triangle((place - corner, u[1]))
    step = TWO_PI / np.float32(num_corners)
    angle = rotation + (corner - HALF) * step
    x = b1 * math.cos(angle) + b2 * math.cos(angle + step)
    return x, b1 * math.sin(angle) + b2 * math.sin(angle + step)


@kernel
def sample_aperture(camera, u):
    """A uniform point of the lens, (x, y) in metres."""
    if camera.num_blades == 0:
        x, y = sample_disk(u)
    else:
        x, y = sample_polygon(camera.num_blades, camera.blade_rotation, u)
    return x * camera.lens_radius / camera.lens_ratio, y * camera.lens_radius


@kernel
def camera_ray(camera, x, y, u_lens):
    """(origin, unit direction, cosine to the viewing axis) through a point of the image, in px.

    The origin lies on the camera's own plane. u_lens: a pair in [0, 1), unused by a pinhole.
    """
    px = (TWO * x / np.float32(camera.width_px) - ONE) * camera.half_width + camera.shift_x
    py = (TWO * y / np.float32(camera.height_px) - ONE) * camera.half_height + camera.shift_y
    # Sideways: a place on the camera's plane, and a step for each metre along the viewing axis.
    place_x, place_y, step_x, step_y = ZERO, ZERO, ZERO, ZERO
    if camera.lens_radius > ZERO:
        place_x, place_y = sample_aperture(camera, u_lens)
        step_x, step_y = -place_x / camera.focus_distance, -place_y / camera.focus_distance
    if camera.orthographic:
        place_x, place_y = px + place_x, py + place_y
    else:
        step_x, step_y = px + step_x, py + step_y
    cos_axis = ONE / math.sqrt(ONE + step_x * step_x + step_y * step_y)
    m = camera.world_from_camera
    right = m[0, 0], m[1, 0], m[2, 0]
    up = m[0, 1], m[1, 1], m[2, 1]
    back = m[0, 2], m[1, 2], m[2, 2]
    origin = madd(madd((m[0, 3], m[1, 3], m[2, 3]), place_x, right), place_y, up)
    direction = from_frame(right, up, back, (step_x, step_y, -ONE))
    return origin, scale(direction, cos_axis), cos_axis


@kernel
def spawn_ray(camera, seed, pixel, sample):
    """A sample's ray from the near clip plane: (origin, unit direction, distance to the far one).

    pixel: row x width + column in the full frame. Both planes lie across the viewing axis.
    """
    u_pixel, u_lens = uniform_pair(seed, pixel, sample, dim(0, PIXEL)), (ZERO, ZERO)
    if camera.lens_radius > ZERO:
        u_lens = uniform_pair(seed, pixel, sample, dim(0, LENS))
    row = pixel // camera.width_px
    column = pixel - row * camera.width_px
    x = np.float32(column) + HALF + filter_offset(camera.filter_table, u_pixel[0])
    y = np.float32(row) + HALF + filter_offset(camera.filter_table, u_pixel[1])
    origin, direction, cos_axis = camera_ray(camera, x, y, u_lens)
    origin = madd(origin, camera.clip_start / cos_axis, direction)
    return origin, direction, (camera.clip_end - camera.clip_start) / cos_axis
