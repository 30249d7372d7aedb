"""The report's pictures as data URIs: JPEG for what is looked at, PNG for tiles, RGBE for HDR."""

import base64
import io

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.image import imsave

from .metrics import luminance

ERROR_COLORS, FLIP_COLORS, TILE_COLORS = "viridis", "magma", "RdBu_r"
MAX_Z = 6  # standard errors
MIN_ERROR, MAX_ERROR = 0.01, 3.0  # the ends of the error maps' colours, on a log scale
PICTURE_PX, THUMBNAIL_PX = 640, 192  # the largest widths


def data_uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def pick_exposure_ev(rgb: np.ndarray) -> float:
    """Stops, in halves, that show nine of ten pixels below clipping (and no black image)."""
    bright = np.percentile(luminance(rgb), 90)
    return float(np.clip(np.round(2 * np.log2(0.7 / max(bright, 1e-12))) / 2, -20, 20))


def draw_image(rgb: np.ndarray, exposure_ev: float) -> str:
    """sRGB JPEG of linear Rec. 709, clipped at white."""
    linear = np.clip(rgb * 2.0**exposure_ev, 0, 1)
    return draw_pixels(
        np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    )


def draw_thumbnail(rgb: np.ndarray) -> str:
    """A small picture at the exposure of `pick_exposure_ev`, of the means of its pixels."""
    step = min(-(-rgb.shape[1] // THUMBNAIL_PX), rgb.shape[0])
    height, width = (size // step * step for size in rgb.shape[:2])
    blocks = rgb[:height, :width].reshape(height // step, step, width // step, step, 3)
    return draw_image(blocks.mean(axis=(1, 3)), pick_exposure_ev(rgb))


def draw_error_map(relative_error: np.ndarray) -> str:
    return draw_pixels(color_error(relative_error))


def draw_flip_map(flip: np.ndarray) -> str:
    return draw_pixels(color_flip(flip))


def color_error(relative_error: np.ndarray) -> np.ndarray:
    low, high = np.log10([MIN_ERROR, MAX_ERROR])
    return apply_colors(np.log10(np.maximum(relative_error, 1e-9)), ERROR_COLORS, low, high)


def color_flip(flip: np.ndarray) -> np.ndarray:
    return apply_colors(flip, FLIP_COLORS, 0, 1)


def draw_tile_map(tile_z: np.ndarray) -> str:
    return draw_pixels(apply_colors(tile_z, TILE_COLORS, -MAX_Z, MAX_Z), "png")


def apply_colors(values: np.ndarray, colors: str, low: float, high: float) -> np.ndarray:
    """(H, W, 3) sRGB of an (H, W) map; values outside low to high get the end colours."""
    return colormaps[colors]((values - low) / (high - low))[..., :3]


def draw_pixels(srgb: np.ndarray, kind: str = "jpeg") -> str:
    """Picture of (H, W, 3) in 0 to 1; a wide one keeps every n-th pixel, for a mean hides noise."""
    step = -(-srgb.shape[1] // PICTURE_PX)
    file, pixels = io.BytesIO(), np.round(255 * srgb[::step, ::step]).astype(np.uint8)
    options = {"quality": 90, "subsampling": 0} if kind == "jpeg" else {}
    imsave(file, pixels, format=kind, pil_kwargs=options)
    return data_uri(file.getvalue(), f"image/{kind}")


def gradient(colors: str) -> str:
    """A colour map as a CSS background, for legends."""
    stops = (to_hex(color) for color in colormaps[colors](np.linspace(0, 1, 9)))
    return f"linear-gradient(90deg, {', '.join(stops)})"


def encode_rgbe(rgb: np.ndarray) -> str:
    """Radiance's shared exponent, 4 bytes a pixel and 0.4 % exact, as the flip book reads it."""
    _, exponent = np.frexp(np.maximum(rgb.max(axis=2), 1e-30))
    mantissa = np.clip(np.round(np.ldexp(rgb, 8 - exponent[..., None])), 0, 255)
    rgbe = np.concatenate([mantissa, exponent[..., None] + 128], axis=2).astype(np.uint8)
    return data_uri(rgbe.tobytes(), "application/octet-stream")
