"""Materials, worlds and the nodes of lights -> rows, radiance and factors of a LightTree scene.

LightTree has Lambertian surfaces that may emit, each side on its own. A shader of another kind
becomes the nearest of that sort, and one note says so.
"""

from __future__ import annotations

import bpy
import numpy as np

from lighttree_core.scene import BACK, FRONT, Materials

from .nodes import BLACK, NodeReader, Notes

PRINCIPLED_EXTRAS = (
    "Metallic",
    "Transmission Weight",
    "Subsurface Weight",
    "Coat Weight",
    "Sheen Weight",
    "Diffuse Roughness",
    "Normal",
)
LIGHT_SAMPLED = {"NONE": (False, False), "FRONT": (True, False), "BACK": (False, True)}


class MaterialTable:
    """Gathers materials; each becomes one row of `Materials`, an empty slot another."""

    def __init__(self, notes: Notes):
        self.notes = notes
        self.row_of = {}  # address of a material -> row
        self.looks, self.light_sampled, self.names = [], [], []

    def row(self, material) -> int:
        """The row of a material, which is read when it is first met."""
        key = material.as_pointer() if material else 0
        if key not in self.row_of:
            self.row_of[key] = len(self.names)
            self.names.append(material.name if material else "(no material)")
            self.looks.append(_read_material(material, self.notes))
            sides = cycles_setting(material, "emission_sampling", "AUTO")
            self.light_sampled.append(LIGHT_SAMPLED.get(sides, (True, True)))
        return self.row_of[key]

    def materials(self) -> Materials:
        """All rows."""
        looks = np.array(self.looks, np.float32).reshape(-1, 2, 2, 3)
        return Materials(
            albedo=np.ascontiguousarray(looks[:, :, 0]),
            emission=np.ascontiguousarray(looks[:, :, 1]),
            light_sampled=np.array(self.light_sampled, bool).reshape(-1, 2),
            names=self.names,
        )


def read_background(world, notes: Notes) -> np.ndarray:
    """(3,) radiance of a world, W/(m^2 sr); no world is black."""
    if world is None:
        return np.zeros(3)
    tree = _node_tree(world)
    return np.array(world.color) if tree is None else _read_tree(tree, world, notes, FRONT)[1]


def read_light_factor(light, notes: Notes) -> np.ndarray:
    """(3,) what the nodes of a light multiply its power by."""
    tree = _node_tree(light)
    return np.ones(3) if tree is None else _read_tree(tree, light, notes, FRONT)[1]


def cycles_setting(data, name: str, default):
    """A property that Cycles gives to a data-block; `default` where its add-on is disabled."""
    return getattr(getattr(data, "cycles", None), name, default)


def _read_material(material, notes):
    """(2 sides, albedo and emission, 3)."""
    if material is None:
        # Cycles' default surface is a Diffuse BSDF up to 4.5 and a Principled BSDF since 5.0.
        if bpy.app.version >= (5, 0):
            notes.add("Surfaces without material", _as_diffuse(["Specular IOR Level"]))
        return [np.array([np.full(3, 0.8), np.zeros(3)])] * 2
    tree = _node_tree(material)
    if tree is None:
        return [np.array([material.diffuse_color[:3], np.zeros(3)])] * 2
    return [_read_tree(tree, material, notes, side) for side in (FRONT, BACK)]


def _node_tree(data):
    """The node tree that Cycles renders with, or None.

    Up to 4.5 nodes can be switched off; later the switch does nothing, and asking for it warns.
    """
    return data.node_tree if bpy.app.version >= (5, 0) or data.use_nodes else None


def _read_tree(tree, owner, notes, side):
    """The look of a material, world or light from one side."""
    output = tree.get_output_node("CYCLES")
    if output is None:
        return BLACK
    reader = NodeReader(output, SHADERS, f"{owner.id_type.capitalize()} {owner.name}", notes, side)
    for key in ("Volume", "Displacement"):
        if key in output.inputs and output.inputs[key].is_linked:
            reader.note(f"the {key} of its nodes is left out.")
    return reader.look("Surface")


def _as_diffuse(lost):
    return f"rendered as diffuse, without {', '.join(lost)}."


def _diffuse(node):
    lost = [key for key in ("Roughness", "Normal") if not node.is_constant(key, 0)]
    if lost:
        node.note(_as_diffuse(lost))
    return np.array([node.color("Color"), np.zeros(3)])


def _emission(node):
    """Emission, and Background: seen from both sides."""
    return np.array([np.zeros(3), _radiance(node, "Color", "Strength")])


def _radiance(node, color, strength):
    """(3,) W/(m^2 sr): colour * strength, as in Cycles."""
    watts = node.number(strength)
    return watts * node.color(color) if watts else np.zeros(3)


def _principled(node):
    """The base as diffuse, and the emission; Alpha scales both."""
    lost = [key for key in PRINCIPLED_EXTRAS if not node.is_constant(key, 0)]
    # At level 0, and at index 1, nothing is reflected at normal incidence, hence nowhere.
    if not (node.is_constant("Specular IOR Level", 0) or node.is_constant("IOR", 1)):
        lost.append("Specular IOR Level")
    if not node.is_constant("Alpha", 1):
        lost.append("Alpha")
    if lost:
        node.note(_as_diffuse(lost))
    emission = _radiance(node, "Emission Color", "Emission Strength")
    return node.number("Alpha") * np.array([node.color("Base Color"), emission])


def _add(node):
    return node.look(0) + node.look(1)


def _mix(node):
    """Only shaders with a share are read, so that the others cause no notes."""
    share = min(max(node.number(0), 0.0), 1.0)
    shares = {1: 1.0 - share, 2: share}
    return sum(share * node.look(key) for key, share in shares.items() if share > 0)


def _transparent(node):
    node.note(f"{node.node.name} is rendered black.")
    return BLACK


def _other(node):
    """Any other shader as diffuse in its colour, black where it has none."""
    if "Color" not in node.node.inputs:
        return _transparent(node)
    node.note(f"{node.node.name} is rendered as diffuse.")
    return np.array([node.color("Color"), np.zeros(3)])


SHADERS = {
    "ShaderNodeBsdfDiffuse": _diffuse,
    "ShaderNodeEmission": _emission,
    "ShaderNodeBackground": _emission,
    "ShaderNodeBsdfPrincipled": _principled,
    "ShaderNodeAddShader": _add,
    "ShaderNodeMixShader": _mix,
    "ShaderNodeBsdfTransparent": _transparent,
    "ShaderNodeHoldout": _transparent,
    None: _other,
}
