"""Reads shader nodes backwards from an input: what constant, and what look, arrives there?

A look is what LightTree knows of a surface seen from one side: an array of two rows, albedo and
emission, so that adding and mixing shaders is adding and mixing arrays. Whatever is not constant
is replaced by the nearest constant and noted. `materials.py` says what each shader looks like.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy
import numpy as np

from lighttree_core.scene import BACK

BLACK = np.zeros((2, 3))
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709, as Blender's colour -> value
MISSING_IMAGE = np.array([1.0, 0.0, 1.0, 1.0])  # Cycles renders magenta
IMAGE_NODES = ("ShaderNodeTexImage", "ShaderNodeTexEnvironment")


class Notes:
    """What will look different, as sentences that name everything they are true of."""

    def __init__(self):
        self._names = {}

    def add(self, name: str, text: str):
        self._names.setdefault(text, {})[name] = None

    def sentences(self) -> list[str]:
        """One for each text: the first three names, how many more there are, and the text."""
        return [f"{_list(list(names))}: {text}" for text, names in self._names.items()]


def _list(names):
    more = len(names) - 3
    return ", ".join(names[:3]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class NodeReader:
    """One node, to be asked for what arrives at its inputs.

    shaders: how each kind of shader looks: bl_idname -> function of a NodeReader; None -> for all
    others. owner: what notes name. side: FRONT or BACK, from where the surface is seen.
    groups: the group nodes that contain the node, outermost first.
    """

    node: bpy.types.Node
    shaders: dict[str | None, Callable]
    owner: str
    notes: Notes
    side: int
    groups: tuple = ()

    def note(self, text: str):
        self.notes.add(self.owner, text)

    def look(self, key) -> np.ndarray:
        """(albedo and emission, 3) of the shader that arrives at an input."""
        socket, source = self._source(key)
        if not socket.is_output:
            return BLACK
        return self.shaders.get(source.node.bl_idname, self.shaders[None])(source)

    def color(self, key) -> np.ndarray:
        """(3,) linear Rec.709 that arrives at an input; what is not constant is noted."""
        socket, source = self._source(key)
        value = source._constant(socket)
        if value is None and source.node.bl_idname in IMAGE_NODES:
            value = source._image_mean(socket)
        if value is None:
            own = self.node.inputs[key]
            value = _plain(own.default_value)
            used = ", ".join(f"{number:.3g}" for number in np.ravel(value))
            self.note(
                f"{own.name} of {self.node.name} comes from {source.node.name}, "
                f"which is not modelled; {used} is used."
            )
        return np.broadcast_to(value, 3)

    def number(self, key) -> float:
        """The number that arrives at an input; of a colour, its luminance."""
        return float(self.color(key) @ LUMINANCE)

    def is_constant(self, key, number: float) -> bool:
        """Whether an input is this very number, or a colour or vector of it."""
        socket, source = self._source(key)
        value = source._constant(socket)
        return value is not None and bool(np.all(value == number))

    def _constant(self, socket):
        """What a socket of this node yields, a number or an array; None if it varies."""
        if not socket.is_output or self.node.bl_idname in ("ShaderNodeRGB", "ShaderNodeValue"):
            return _plain(socket.default_value)
        if self.node.bl_idname == "ShaderNodeNewGeometry" and socket.name == "Backfacing":
            return float(self.side == BACK)
        return None

    def _image_mean(self, socket):
        """The mean colour, or alpha, of an image; of an environment, over all directions."""
        image = self.node.image
        if image is None or 0 in image.size:
            path = image.filepath if image else "(none chosen)"
            self.note(f"missing image file {path} in {self.node.name} is rendered as magenta.")
            mean = MISSING_IMAGE
        else:
            self.note(f"image {image.name} in {self.node.name} is replaced by its mean.")
            mean = _mean(image, getattr(self.node, "projection", "") == "EQUIRECTANGULAR")
        return mean[3] if socket.name == "Alpha" else mean[:3]

    def _source(self, key):
        """The socket that an input takes its value from, and the reader of that socket's node.

        Reroutes, muted nodes and the borders of groups are passed. Where the way ends at an input,
        that input's own value counts.
        """
        socket, groups = self.node.inputs[key], self.groups
        while not socket.is_output:
            link = next((x for x in socket.links if x.is_valid and not x.is_muted), None)
            origin = link and _before(link.from_socket, groups)
            if origin is None:
                break
            socket, groups = origin
        return socket, replace(self, node=socket.node, groups=groups)


def _before(socket, groups):
    """Where an output gets its value: itself, or an input further back; None at a dead end."""
    node = socket.node
    if node.mute:
        passed = next((x for x in node.internal_links if x.to_socket == socket), None)
        return passed and (passed.from_socket, groups)
    if node.bl_idname == "NodeReroute":
        return node.inputs[0], groups
    if node.bl_idname == "NodeGroupInput":
        return _twin(socket, groups[-1].inputs), groups[:-1]
    if node.bl_idname == "ShaderNodeGroup":
        inside = node.node_tree.nodes if node.node_tree else ()
        ends = [x for x in inside if x.bl_idname == "NodeGroupOutput" and x.is_active_output]
        return (_twin(socket, ends[0].inputs), (*groups, node)) if ends else None
    return socket, groups


def _twin(socket, sockets):
    """The socket of the same identifier on the other side of a group's border."""
    return next(other for other in sockets if other.identifier == socket.identifier)


def _plain(value):
    """A socket's value as a float or a (3,) array."""
    return float(value) if isinstance(value, (bool, int, float)) else np.array(value[:3])


def _mean(image, equirectangular):
    """(4,) mean of an image, RGB in linear Rec.709 and alpha.

    Blender hands out floats as linear, bytes in the colour space of the file. Of bytes, which have
    no bright spots that a mean hangs on, a grid of at least 512 x 512 pixels is enough.
    """
    (width, height), channels = image.size, image.channels
    pixels = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(pixels)
    step = 1 if image.is_float else max(1, min(width, height) // 512)
    rows = pixels.reshape(height, width, channels)[::step, ::step]
    rgb = rows[..., :3] if channels > 2 else np.repeat(rows[..., :1], 3, axis=2)
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        # The transfer function of IEC 61966-2-1.
        rgb = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    # A row of an equirectangular image covers a ring, as long as the cosine of its latitude.
    latitudes = ((np.arange(len(rows)) + 0.5) / len(rows) - 0.5) * np.pi
    weights = np.cos(latitudes) if equirectangular else None
    alpha = rows[..., 3].mean(dtype=np.float64) if channels == 4 else 1.0
    return np.append(np.average(rgb.mean(axis=1, dtype=np.float64), axis=0, weights=weights), alpha)
