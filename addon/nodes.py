"""Reads shader nodes backwards from an input: which value, and which look, arrives there?

A value is a constant or a texture, see `values.py`; a look is what a surface does seen from one
side, see `looks.py`. Whatever is neither is replaced by the nearest constant and noted.
`converters.py` and `image_nodes.py` say what nodes yield, `shaders.py` what each shader looks like.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from .converters import CONVERTERS
from .image_nodes import IMAGE_NODES
from .images import ImageTable
from .looks import BLACK, Look
from .values import LUMINANCE, NUMBER_SOCKETS, Value

OUTPUTS = CONVERTERS | IMAGE_NODES


class Notes:
    """What will look different, as sentences that name everything they are true of."""

    def __init__(self):
        self._names = {}

    def add(self, name: str, text: str):
        self._names.setdefault(text, {})[name] = None

    def items(self) -> list[tuple[list[str], str]]:
        """(names, what is true of them), in the order in which it was found."""
        return [(list(names), text) for text, names in self._names.items()]

    def sentences(self) -> list[str]:
        """One for each text: the first three names, how many more there are, and the text."""
        return [f"{_list(names)}: {text}" for names, text in self.items()]


def _list(names):
    more = len(names) - 3
    return ", ".join(names[:3]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class NodeReader:
    """One node, to be asked for what arrives at its inputs.

    Inputs are named by their identifiers, which differ from their names where these are shown
    otherwise in one version of Blender, or occur twice; or by their position.

    shaders: how each kind of shader looks: bl_idname -> function of a NodeReader; None -> for all
    others. owner: what notes name. side: FRONT or BACK, from where the surface is seen.
    groups: the group nodes that contain the node, outermost first. known: what outputs of nodes
    yield, so that nodes in common are read once.
    """

    node: bpy.types.Node
    shaders: dict[str | None, Callable]
    owner: str
    notes: Notes
    side: int
    images: ImageTable = field(default_factory=ImageTable)
    groups: tuple = ()
    known: dict = field(default_factory=dict)

    def note(self, text: str):
        self.notes.add(self.owner, text)

    def input(self, key) -> bpy.types.NodeSocket:
        """An input by its identifier or position."""
        inputs = self.node.inputs
        return (
            inputs[key] if isinstance(key, int) else next(x for x in inputs if x.identifier == key)
        )

    def has_input(self, key: str) -> bool:
        """Whether the node has such an input in this version of Blender."""
        return any(socket.identifier == key for socket in self.node.inputs)

    def source(self, key) -> tuple[bpy.types.NodeSocket, NodeReader]:
        """The socket that an input takes its value from, and the reader of that socket's node.

        Reroutes, muted nodes and the borders of groups are passed. Where the way ends at an input,
        that input's own value counts.
        """
        socket, source, _ = self._trace(key)
        return socket, source

    def bent_normal(self) -> NodeReader | None:
        """The node that arrives at the input Normal, None where that is the surface's own."""
        socket, source = self.source("Normal")
        is_own = source.node.bl_idname == "ShaderNodeNewGeometry" and socket.identifier == "Normal"
        return source if socket.is_output and not is_own else None

    def look(self, key) -> Look:
        """The look of the shader that arrives at an input."""
        socket, source, _ = self._trace(key)
        if not socket.is_output:
            return BLACK
        return self.shaders.get(source.node.bl_idname, self.shaders[None])(source)

    def value(self, key) -> Value:
        """What arrives at an input; what no row of a table can say is noted."""
        socket, source, passed = self._trace(key)
        value, own = source._yield(socket), self.input(key)
        if value is None:
            value = Value.of(_plain(own.default_value))
            text = f"which is not modelled; {self._number(key, value.mean)} is used."
            self.note(f"{own.name} of {self.node.name} comes from {source.node.name}, {text}")
        from_type = socket.type
        for to_type in (x.type for x in reversed(passed)):
            if to_type in NUMBER_SOCKETS and from_type not in NUMBER_SOCKETS:
                number = value.as_number(from_type)
                value = number or self.mean(key, value).as_number(from_type)
            from_type = to_type
        return value

    def mean(self, key, value: Value) -> Value:
        """The mean of what arrives at an input, with a note if it is not that everywhere."""
        if value.texture:
            name, source = self.input(key).name, self.source(key)[1].node.name
            text = f"of which only the mean is used: {self._number(key, value.mean)}."
            self.note(f"{name} of {self.node.name} comes from {source}, {text}")
        return Value.of(value.mean)

    def color(self, key) -> np.ndarray:
        """(3,) the constant that arrives at an input, of a texture its mean, which is noted."""
        return self.mean(key, self.value(key)).mean

    def number(self, key) -> float:
        """The number that arrives at an input; of a colour, its luminance."""
        color = self.color(key)
        return float(color[0] if self.input(key).type in NUMBER_SOCKETS else color @ LUMINANCE)

    def constant(self, key) -> np.ndarray | None:
        """(3,) what arrives at an input if that is a constant, else None; notes nothing."""
        quiet = replace(self, notes=Notes(), known={})
        value = quiet.value(key)
        return None if value.texture or quiet.notes.sentences() else value.mean

    def is_constant(self, key, number: float) -> bool:
        """Whether an input is this very number, or a colour or vector of it."""
        constant = self.constant(key)
        return constant is not None and bool(np.all(constant == number))

    def _number(self, key, numbers):
        """How a note tells a value that is used."""
        shown = numbers[:1] if self.input(key).type in NUMBER_SOCKETS else numbers
        return ", ".join(f"{number:.3g}" for number in shown)

    def _yield(self, socket) -> Value | None:
        """What a socket of this node yields; None if that is not modelled."""
        if not socket.is_output:
            return Value.of(_plain(socket.default_value))
        output = OUTPUTS.get(self.node.bl_idname)
        if output is None:
            return None
        # The same node of a group yields something else in each node that shows the group.
        place = (socket.as_pointer(), *(group.as_pointer() for group in self.groups))
        if place not in self.known:
            self.known[place] = output(self, socket)
        return self.known[place]

    def _trace(self, key):
        """`source`, and all inputs that are passed on the way, the own one first."""
        socket, groups = self.input(key), self.groups
        passed = [socket]
        while not socket.is_output:
            link = next((x for x in socket.links if x.is_valid and not x.is_muted), None)
            origin = link and _before(link.from_socket, groups)
            if origin is None:
                break
            socket, groups = origin
            if not socket.is_output:
                passed.append(socket)
        return socket, replace(self, node=socket.node, groups=groups), passed


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
