"""What arrives at the input of a node: a constant, or a texture times one constant plus another.

Such a value is one row of `Textures`. Whatever nodes do to it is again of that form, as a texture's
numbers may each go through a curve; what hangs on two textures, or mixes the three numbers of one
in a way that is no line, is known of its mean alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lighttree_core.scene import (
    BLUE,
    COLOR_ATTRIBUTE,
    FACING,
    GREEN,
    IMAGE_TEXTURE,
    LINEAR,
    LUMINANCE_OF_RGB,
    OPACITY,
    RED,
    REPEAT,
    RGB,
)

Triple = tuple[float, float, float]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709, as Blender's colour -> value
CHANNELS = (RED, GREEN, BLUE)
NUMBER_SOCKETS = ("VALUE", "INT", "BOOLEAN")
# Where curves are known: at the 256 numbers that bytes can hold.
STEPS = np.linspace(0.0, 1.0, 256)


def triple(numbers) -> Triple:
    """Three Python floats, of one number or of three."""
    return tuple(np.broadcast_to(numbers, 3).astype(float).tolist())


class Projection(NamedTuple):
    """A UV map made of places: those of the object itself or "Generated", from 0 to 1 in its box.

    matrix: 2 rows of 4, (u, v) of (x, y, z, 1).
    """

    space: str
    matrix: tuple = ()


@dataclass(frozen=True)
class Texture:
    """An image, attribute or cosine and what is taken of it; fields as in `Textures`.

    source: a row of `ImageTable`, or the name of an attribute and its part, see `meshes.py`.
    uv_map: a name, "" for the map that the mesh is rendered with, or a Projection. mean_rgba: of
    all its texels. samples: RGBA of some of them, for means of curves. low, high: no number that is
    taken lies beyond these before it goes through the curve. curve: what it is at each of `STEPS`,
    () for what it was.
    """

    kind: int = IMAGE_TEXTURE
    source: int | tuple[str, str] = 0
    mean_rgba: tuple = (0.5, 0.5, 0.5, 1.0)
    samples: tuple = ((0.5, 0.5, 0.5, 1.0),)
    low: float = 0.0
    high: float = 1.0
    uv_map: str | Projection = ""
    image_from_uv: tuple = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    extension: int = REPEAT
    interpolation: int = LINEAR
    output: int = RGB
    divides_alpha: bool = False
    curve: tuple[Triple, ...] = ()

    @property
    def mean(self) -> np.ndarray:
        """(3,) mean of what is taken."""
        if self.curve:
            return self.take(np.array(self.samples)).mean(axis=0)
        return self.take(np.array(self.mean_rgba))

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest number that may be taken."""
        numbers = self.curve or (self.low, self.high)
        return float(np.min(numbers)), float(np.max(numbers))

    @property
    def uncurved(self) -> Texture:
        """The same without its curve."""
        return replace(self, curve=())

    def take(self, colors: np.ndarray) -> np.ndarray:
        """(..., 3) what is taken of (..., 3) or (..., 4) colours."""
        rgb = colors[..., :3]
        if self.output in CHANNELS:
            number = rgb[..., CHANNELS.index(self.output)]
        elif self.output == OPACITY:
            number = colors[..., 3]
        elif self.output == LUMINANCE_OF_RGB:
            number = rgb @ LUMINANCE
        if self.output != RGB:
            rgb = np.repeat(number[..., None], 3, axis=-1)
        return self.through_curve(rgb)

    def through_curve(self, numbers: np.ndarray) -> np.ndarray:
        """(..., 3) what the curve makes of each of (..., 3) numbers."""
        if not self.curve:
            return numbers
        columns = zip(np.moveaxis(numbers, -1, 0), np.transpose(self.curve), strict=True)
        return np.stack([np.interp(x, STEPS, column) for x, column in columns], axis=-1)


