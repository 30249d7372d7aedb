"""The mean of a texture over triangles, an estimate for the power of lights that show it."""

import math

import numpy as np

from .jit import kernel
from .scene import CLOSEST, COLOR_ATTRIBUTE, FACING, Scene, Textures
from .texels import linear_rgba
from .textures import TextureTable, image_value, take
from .vec import store3

# Numbers of samples in a triangle, roughly, from which the mean of a texture there is taken.
MIN_SAMPLES, MAX_SAMPLES = 16, 1024


def texture_means(scene: Scene, texture_id: int, triangle_ids: np.ndarray) -> np.ndarray:
    """(n, 3) mean value of a texture over each of some triangles.

    Triangles are sampled on a grid, one sample a texel or more; larger ones in a smaller copy of
    the image, so that every texel counts, however few samples there are.
    """
    table = TextureTable(**vars(scene.textures))
    source = table.source[texture_id]
    if table.kind[texture_id] == FACING:
        # As much from each direction as arrives at a plane of light from everywhere.
        cosines = np.sqrt((np.arange(256) + 0.5) / 256)
        mean = _take_all(table, texture_id, np.repeat(cosines, 3).reshape(-1, 3)).mean(axis=0)
        taken = np.tile(mean, (len(triangle_ids), 1))
    elif table.kind[texture_id] == COLOR_ATTRIBUTE:
        corners = scene.colors[source, triangle_ids].reshape(-1, 3)
        taken = _take_all(table, texture_id, corners).reshape(-1, 3, 3).mean(axis=1)
    else:
        uvs = scene.uvs[table.uv_map[texture_id], triangle_ids].reshape(-1, 6)
        # Copies of an object share their places in the image.
        places, copies = np.unique(uvs, axis=0, return_inverse=True)
        m = table.image_from_uv[texture_id].astype(np.float64)
        corners = places.reshape(-1, 3, 2) @ m[:, :2].T + m[:, 2]
        taken = _image_means(table, texture_id, corners)[copies.reshape(-1)]
    return table.bias[texture_id] + table.scale[texture_id] * taken


def _take_all(table: TextureTable, texture_id: int, colors: np.ndarray) -> np.ndarray:
    """(n, 3) float64, what is taken of (n, 3) colours without transparency, or (n, 4) RGBA."""
    rgba = np.ones((len(colors), 4), np.float32)
    rgba[:, : colors.shape[1]] = colors
    taken = np.empty((len(colors), 3))
    take_wave(table, texture_id, rgba, taken)
    return taken


@kernel
def take_wave(textures, texture_id, rgba, taken):
    """Write what is taken of each of some RGBA."""
    for i in range(len(rgba)):
        color = rgba[i, 0], rgba[i, 1], rgba[i, 2], rgba[i, 3]
        store3(taken, i, take(textures, texture_id, color))


def _image_means(table: TextureTable, texture_id: int, corners: np.ndarray) -> np.ndarray:
    """(n, 3) mean of what is taken over triangles with (n, 3, 2) corners in the image."""
    image, extension = table.source[texture_id], table.extension[texture_id]
    size = table.size[image]
    u, v = (corners[:, 1] - corners[:, 0]) * size, (corners[:, 2] - corners[:, 0]) * size
    num_texels = np.maximum(abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2, 1e-9)
    # The distance of samples is 2^k texels, of one texel unless that makes too many or too few.
    log_step = np.ceil(np.log2(num_texels / MAX_SAMPLES) / 2)
    log_finer = np.floor(np.log2(num_texels / MIN_SAMPLES) / 2)
    log_step = np.where(log_step > 0, log_step, np.minimum(log_finer, 0)).astype(int)
    step = 2.0 ** log_step[:, None] / size  # in the image
    step = np.maximum(step, np.ptp(corners, axis=1) / MAX_SAMPLES)  # a sliver is long, without area
    means = np.zeros((len(corners), 3))
    num_halvings, cells = 0, None
    for log_cell in np.unique(np.maximum(log_step, 0)):
        rows = np.flatnonzero(np.maximum(log_step, 0) == log_cell)
        while num_halvings < log_cell:
            cells = _halve(cells) if num_halvings else _first_halves(table, texture_id)
            num_halvings += 1
        if num_halvings:
            table, texture_id = _float_texture(cells, extension), 0
            # One sample a cell, even where their number does not divide that of texels.
            cells_size = np.array(cells.shape[1::-1])
            step[rows] = np.where(cells_size > 1, 1 / cells_size, step[rows])
        add_means_wave(table, texture_id, corners[rows], step[rows], rows, means)
    return means


