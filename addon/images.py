"""Blender's images -> texels, each image once.

Blender hands bytes out as they are in the file, of floats the linear ones it has made of them;
bytes with straight alpha, floats with colours already multiplied by it. Cycles interpolates colours
multiplied by alpha, and divides them by it where a material uses the alpha.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lighttree_core.scene import Textures
from lighttree_core.texels import linear_rgba, straight

LINEAR_SPACES = ("Linear Rec.709", "Non-Color", "Linear", "Raw")
CHUNK_SIZE = 1 << 22  # numbers that are rounded to bytes together


@dataclass(frozen=True)
class Image:
    """Texels, from the lower left one, row by row: (N, 4) uint8 or float32 RGBA.

    means: four linear means, and those of colours divided by alpha; samples: RGBA of some texels,
    likewise; low, high: no number of it lies beyond these, divided or not.
    """

    width: int
    height: int
    is_srgb: bool
    texels: np.ndarray
    means: tuple = ()
    samples: tuple = ()
    low: float = 0.0
    high: float = 1.0


class ImageTable:
    """Gathers images; each becomes one row of the images in `Textures`."""

    def __init__(self):
        self.images, self.rows = [], {}

    def row(self, image) -> int:
        """The row of an image, which is read when it is first met."""
        key = image.as_pointer()
        if key not in self.rows:
            self.rows[key] = len(self.images)
            self.images.append(_describe(image, _read_texels(image)))
        return self.rows[key]

    def curve_row(self, colors: tuple) -> int:
        """The row of an image that holds a curve, a row of linear (r, g, b)."""
        if colors not in self.rows:
            self.rows[colors] = len(self.images)
            texels = np.pad(np.float32(colors), ((0, 0), (0, 1)))
            self.images.append(Image(len(colors), 1, False, texels))
        return self.rows[colors]

    def __getitem__(self, row: int) -> Image:
        return self.images[row]

    def fill(self, textures: Textures) -> None:
        """Write the images to their columns of a table."""
        images = self.images
        textures.size = np.array([(i.width, i.height) for i in images], np.int32).reshape(-1, 2)
        textures.is_srgb = np.array([i.is_srgb for i in images], bool)
        textures.is_float = np.array([i.texels.dtype == np.float32 for i in images], bool)
        textures.first_texel = np.zeros(len(images), np.int64)
        for is_float, name in ((False, "texels"), (True, "float_texels")):
            rows = np.flatnonzero(textures.is_float == is_float)
            counts = [len(images[row].texels) for row in rows]
            textures.first_texel[rows] = np.cumsum(counts) - counts
            if counts:
                setattr(textures, name, np.concatenate([images[row].texels for row in rows]))


def is_missing(image) -> bool:
    """Whether there is nothing to read."""
    return image is None or 0 in image.size


def color_space(image) -> str:
    """The name of the colour space that an image's file is in."""
    return image.colorspace_settings.name


def is_data(image) -> bool:
    """Whether an image's numbers are not colours."""
    return image.colorspace_settings.is_data


def is_associated(image) -> bool:
    """Whether an image's colours are rendered multiplied by its alpha."""
    return not is_data(image) and image.alpha_mode in ("STRAIGHT", "PREMUL")


def _read_texels(image):
    """(N, 4) uint8 or float32 RGBA, colours multiplied by alpha where they are in Cycles."""
    size, channels = image.size[0] * image.size[1], image.channels
    pixels = np.empty(size * channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(size, channels)
    texels = np.empty((size, 4), np.float32 if image.is_float else np.uint8)
    step = CHUNK_SIZE // 4
    for first in range(0, size, step):
        rgba = _as_rgba(pixels[first : first + step], image.alpha_mode)
        if image.is_float:
            rgba[~np.isfinite(rgba).all(axis=1)] = 0  # as in Cycles
        else:
            rgba = np.rint(np.clip(rgba, 0, 1) * 255)
            if is_associated(image):
                rgba[:, :3] = np.floor(rgba[:, :3] * rgba[:, 3:] / 255)  # Cycles does not round
        texels[first : first + step] = rgba
    return texels


def _as_rgba(pixels, alpha_mode):
    """(n, 4) of one to four channels: grey, grey and alpha, colour, colour and alpha."""
    rgba = np.ones((len(pixels), 4), np.float32)
    channels = pixels.shape[1]
    rgba[:, :3] = pixels[:, :3] if channels > 2 else pixels[:, :1]
    if channels in (2, 4) and alpha_mode != "NONE":
        rgba[:, 3] = pixels[:, -1]
    return rgba


def _describe(image, texels):
    width, height = image.size
    is_srgb = not image.is_float and color_space(image) not in LINEAR_SPACES
    low, high = 0.0, 1.0
    if image.is_float:
        ends = [end for rgba in (texels, straight(texels)) for end in (rgba.min(), rgba.max())]
        low, high = min(0.0, float(min(ends))), max(0.0, float(max(ends)))
    pixels = texels.reshape(height, width, 4)
    ways = (False, True) if is_associated(image) else (False,)
    means = [tuple(mean_rgba(pixels, is_srgb, divides_alpha=way).tolist()) for way in ways]
    rows, columns = (np.linspace(0, n - 1, min(n, 16)).astype(int) for n in (height, width))
    some = pixels[np.ix_(rows, columns)].reshape(-1, 4)
    samples = [tuple(map(tuple, linear_rgba(some, is_srgb, way).tolist())) for way in ways]
    # Without alpha to divide by, both are the same.
    return Image(
        width, height, is_srgb, texels, (means[0], means[-1]), (samples[0], samples[-1]), low, high
    )


def mean_rgba(
    texels, is_srgb: bool, equirectangular: bool = False, divides_alpha: bool = False
) -> np.ndarray:
    """(4,) linear mean of (H, W, 4) texels, or over all directions.

    Of bytes, which have no bright spots that a mean hangs on, a grid of at least 512 x 512 pixels
    is enough.
    """
    height, width = texels.shape[:2]
    is_float = texels.dtype == np.float32
    step = 1 if is_float else max(1, min(width, height) // 512)
    texels = texels[::step, ::step]
    rgba = linear_rgba(texels, is_srgb, divides_alpha)
    # A row of an equirectangular image covers a ring, as long as the cosine of its latitude.
    latitudes = ((np.arange(len(rgba)) + 0.5) / len(rgba) - 0.5) * np.pi
    weights = np.cos(latitudes) if equirectangular else None
    return np.average(rgba.mean(axis=1, dtype=np.float64), axis=0, weights=weights)
