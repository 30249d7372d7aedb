"""Looks: what a surface does with light, seen from one side, as a sum of closures and emission."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lighttree_core.scene import (
    ALPHA,
    COAT_WEIGHT,
    COLOR,
    DIFFUSE,
    IOR,
    METALLIC,
    PRINCIPLED,
    ROUGHNESS,
    SPECULAR_LEVEL,
    TRANSMISSION,
    TRANSPARENT,
)

from .values import Value

ZERO, ONE = Value.of(0.0), Value.of(1.0)


class Part(NamedTuple):
    """One closure; a row of `Closures`.

    values: (column, Value) of the inputs that the kind has. normal: a normal map, None for the
    surface's own normal. height: a bump map, metres above the surface, None for no bumps.
    """

    kind: int
    values: tuple[tuple[int, Value], ...]
    weight: Value = ONE
    multiscatter: bool = False
    normal: Value | None = None
    normal_strength: float = 1.0
    height: Value | None = None
    bump_strength: float = 1.0

    def value(self, column: int) -> Value:
        """One of the inputs."""
        return dict(self.values)[column]

    @property
    def is_lambertian(self) -> bool:
        """Whether this is a matt colour, the same everywhere."""
        return (
            self.kind == DIFFUSE
            and self.normal is self.height is None
            and self.weight.texture is None
            and self.value(COLOR).texture is None
            and self.value(ROUGHNESS).is_always(0)
        )

    @property
    def is_black(self) -> bool:
        """Whether this does nothing with light but swallow it."""
        return self.kind != PRINCIPLED and self.value(COLOR).is_always(0)

    @property
    def mean_color(self) -> np.ndarray:
        """(3,) about what it sends back of light."""
        if self.kind == TRANSPARENT:
            return np.zeros(3)
        opacity = self.value(ALPHA).mean if self.kind == PRINCIPLED else 1.0
        return self.weight.mean * self.value(COLOR).mean * opacity

    @property
    def num_lobes(self) -> int:
        """How many lobes it may come to when a ray meets it."""
        if self.kind != PRINCIPLED:
            return 1
        layers = (METALLIC, 0), (TRANSMISSION, 0), (COAT_WEIGHT, 0), (ALPHA, 1)
        num = 1 + sum(not self.value(column).is_always(none) for column, none in layers)
        return num + reflects(self.value(IOR), self.value(SPECULAR_LEVEL))


class Look(NamedTuple):
    """A surface seen from one side: its closures add up. emission: W/(m^2 sr)."""

    parts: tuple[Part, ...] = ()
    emission: Value = ZERO

    @property
    def albedo(self) -> np.ndarray:
        """(3,) the matt colour, or the mean colour of whatever there is."""
        return sum((part.mean_color for part in self.parts), np.zeros(3))

    @property
    def is_lambertian(self) -> bool:
        """Whether `albedo` says all about its closures."""
        return all(part.is_lambertian for part in self.parts)


BLACK = Look()


def reflects(ior: Value, specular_level: Value) -> bool:
    """Whether plastic has a specular layer.

    At level 0, and at index 1, nothing is reflected at normal incidence, hence nowhere.
    """
    return not (specular_level.is_always(0) or ior.is_always(1))


def add(look: Look, other: Look, note) -> Look:
    """The sum of two looks; note: a function of a sentence on what is lost."""
    emission = look.emission.plus(other.emission)
    if emission is None:
        note("of several textures that emit, all but one are replaced by their means.")
        emission = look.emission.plus(Value.of(other.emission.mean))
    return Look(look.parts + other.parts, emission)


def scale(look: Look, share: Value, note) -> Look:
    """A look as far as a factor lets it through."""
    parts = [part._replace(weight=_times(part.weight, share, note)) for part in look.parts]
    parts = tuple(part for part in parts if not part.weight.is_always(0))
    return Look(parts, _times(look.emission, share, note))


def _times(inner, share, note):
    product = inner.times(share)
    if product is None:
        note("of textures that mask each other, all but the outermost are replaced by their means.")
        product = Value.of(inner.mean).times(share)
    return product


def simplify(look: Look) -> Look:
    """The same with all that is Lambertian in one part, and without what is black."""
    rest = tuple(part for part in look.parts if not (part.is_lambertian or part.is_black))
    matt = Look(tuple(part for part in look.parts if part.is_lambertian)).albedo
    if not matt.any():
        return Look(rest, look.emission)
    values = (COLOR, Value.of(matt)), (ROUGHNESS, ZERO)
    return Look((Part(DIFFUSE, values), *rest), look.emission)