@kernel
def add_means_wave(textures, texture_id, corners, step, rows, means):
    """Add to each of some rows of `means` the mean of what is taken of an image over a triangle.

    corners: (n, 3, 2); step: (n, 2) distance of the samples along x and y; both in the image.
    """
    for t in range(len(rows)):
        triangle = corners[t]
        step_x, step_y = step[t, 0], step[t, 1]
        num, row = 0, rows[t]
        lowest = min(triangle[0, 1], triangle[1, 1], triangle[2, 1])
        highest = max(triangle[0, 1], triangle[1, 1], triangle[2, 1])
        for j in range(math.floor(lowest / step_y), math.ceil(highest / step_y)):
            y = (j + 0.5) * step_y
            left, right = triangle_span(triangle, y)
            for i in range(math.ceil(left / step_x - 0.5), math.ceil(right / step_x - 0.5)):
                add_image_value(textures, texture_id, (i + 0.5) * step_x, y, row, means)
                num += 1
        if num < MIN_SAMPLES // 2:
            num += add_part_centers(textures, texture_id, triangle, row, means)
        for k in range(3):
            means[row, k] /= num


@kernel
def add_part_centers(textures, texture_id, corners, row, sums):
    """Add what is taken at points all over a triangle, of whatever shape; their number."""
    num = 0
    for i in range(MIN_SAMPLES // 2):
        for j in range(MIN_SAMPLES // 2 - i):
            b, c = (i + 1 / 3) / (MIN_SAMPLES // 2), (j + 1 / 3) / (MIN_SAMPLES // 2)
            x = (1 - b - c) * corners[0, 0] + b * corners[1, 0] + c * corners[2, 0]
            y = (1 - b - c) * corners[0, 1] + b * corners[1, 1] + c * corners[2, 1]
            add_image_value(textures, texture_id, x, y, row, sums)
            num += 1
    return num


@kernel
def triangle_span(corners, y):
    """Left and right end, at the height y, of a triangle with (3, 2) corners; 0 and 0 for none."""
    left, right = math.inf, -math.inf
    for a in range(3):
        b = (a + 1) % 3
        if (corners[a, 1] <= y) != (corners[b, 1] <= y):
            t = (y - corners[a, 1]) / (corners[b, 1] - corners[a, 1])
            x = corners[a, 0] + t * (corners[b, 0] - corners[a, 0])
            left, right = min(left, x), max(right, x)
    return (left, right) if left < right else (0.0, 0.0)


@kernel
def add_image_value(textures, texture_id, x, y, row, sums):
    """Add what is taken of an image at a point of it, of float64, to a row of sums."""
    rgba = image_value(textures, texture_id, np.float32(x), np.float32(y))
    r, g, b = take(textures, texture_id, rgba)
    sums[row, 0] += r
    sums[row, 1] += g
    sums[row, 2] += b


def _first_halves(table: TextureTable, texture_id: int) -> np.ndarray:
    """(height, width, 3) what is taken of a texture's image, at half its size, a part at a time."""
    image, divides_alpha = table.source[texture_id], table.divides_alpha[texture_id]
    first, (width, height) = table.first_texel[image], (int(n) for n in table.size[image])
    texels = table.float_texels if table.is_float[image] else table.texels
    texels = texels[first : first + width * height].reshape(height, width, 4)
    parts = np.array_split(texels, 1 + height // 512)
    halves = []
    for part in parts:
        rgba = linear_rgba(part, table.is_srgb[image], divides_alpha).reshape(-1, 4)
        taken = _take_all(table, texture_id, rgba).astype(np.float32)
        halves.append(_halve(taken.reshape(*part.shape[:2], 3)))
    return np.concatenate(halves)


def _halve(cells: np.ndarray) -> np.ndarray:
    """Means of two cells along each axis; of an odd number, of alike parts with what is between two
    of them shared out. Guthe & Heckbert 2005, Non-Power-of-Two Mipmapping."""
    for axis in (0, 1):
        cells = np.moveaxis(cells, axis, 0)
        num = len(cells)
        if num % 2 == 0:
            cells = (cells[::2] + cells[1::2]) / 2
        elif num > 1:
            half = num // 2
            shift = (np.arange(half + 1, dtype=np.float32) / half)[:, None, None]
            cells = (1 - shift[:-1]) * cells[:-1:2] + cells[1::2] + shift[1:] * cells[2::2]
            cells *= np.float32(half / num)
        cells = np.moveaxis(cells, 0, axis)
    return cells


def _float_texture(rgb: np.ndarray, extension: int) -> TextureTable:
    """A table of one texture with a linear image, its texels as they are."""
    table = Textures.empty(1, 1)
    table.extension[0], table.interpolation[0] = extension, CLOSEST
    table.size[0] = rgb.shape[1::-1]
    table.is_float[0] = True
    table.float_texels = np.pad(rgb.reshape(-1, 3), ((0, 0), (0, 1)))
    return TextureTable(*(getattr(table, name) for name in TextureTable._fields))
