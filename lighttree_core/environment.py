"""The world around the scene: its radiance by direction, and directions sampled by importance.

An image is cut into cells of equal longitude and latitude; a direction's density is constant within
a cell, uniform over its solid angle, and proportional to the root mean square of the image there,
which is best for one number a cell. Rows start below, at -Z; a column's longitude falls from pi.
A world without image has tables of no rows and is sampled in `light_points.py`.
"""

import math
from typing import NamedTuple

import numpy as np

from .jit import HALF, INV_PI, ONE, TWO_PI, called_kernel, f32, f64, kernel, table
from .scene import Scene
from .vec import LUMINANCE, add, dot, from_frame, load3, madd, mul, scale

MAX_ROWS, MAX_COLUMNS = 1024, 2048  # of cells


@table
class EnvironmentTable(NamedTuple):
    """`scene.Environment` for kernels; h rows and w columns of cells.

    color: (1, 3) radiance, or what multiplies the image. image: (H, W, 3), or (0, 0, 3) for none.
    local_from_world: (3, 3). density: (h, w) of directions, 1/sr. row_cdf: (h + 1,) from 0 to 1;
    column_cdf: (h, w + 1) of each row. row_height: (h + 1,) float64, z of the bounds of rows.
    mean_luminance: of the radiance, without its sign, over all directions.
    """

    color: f32[:, ::1]
    image: f32[:, :, ::1]
    local_from_world: f32[:, ::1]
    density: f32[:, ::1]
    row_cdf: f32[::1]
    column_cdf: f32[:, ::1]
    row_height: f64[::1]
    mean_luminance: f64


def build_environment(scene: Scene) -> EnvironmentTable:
    """The table of a scene's background and its image; one of no light has the luminance 0."""
    color = scene.background.reshape(1, 3)
    image = scene.environment.image
    mean, cells = np.abs(color[0] @ np.array(LUMINANCE, np.float64)), np.zeros((0, 0))
    row_height = np.zeros(0)
    if image.size > 0:
        cells, mean = _weigh_cells(image, color[0])
        row_height = -np.cos(np.pi * np.arange(len(cells) + 1) / len(cells))
        if mean == 0:
            image, cells, row_height = np.zeros((0, 0, 3)), np.zeros((0, 0)), np.zeros(0)
            color = np.zeros((1, 3))
    density, row_cdf, column_cdf = _distribution(cells, row_height)
    return EnvironmentTable(
        color=color,
        image=image,
        local_from_world=scene.environment.local_from_world,
        density=density,
        row_cdf=row_cdf,
        column_cdf=column_cdf,
        row_height=row_height,
        mean_luminance=mean,
    )


def _weigh_cells(image: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, float]:
    """(h, w) root mean square of the luminance in each cell, and the mean over all directions.

    Without signs, so that colours cannot cancel: a cell has no weight only if it has no light. The
    interpolated image is taken at the middles of the four quarters of each texel. Weights are
    relative.
    """
    height, width = image.shape[:2]
    brightness = np.abs(image) @ np.float32(np.abs(color) * LUMINANCE)
    ring = np.diff(-np.cos(np.pi * np.arange(height + 1) / height))
    mean = float(brightness.mean(axis=1, dtype=np.float64) @ ring / 2)
    brightness /= max(brightness.max(), np.float32(1e-30))  # or small squares would come to 0
    num_rows, num_columns = min(height, MAX_ROWS), min(width, MAX_COLUMNS)
    squares = np.zeros((num_rows, num_columns))
    for along_row in (-1, 1):
        near = 0.75 * brightness + 0.25 * np.roll(brightness, along_row, axis=1)
        for along_column in (-1, 1):
            quarter = 0.75 * near + 0.25 * np.roll(near, along_column, axis=0)
            squares += _shrink(_shrink(quarter**2, num_rows).T, num_columns).T
    return np.sqrt(squares), mean


def _shrink(table: np.ndarray, num: int) -> np.ndarray:
    """Sums of the rows of a table in `num` equal parts, whose bounds may cut through rows."""
    height = len(table)
    if height == num:
        return table
    # Added up one by one: differences of running sums would lose what is dark beside a sun.
    parts = np.zeros((num, table.shape[1]))
    for row in range(height):
        part = row * num // height
        within = min(1.0, (part + 1) * height / num - row)
        parts[part] += within * table[row]
        if within < 1:
            parts[part + 1] += (1 - within) * table[row]
    return parts


