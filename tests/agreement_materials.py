"""The materials and images of `agreement_rows.py`; made for the file that is open in Blender."""

import blender_scenes as blend
import bpy
import numpy as np

WHITE, ORANGE, BLUE = (0.8, 0.8, 0.8), (0.9, 0.5, 0.2), (0.2, 0.4, 0.8)
METAL = {"Base_Color": (0.9, 0.6, 0.3), "Metallic": 1.0}


def shader(tree, kind, distribution=None, **inputs):
    """A shader node, Diffuse for ShaderNodeBsdfDiffuse; inputs as in `blender_scenes.add_node`."""
    name = {"Emission": "Emission", "Glossy": "BsdfAnisotropic"}.get(kind, f"Bsdf{kind}")
    node = blend.add_node(tree, f"ShaderNode{name}", **inputs)
    if distribution:
        node.distribution = distribution
    return node


def compose(make) -> bpy.types.Material:
    """A material of the shader node that make(tree) returns."""
    material = bpy.data.materials.new("Material")
    tree = blend.enable_nodes(material)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(make(tree).outputs[0], output.inputs["Surface"])
    return material


def plain(kind, distribution=None, **inputs):
    """A material of one shader."""
    return compose(lambda tree: shader(tree, kind, distribution, **inputs))


def mixed(share, first, second):
    """A material of two shaders, (kind, inputs) each.

    share: of the second, a number or a function of a node tree that gives an output; None for both
    added up.
    """

    def make(tree):
        name = "AddShader" if share is None else "MixShader"
        node = tree.nodes.new(f"ShaderNode{name}")
        sockets = [socket for socket in node.inputs if socket.type == "SHADER"]
        for socket, (kind, inputs) in zip(sockets, (first, second), strict=True):
            tree.links.new(shader(tree, kind, **inputs).outputs[0], socket)
        if callable(share):
            tree.links.new(share(tree), node.inputs[0])
        elif share is not None:
            node.inputs[0].default_value = share
        return node

    return compose(make)


def textured(kind, pixels, *uses, is_data=False, is_float=False, **inputs):
    """A material whose shader takes inputs from an image: uses are (output, input) pairs."""

    def make(tree):
        node, texture = shader(tree, kind, **inputs), tree.nodes.new("ShaderNodeTexImage")
        texture.image = new_image(pixels, is_data, is_float)
        for output, name in uses:
            tree.links.new(texture.outputs[output], node.inputs[name])
        return node

    return compose(make)


def ramped(kind, **inputs):
    """A material whose Color and Roughness are ramps of an image."""

    def make(tree):
        node, texture = shader(tree, kind, **inputs), tree.nodes.new("ShaderNodeTexImage")
        texture.image = new_image(spots(), is_data=True)
        for name, color in (("Color", ORANGE), ("Roughness", (0.6, 0.6, 0.6))):
            ramp = tree.nodes.new("ShaderNodeValToRGB")
            ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.3, 0.6
            ramp.color_ramp.elements[1].color = (*color, 1.0)
            tree.links.new(texture.outputs["Color"], ramp.inputs[0])
            tree.links.new(ramp.outputs["Color"], node.inputs[name])
        return node

    return compose(make)


def normal_mapped(kind, strength, **inputs):
    """A material with a tangent-space normal map of waves."""
    y, x = np.mgrid[:32, :32] * (2 * np.pi / 16)
    tilt = np.stack([0.4 * np.sin(x), 0.4 * np.sin(y), np.ones_like(x)], axis=-1)
    normals = tilt / np.linalg.norm(tilt, axis=-1, keepdims=True)

    def make(tree):
        node, texture = shader(tree, kind, **inputs), tree.nodes.new("ShaderNodeTexImage")
        texture.image = new_image(normals / 2 + 0.5, is_data=True)
        bend = blend.add_node(tree, "ShaderNodeNormalMap", Strength=strength)
        tree.links.new(texture.outputs["Color"], bend.inputs["Color"])
        tree.links.new(bend.outputs["Normal"], node.inputs["Normal"])
        return node

    return compose(make)


def fresnel(tree):
    """How much glass reflects, seen from either side."""
    return blend.add_node(tree, "ShaderNodeFresnel", IOR=1.5).outputs[0]


def facing(tree):
    """How much a surface faces away, squared and more."""
    weight = blend.add_node(tree, "ShaderNodeLayerWeight", Blend=0.3).outputs["Facing"]
    power = tree.nodes.new("ShaderNodeMath")
    power.operation = "POWER"
    tree.links.new(weight, power.inputs[0])
    power.inputs[1].default_value = 2.5
    return power.outputs[0]


def waves(tree):
    """An image of low waves, 32 by 32 texels and 0 to 1 high."""
    y, x = np.mgrid[:32, :32] * (2 * np.pi / 16)
    heights = (2 + np.sin(x) + np.cos(y)) / 4
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = new_image(np.repeat(heights[..., None], 3, axis=2), True, True)
    return texture.outputs["Color"]


def bumpy(kind, **inputs):
    """A material with a bump map of waves."""

    def make(tree):
        node = shader(tree, kind, **inputs)
        bump = blend.add_node(tree, "ShaderNodeBump", Strength=0.8, Distance=0.05)
        tree.links.new(waves(tree), bump.inputs["Height"])
        tree.links.new(bump.outputs["Normal"], node.inputs["Normal"])
        return node

    return compose(make)


def displaced(kind, **inputs):
    """A material with a displacement of waves, which is rendered as bumps."""
    material = plain(kind, **inputs)
    tree = material.node_tree
    node = blend.add_node(tree, "ShaderNodeDisplacement", Scale=0.05)
    node.space = "WORLD"
    tree.links.new(waves(tree), node.inputs["Height"])
    tree.links.new(node.outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"])
    material.displacement_method = "BUMP"
    return material


def color_attribute(kind, **inputs):
    """A material whose colour is the attribute Paint, which every ball and sheet has."""

    def make(tree):
        node, paint = shader(tree, kind, **inputs), tree.nodes.new("ShaderNodeVertexColor")
        paint.layer_name = "Paint"
        name = "Base Color" if kind == "Principled" else "Color"
        tree.links.new(paint.outputs["Color"], node.inputs[name])
        return node

    return compose(make)


def new_image(pixels, is_data=False, is_float=False):
    """An image of (H, W, 3 or 4) values, its first row at the bottom."""
    height, width, channels = pixels.shape
    image = bpy.data.images.new(
        "Image", width, height, alpha=channels == 4, float_buffer=is_float, is_data=is_data
    )
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :channels] = pixels
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def spots(size=16, channels=3, low=0.05, high=0.95):
    """Random values, the same each time."""
    return np.random.default_rng(7).uniform(low, high, (size, size, channels))
