"""The formulas of Blender's Math, Mix and colour nodes, as in Cycles, for arrays of (3, N) numbers.

Each number of a result hangs on the numbers in its place alone, but for those named so. Results
that are not finite stand for 0: `converters.py` sees to it.
"""

from __future__ import annotations

import colorsys

import numpy as np


def clamp01(x):
    """x, or the nearest of 0 and 1."""
    return np.clip(x, 0.0, 1.0)


def _wrap(a, high, low):
    span = high - low
    return np.where(span == 0, low, a - span * np.floor((a - low) / span))


def _pingpong(a, b):
    turn = (a - b) / (2 * b)
    return np.abs((turn - np.floor(turn)) * 2 * b - b)


def _smooth_min(a, b, reach):
    overlap = np.maximum(reach - np.abs(a - b), 0.0)
    return np.minimum(a, b) - np.where(reach == 0, 0.0, overlap**3 / (6 * reach**2))


def _compare(a, b, reach):
    return np.abs(a - b) <= np.maximum(reach, np.finfo(np.float32).eps)


# Those of Vector Math are among them.
MATH = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: a / b,
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: np.power(a, b),
    "LOGARITHM": lambda a, b, c: np.log(a) / np.log(b),
    "SQRT": lambda a, b, c: np.sqrt(a),
    "INVERSE_SQRT": lambda a, b, c: 1 / np.sqrt(a),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(a),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: a < b,
    "GREATER_THAN": lambda a, b, c: a > b,
    "SIGN": lambda a, b, c: np.sign(a),
    "COMPARE": _compare,
    "SMOOTH_MIN": _smooth_min,
    "SMOOTH_MAX": lambda a, b, c: -_smooth_min(-a, -b, c),
    "ROUND": lambda a, b, c: np.floor(a + 0.5),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: a - np.floor(a),
    "FRACTION": lambda a, b, c: a - np.floor(a),
    "MODULO": lambda a, b, c: np.fmod(a, b),
    "FLOORED_MODULO": lambda a, b, c: np.mod(a, b),
    "WRAP": _wrap,
    "SNAP": lambda a, b, c: np.floor(a / b) * b,
    "PINGPONG": lambda a, b, c: _pingpong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(np.clip(a, -1, 1)),
    "ARCCOSINE": lambda a, b, c: np.arccos(np.clip(a, -1, 1)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.arctan2(a, b),
    "SINH": lambda a, b, c: np.sinh(a),
    "COSH": lambda a, b, c: np.cosh(a),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}


def _dot(a, b):
    return (a * b).sum(axis=0)


def _length(a):
    return np.sqrt(_dot(a, a))


def _reflect(a, b):
    n = b / _length(b)
    return a - 2 * n * _dot(n, a)


# Each of three numbers hangs on all of them.
VECTOR_MATH = {
    "CROSS_PRODUCT": lambda a, b, scale: np.cross(a, b, axis=0),
    "PROJECT": lambda a, b, scale: b * _dot(a, b) / _dot(b, b),
    "REFLECT": lambda a, b, scale: _reflect(a, b),
    "NORMALIZE": lambda a, b, scale: a / _length(a),
    "DOT_PRODUCT": lambda a, b, scale: _dot(a, b),
    "DISTANCE": lambda a, b, scale: _length(a - b),
    "LENGTH": lambda a, b, scale: _length(a),
    "SCALE": lambda a, b, scale: a * scale,
}


def _mix(t, a, b):
    return (1 - t) * a + t * b


def _overlay(t, a, b):
    dark, bright = 1 - t + 2 * t * b, 1 - t + 2 * t * (1 - b)
    return np.where(a < 0.5, a * dark, 1 - bright * (1 - a))


def _dodge(t, a, b):
    rest = 1 - t * b
    return np.where(a == 0, a, np.where(rest <= 0, 1.0, np.minimum(a / rest, 1.0)))


def _burn(t, a, b):
    rest = 1 - t + t * b
    return np.where(rest <= 0, 0.0, clamp01(1 - (1 - a) / rest))


def _soft_light(t, a, b):
    screen = 1 - (1 - b) * (1 - a)
    return _mix(t, a, (1 - a) * b * a + a * screen)