def _distribution(cells, row_height) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(density of directions, row_cdf, column_cdf) for cells of these weights per solid angle."""
    if cells.size == 0:
        return cells, np.zeros(0), np.zeros((0, 0))
    solid_angle = np.diff(row_height) * (2 * np.pi / cells.shape[1])
    sums = np.cumsum(cells, axis=1)
    rows = np.cumsum(sums[:, -1] * solid_angle)
    column_cdf = np.zeros((len(cells), cells.shape[1] + 1))
    column_cdf[:, 1:] = sums / np.maximum(sums[:, -1:], 1e-300)
    return cells / rows[-1], np.append(0, rows / rows[-1]), column_cdf


@kernel
def to_local(table, direction):
    """A world direction in the frame of the image."""
    m = table.local_from_world
    return (
        dot(load3(m, 0), direction),
        dot(load3(m, 1), direction),
        dot(load3(m, 2), direction),
    )


@kernel
def image_place(table, direction):
    """Where a world direction lies in the image, (across, up), each from 0 to 1.

    Equirectangular as in Cycles: +Z is up, +X is in the middle and +Y left of it.
    """
    x, y, z = to_local(table, direction)
    across = HALF - math.atan2(y, x) / TWO_PI
    # More exact near the poles than an arc cosine.
    return across, ONE - math.atan2(math.sqrt(x * x + y * y), z) * INV_PI


@kernel
def load_texel(image, row, column):
    """A texel as a vec3; beyond its borders the image repeats."""
    row, column = row % image.shape[0], column % image.shape[1]
    return image[row, column, 0], image[row, column, 1], image[row, column, 2]


@called_kernel
def environment_radiance(table, direction):
    """Radiance that arrives from a unit world direction where nothing lies in its way."""
    color, image = load3(table.color, 0), table.image
    if len(image) == 0:
        return color
    across, up = image_place(table, direction)
    x = across * np.float32(image.shape[1]) - HALF
    y = up * np.float32(image.shape[0]) - HALF
    column, row = math.floor(x), math.floor(y)
    s, t = x - np.float32(column), y - np.float32(row)
    below = scale(load_texel(image, row, column), ONE - s)
    below = madd(below, s, load_texel(image, row, column + 1))
    above = scale(load_texel(image, row + 1, column), ONE - s)
    above = madd(above, s, load_texel(image, row + 1, column + 1))
    return mul(color, add(scale(below, ONE - t), scale(above, t)))


@kernel
def find_part(cdf, u):
    """(part of a distribution that holds u, how far u lies in it, float64 from 0 to 1)."""
    part = np.searchsorted(cdf, u, side="right") - 1
    low, high = np.float64(cdf[part]), np.float64(cdf[part + 1])
    return part, (u - low) / (high - low)


@called_kernel
def sample_environment(table, u):
    """A unit world direction by the brightness of the image: (direction, pdf over solid angle).

    `pdf_environment` is its twin.
    """
    row, above = find_part(table.row_cdf, u[1])
    column, across = find_part(table.column_cdf[row], u[0])
    low, high = table.row_height[row], table.row_height[row + 1]
    # In float64: near the poles z is 1 to many digits.
    z = low + above * (high - low)
    radius = math.sqrt(max(0.0, 1.0 - z * z))
    phi = math.pi * (1.0 - 2.0 * (column + across) / table.density.shape[1])
    local = (
        np.float32(radius * math.cos(phi)),
        np.float32(radius * math.sin(phi)),
        np.float32(z),
    )
    m = table.local_from_world
    direction = from_frame(load3(m, 0), load3(m, 1), load3(m, 2), local)
    return direction, pdf_environment(table, direction)


@called_kernel
def pdf_environment(table, direction):
    """Density over solid angle with which `sample_environment` returns a world direction."""
    across, up = image_place(table, direction)
    num_rows, num_columns = table.density.shape
    row = min(num_rows - 1, max(0, int(up * np.float32(num_rows))))
    column = min(num_columns - 1, max(0, int(across * np.float32(num_columns))))
    return table.density[row, column]
