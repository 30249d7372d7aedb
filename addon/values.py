"""What arrives at the input of a node: a constant, or a texture times one constant plus another.

Such a value is one row of `Textures`, so whatever nodes do to it is either again of that form, or
known of its mean alone. Curves over how much a surface faces the ray are tables, which can say
whatever nodes do to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lighttree_core.scene import (
    BLUE,
    EXTEND,
    FACING_CURVE,
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
# Cosines between ray and normal at which curves are known.
COSINES = np.linspace(0.0, 1.0, 513)


def triple(numbers) -> Triple:
    """Three Python floats, of one number or of three."""
    return tuple(np.broadcast_to(numbers, 3).astype(float).tolist())


@dataclass(frozen=True)
class Texture:
    """An image, attribute or curve and what is taken of it; fields as in `Textures`.

    source: a row of `ImageTable`; or the name of an attribute and its part, see `meshes.py`; or, of
    a curve, a colour for each of `COSINES`.
    uv_map: a name, "" for the map that the mesh is rendered with. mean_rgba: of all its texels.
    low, high: no number that is taken lies beyond these.
    """

    kind: int = IMAGE_TEXTURE
    source: int | tuple[str, str] | tuple[Triple, ...] = 0
    mean_rgba: tuple = (0.5, 0.5, 0.5, 1.0)
    low: float = 0.0
    high: float = 1.0
    uv_map: str = ""
    image_from_uv: tuple = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    extension: int = REPEAT
    interpolation: int = LINEAR
    output: int = RGB
    divides_alpha: bool = False

    @property
    def mean(self) -> np.ndarray:
        """(3,) mean of what is taken."""
        if self.output == OPACITY:
            return np.full(3, self.mean_rgba[3])
        return self.take(np.array(self.mean_rgba[:3]))

    def take(self, rgb: np.ndarray) -> np.ndarray:
        """(..., 3) what is taken of (..., 3) colours."""
        if self.output == RGB:
            return rgb
        if self.output in CHANNELS:
            taken = rgb[..., CHANNELS.index(self.output)]
        else:
            taken = rgb @ LUMINANCE
        return np.repeat(taken[..., None], 3, axis=-1)


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
        """Whether this is a curve over how much a surface faces the ray."""
        return self.texture is not None and self.texture.kind == FACING_CURVE

    def within(self, low: float, high: float) -> Value:
        """The same between two numbers, but for images and attributes, which are clamped where
        used."""
        if self.texture and not self.is_by_angle:
            return self
        return fold(lambda numbers: np.clip(numbers, low, high), [self])

    def times(self, other: Value) -> Value | None:
        """The product, None where two textures meet."""
        if self.is_by_angle and other.is_by_angle:
            return fold(np.multiply, [self, other])
        if self.texture and other.texture:
            return None
        varying, constant = (self, other) if self.texture else (other, self)
        factor = np.array(constant.bias)
        return _value(varying.bias * factor, varying.scale * factor, varying.texture)

    def plus(self, other: Value) -> Value | None:
        """The sum, None where two different textures meet."""
        if self.is_by_angle and other.is_by_angle:
            return fold(np.add, [self, other])
        if self.texture and other.texture and self.texture != other.texture:
            return None
        bias, scale = np.add(self.bias, other.bias), np.add(self.scale, other.scale)
        return _value(bias, scale, self.texture or other.texture)

    def channel(self, index: int) -> Value:
        """One of the three numbers."""
        texture = self.texture
        if texture and texture.output == RGB:
            texture = replace(texture, output=CHANNELS[index])
        return _value(self.bias[index], self.scale[index], texture)

    def as_number(self, from_type: str) -> Value | None:
        """One number, as Cycles converts colours and vectors; None where no row can say it."""
        weights = LUMINANCE if from_type == "RGBA" else np.full(3, 1 / 3)
        if self.is_by_angle:
            return fold(lambda numbers: numbers @ weights, [self])
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
    return Value.of(bias) if is_constant else Value(triple(bias), triple(scale), texture)


def combine(red: Value, green: Value, blue: Value) -> Value | None:
    """A colour of three numbers; None unless one texture holds all that varies in its place."""
    parts = red, green, blue
    if any(part.is_by_angle for part in parts):
        return fold(lambda *numbers: [part[0] for part in numbers], parts)
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


def by_angle(colors) -> Value:
    """A curve over how much a surface faces the ray; colors: (len(COSINES),) or (..., 3)."""
    colors = np.asarray(colors, float)
    if colors.ndim == 1:
        colors = np.repeat(colors[:, None], 3, axis=1)
    if np.ptp(colors, axis=0).max() == 0:
        return Value.of(colors[0])
    num = len(COSINES)
    texture = Texture(
        kind=FACING_CURVE,
        source=tuple(map(tuple, colors.tolist())),
        # Of light from everywhere, as much as the cosine comes from each direction.
        mean_rgba=(*np.average(colors, axis=0, weights=COSINES).tolist(), 1.0),
        low=float(colors.min()),
        high=float(colors.max()),
        image_from_uv=((1 - 1 / num, 0.0, 0.5 / num), (0.0, 0.0, 0.5)),  # to centres of texels
        extension=EXTEND,
    )
    return Value((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), texture)


def fold(function, values: Sequence[Value]) -> Value | None:
    """function(*values), each number of it by itself; None if no row of a table can say it.

    function: of arrays of three numbers. It is tried over the range of the texture: what a row
    cannot say is what is not a line there.
    """
    textures = {value.texture for value in values if value.texture}
    if not textures:
        return Value.of(function(*(np.array(value.bias) for value in values)))
    if all(texture.kind == FACING_CURVE for texture in textures):
        curves = [_curve(value) for value in values]
        return by_angle([np.broadcast_to(function(*x), 3) for x in zip(*curves, strict=True)])
    if len(textures) > 1:
        return None
    texture = textures.pop()
    taken = _trials(texture)
    results = np.array(
        [np.broadcast_to(function(*(v.at(x) for v in values)), 3) for x in taken], float
    )
    # The first two trials are the ends of the range.
    width = texture.high - texture.low
    slope = (results[1] - results[0]) / width if width > 0 else np.zeros(3)
    bias = results[0] - slope * texture.low
    error = np.abs(results - (bias + slope * taken)).max()
    if not error <= 1e-6 * max(1.0, np.abs(results).max()):
        return None
    return _value(bias, slope, texture)


def _curve(value):
    """(len(COSINES), 3) of a curve, or of a constant."""
    taken = value.texture.take(np.array(value.texture.source)) if value.texture else 0.0
    return np.broadcast_to(value.at(taken), (len(COSINES), 3))


def _trials(texture):
    """(N, 3) numbers to try: both ends, the way between them, for colours the box of both."""
    steps = np.linspace(0.0, 1.0, 65)[:, None] * np.ones(3)
    trials = np.concatenate([steps[[0, -1]], steps])
    if texture.output == RGB:
        trials = np.concatenate([trials, np.random.default_rng(7).random((64, 3))])
    return texture.low + (texture.high - texture.low) * trials