@dataclass(frozen=True)
class Value:
    """bias + scale x what is taken of a texture; without a texture the constant `bias`."""

    bias: Triple
    scale: Triple = (0.0, 0.0, 0.0)
    texture: Texture | None = None

    @classmethod
    def of(cls, numbers) -> Value:
        """A constant, of one number or of three."""
        return cls(triple(numbers))

    @property
    def mean(self) -> np.ndarray:
        """(3,) the constant, or the mean of what varies."""
        return self.at(self.texture.mean if self.texture else 0.0)

    def at(self, taken) -> np.ndarray:
        """(3,) where this is taken of the texture."""
        return np.array(self.bias) + np.array(self.scale) * taken

    def is_always(self, number: float) -> bool:
        """Whether this is a constant, and that number."""
        return self.texture is None and all(x == number for x in self.bias)

    @property
    def is_by_angle(self) -> bool:
        """Whether this hangs on how much a surface faces the ray."""
        return self.texture is not None and self.texture.kind == FACING

    def within(self, low: float, high: float) -> Value:
        """The same between two numbers; what is taken as it is of a texture is clamped where
        used."""
        if self.texture and not self.texture.curve:
            return self
        return fold(lambda numbers: np.clip(numbers, low, high), [self])

    def times(self, other: Value) -> Value | None:
        """The product, None where two textures meet."""
        if self.texture and other.texture:
            return fold(np.multiply, [self, other])
        varying, constant = (self, other) if self.texture else (other, self)
        factor = np.array(constant.bias)
        return _value(varying.bias * factor, varying.scale * factor, varying.texture)

    def plus(self, other: Value) -> Value | None:
        """The sum, None where two different textures meet."""
        if self.texture and other.texture and self.texture != other.texture:
            return fold(np.add, [self, other])
        bias, scale = np.add(self.bias, other.bias), np.add(self.scale, other.scale)
        return _value(bias, scale, self.texture or other.texture)

    def channel(self, index: int) -> Value:
        """One of the three numbers."""
        texture = self.texture
        if texture and texture.output == RGB:
            texture = replace(texture, output=CHANNELS[index])
        if texture and texture.curve:
            curve = tuple((rgb[index],) * 3 for rgb in texture.curve)
            texture = replace(texture, curve=curve)
        return _value(self.bias[index], self.scale[index], texture)

    def as_number(self, from_type: str) -> Value | None:
        """One number, as Cycles converts colours and vectors; None where no row can say it."""
        weights = LUMINANCE if from_type == "RGBA" else np.full(3, 1 / 3)
        if self.texture and self.texture.curve:
            return fold(lambda numbers: weights @ numbers, [self])
        bias, scale = self.bias @ weights, self.scale * weights
        if self.texture is None or self.texture.output != RGB:
            return _value(bias, scale.sum(), self.texture)
        in_use = np.flatnonzero(scale)
        if len(in_use) < 2:
            return _value(bias, scale.sum(), self.channel(in_use[0] if len(in_use) else 0).texture)
        if from_type == "RGBA" and len(set(self.scale)) == 1:
            texture = replace(self.texture, output=LUMINANCE_OF_RGB)
            return _value(bias, self.scale[0], texture)
        return None


def _value(bias, scale, texture) -> Value:
    """A Value, constant where the texture has no share in it."""
    is_constant = texture is None or not np.any(scale)
    if texture and texture.curve and np.ptp(texture.curve, axis=0).max() == 0:
        bias, is_constant = np.add(bias, np.multiply(scale, texture.curve[0])), True
    return Value.of(bias) if is_constant else Value(triple(bias), triple(scale), texture)


def combine(red: Value, green: Value, blue: Value) -> Value | None:
    """A colour of three numbers; None unless one texture holds all that varies in its place."""
    parts = red, green, blue
    if any(part.texture and part.texture.curve for part in parts):
        return fold(lambda *numbers: np.array([x[0] for x in numbers]), parts)
    textures = {part.texture for part in parts if part.texture}
    bias = [part.bias[0] for part in parts]
    scale = [part.scale[0] for part in parts]
    if len(textures) < 2:
        texture = next(iter(textures), None)
        return _value(bias, scale, texture)
    whole = {replace(texture, output=RGB) for texture in textures}
    in_place = all(
        part.texture is None or part.texture.output == CHANNELS[index]
        for index, part in enumerate(parts)
    )
    return _value(bias, scale, whole.pop()) if in_place and len(whole) == 1 else None


