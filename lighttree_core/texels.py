"""Texels as they are stored -> linear colours, as `textures.image_value` reads them."""

import numpy as np


def straight(texels: np.ndarray) -> np.ndarray:
    """(..., 4) float32 of texels, bytes from 0 to 1, their colours divided by alpha."""
    rgba = texels / np.float32(255 if texels.dtype == np.uint8 else 1)
    rgba[..., :3] /= np.where(rgba[..., 3:] == 0, 1, rgba[..., 3:])
    return rgba


def linear_rgba(texels: np.ndarray, is_srgb: bool, divides_alpha: bool = False) -> np.ndarray:
    """(..., 4) float32 of uint8 or float32 texels, their colours linear."""
    texels = straight(texels) if divides_alpha else texels
    is_byte = texels.dtype == np.uint8
    values = np.linspace(0, 1, 256, dtype=np.float32) if is_byte else texels
    curve = _decode_srgb(values) if is_srgb else values
    rgba = curve[texels] if is_byte else curve.copy()
    rgba[..., 3] = values[texels[..., 3]] if is_byte else texels[..., 3]
    return rgba


def _decode_srgb(numbers: np.ndarray) -> np.ndarray:
    """The transfer function of IEC 61966-2-1; 0 below 0."""
    numbers = np.maximum(numbers, 0)
    return np.where(numbers < 0.04045, numbers / 12.92, ((numbers + 0.055) / 1.055) ** 2.4)