def _by_hsv(change):
    """A blend of colours; change: (t, HSV of a, HSV of b) -> (HSV of the result, its share)."""

    def blend(t, a, b):
        changed, share = change(t[0], to_hsv(a), to_hsv(b))
        return _mix(share, a, from_hsv(changed))

    return blend


def _hue(t, a, b):
    return (b[0], a[1], a[2]), np.where(b[1] == 0, 0.0, t)


def _saturation(t, a, b):
    return (a[0], _mix(t, a[1], b[1]), a[2]), np.where(a[1] == 0, 0.0, 1.0)


def _hue_and_saturation(t, a, b):
    return (b[0], b[1], a[2]), np.where(b[1] == 0, 0.0, t)


BLENDS = {
    "MIX": _mix,
    "ADD": lambda t, a, b: a + t * b,
    "MULTIPLY": lambda t, a, b: a * (1 - t + t * b),
    "SUBTRACT": lambda t, a, b: a - t * b,
    "DIVIDE": lambda t, a, b: np.where(b == 0, a, (1 - t) * a + t * a / b),
    "SCREEN": lambda t, a, b: 1 - (1 - t + t * (1 - b)) * (1 - a),
    "OVERLAY": _overlay,
    "DIFFERENCE": lambda t, a, b: _mix(t, a, np.abs(a - b)),
    "EXCLUSION": lambda t, a, b: np.maximum(_mix(t, a, a + b - 2 * a * b), 0.0),
    "DARKEN": lambda t, a, b: _mix(t, a, np.minimum(a, b)),
    "LIGHTEN": lambda t, a, b: _mix(t, a, np.maximum(a, b)),
    "DODGE": _dodge,
    "BURN": _burn,
    "SOFT_LIGHT": _soft_light,
    "LINEAR_LIGHT": lambda t, a, b: a + t * (2 * b - 1),
    "HUE": _by_hsv(_hue),
    "SATURATION": _by_hsv(_saturation),
    "COLOR": _by_hsv(_hue_and_saturation),
    "VALUE": _by_hsv(lambda t, a, b: ((a[0], a[1], _mix(t, a[2], b[2])), 1.0)),
}


def to_hsv(rgb):
    """Hue, saturation and value of colours."""
    return _convert(colorsys.rgb_to_hsv, np.maximum(rgb, 0.0))


def from_hsv(hsv):
    """The colours of hues, saturations and values."""
    h, s, v = hsv
    return _convert(colorsys.hsv_to_rgb, (h % 1.0, s, v))


def to_hsl(rgb):
    """Hue, saturation and lightness of colours."""
    h, lightness, s = _convert(colorsys.rgb_to_hls, clamp01(rgb))
    return np.array([h, s, lightness])


def from_hsl(hsl):
    """The colours of hues, saturations and lightnesses."""
    h, s, lightness = hsl
    return _convert(colorsys.hls_to_rgb, (h % 1.0, lightness, s))


def _convert(convert, colors):
    """(3, N) of three rows of N numbers, by a function of three numbers."""
    columns = zip(*(row.tolist() for row in np.broadcast_arrays(*colors)), strict=True)
    return np.transpose([convert(*color) for color in columns])


def turn_hue(hue, saturation, value, factor, rgb):
    """A colour with its hue turned by hue - 1/2 and the others scaled, mixed in by a factor."""
    h, s, v = to_hsv(rgb)
    turned = from_hsv((h + hue[0] + 0.5, clamp01(s * saturation[0]), v * value[0]))
    return np.maximum(_mix(factor, rgb, turned), 0.0)


def map_range(kind, value, from_min, from_max, to_min, to_max, steps):
    """Blender's Map Range without its clamp; kind: its interpolation."""
    x = (value - from_min) / (from_max - from_min)
    if kind == "STEPPED":
        x = np.where(steps > 0, np.floor(x * (steps + 1)) / steps, 0.0)
    elif kind == "SMOOTHSTEP":
        x = clamp01(x)
        x = x * x * (3 - 2 * x)
    elif kind == "SMOOTHERSTEP":
        x = clamp01(x)
        x = x**3 * (x * (x * 6 - 15) + 10)
    return np.where(from_max == from_min, to_min, to_min + x * (to_max - to_min))