def by_angle(numbers: np.ndarray) -> Value:
    """What hangs on how much a surface faces the ray; numbers: at each cosine of `STEPS`."""
    # As much from each direction as arrives at a plane of light from everywhere.
    cosines = np.sqrt((np.arange(64) + 0.5) / 64)
    samples = tuple((cosine, cosine, cosine, 1.0) for cosine in cosines.tolist())
    texture = Texture(kind=FACING, samples=samples)
    return _along_curve(texture, np.repeat(numbers, 3).reshape(-1, 3))


def _along_curve(texture, numbers):
    """What a texture yields once it goes through a curve, (len(STEPS), 3)."""
    curve = tuple(map(tuple, numbers.tolist()))
    return _value(np.zeros(3), np.ones(3), replace(texture, curve=curve))


def fold(function, values: Sequence[Value]) -> Value | None:
    """function(*values), each number of it by itself; None if no row of a table can say it.

    function: of (3, N) arrays, N times three numbers. It is tried over the range of the texture: a
    row can say what is a line there, or else, from 0 to 1, what is a curve of each number.
    """
    textures = {value.texture.uncurved for value in values if value.texture}
    if not textures:
        return Value.of(np.ravel(function(*(np.array(value.bias)[:, None] for value in values))))
    if len(textures) > 1:
        return None
    texture = textures.pop()

    def results(taken):
        """(N, 3) of (N, 3) numbers that are taken before any curve."""
        inputs = [
            v.at(v.texture.through_curve(taken) if v.texture else np.zeros_like(taken)).T
            for v in values
        ]
        return np.broadcast_to(np.asarray(function(*inputs), float), taken.T.shape).T

    if not any(value.texture.curve for value in values if value.texture):
        line = _fold_line(texture, results)
        if line:
            return line
    return _fold_curve(texture, results)


def _fold_line(texture, results):
    """The Value that is a line of what is taken; None if there is none."""
    taken = texture.low + (texture.high - texture.low) * _trials(texture)
    found = results(taken)
    # The first two trials are the ends of the range.
    width = texture.high - texture.low
    slope = (found[1] - found[0]) / width if width > 0 else np.zeros(3)
    bias = found[0] - slope * texture.low
    return _value(bias, slope, texture) if _is_near(found, bias + slope * taken) else None


def _fold_curve(texture, results):
    """The Value that is a curve of what is taken; None where there is more than from 0 to 1, or
    where three numbers hang on each other."""
    numbers = results(np.repeat(STEPS, 3).reshape(-1, 3))
    # Of attributes the range is not known.
    if texture.kind == COLOR_ATTRIBUTE or not 0 <= texture.low <= texture.high <= 1:
        beyond = np.repeat([min(texture.low, -1.0), max(texture.high, 2.0)], 3).reshape(-1, 3)
        if not _is_near(results(beyond), numbers[[0, -1]]):
            return None
    if texture.output == RGB and texture.kind != FACING:
        rows = np.random.default_rng(7).integers(len(STEPS), size=(64, 3))
        expected = np.take_along_axis(numbers, rows, axis=0)
        if not _is_near(results(STEPS[rows]), expected):
            return None
    return _along_curve(texture, numbers)


def _is_near(a, b):
    return np.abs(a - b).max() <= 1e-6 * max(1.0, np.abs(a).max())


def _trials(texture):
    """(N, 3) numbers to try: both ends, the way between them, for colours the box of both."""
    steps = np.linspace(0.0, 1.0, 65)[:, None] * np.ones(3)
    trials = np.concatenate([steps[[0, -1]], steps])
    if texture.output == RGB:
        trials = np.concatenate([trials, np.random.default_rng(7).random((64, 3))])
    return trials
