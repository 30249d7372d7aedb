"""What arrives at the input of a node: constants, images, groups; a note for the rest."""

import bpy
import numpy as np
import pytest
from blender_scenes import (
    MaterialTree,
    assert_material,
    extract,
    read_material,
)

pytestmark = pytest.mark.blender

RED, GREEN = (0.5, 0.0, 0.0), (0.0, 0.25, 0.0)


def test_constants_arrive_through_reroutes_and_as_luminance():
    tree = MaterialTree()
    emission = tree.surface(tree.add("ShaderNodeEmission"))
    color, strength = tree.add("ShaderNodeRGB"), tree.add("ShaderNodeRGB")
    color.outputs[0].default_value = (0.5, 0.25, 1.0, 1.0)
    strength.outputs[0].default_value = (1.0, 2.0, 3.0, 1.0)
    reroute = tree.add("NodeReroute")
    tree.link(color, reroute)
    tree.link(reroute, emission, "Color")
    tree.link(strength, emission, "Strength")
    luminance = 0.2126 + 2 * 0.7152 + 3 * 0.0722
    assert_material(emission=(0.5 * luminance, 0.25 * luminance, luminance))


def test_muted_nodes_and_links_count_as_blender_counts_them():
    tree = MaterialTree()
    diffuse = tree.add("ShaderNodeBsdfDiffuse", Color=RED)
    mix = tree.surface(tree.add("ShaderNodeMixShader"))
    tree.link(diffuse, mix, 1)
    mix.mute = True
    assert_material(albedo=RED)  # passes its first shader on
    value = tree.add("ShaderNodeRGB")
    tree.link(value, diffuse, "Color").is_muted = True
    assert_material(albedo=RED)
    diffuse.mute = True
    assert_material()


def test_node_groups_are_entered_with_their_inputs():
    tree = MaterialTree()
    group = bpy.data.node_groups.new("Paint", "ShaderNodeTree")
    group.interface.new_socket("Unused", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Paint", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    diffuse = group.nodes.new("ShaderNodeBsdfDiffuse")
    group.links.new(start.outputs["Paint"], diffuse.inputs["Color"])
    group.links.new(diffuse.outputs[0], end.inputs[0])
    node = tree.add("ShaderNodeGroup")
    node.node_tree = group
    tree.surface(node)
    node.inputs["Paint"].default_value = (*RED, 1)
    assert_material(albedo=RED)
    color = tree.add("ShaderNodeRGB")
    color.outputs[0].default_value = (*GREEN, 1)
    tree.link(color, node, "Paint")
    assert_material(albedo=GREEN)


def test_what_is_not_constant_is_replaced_by_the_sockets_own_value_and_noted():
    tree = MaterialTree()
    diffuse = tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED))
    tree.link(tree.add("ShaderNodeTexNoise"), diffuse, "Color")
    text = "Color of Diffuse BSDF comes from Noise Texture, which is not modelled; 0.5, 0, 0"
    assert_material(albedo=RED, notes=[f"Material Test: {text} is used."])


@pytest.mark.parametrize("float_buffer", [False, True])
def test_an_image_without_a_place_is_replaced_by_its_linear_mean(float_buffer):
    tree = MaterialTree()
    image = bpy.data.images.new("Bricks", 2, 1, float_buffer=float_buffer)
    image.pixels = [0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 1.0, 1.0]
    texture = tree.add("ShaderNodeTexImage")
    texture.image = image
    tree.link(tree.add("ShaderNodeCameraData"), texture)
    tree.link(texture, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    sides, notes = read_material()
    # A byte of 128 is 0.50196, which sRGB decodes to 0.21586.
    middle = 0.5 if float_buffer else 0.21586
    np.testing.assert_allclose(sides[0][0], (0.5, middle, 1.0), rtol=1e-4)
    text = "is replaced by its mean, as View Vector of Camera Data is not modelled."
    assert notes == [f"Material Test: image Bricks in Image Texture {text}"]
    assert extract().materials.num_closures.tolist() == [[0, 0]]


def test_a_missing_image_is_magenta_and_named():
    tree = MaterialTree()
    image = bpy.data.images.new("Lost", 4, 4)
    image.source, image.filepath = "FILE", "/nowhere/lost.png"
    texture = tree.add("ShaderNodeTexImage")
    texture.image = image
    tree.link(texture, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    text = "missing image file /nowhere/lost.png in Image Texture is rendered as magenta."
    assert_material(albedo=(1, 0, 1), notes=[f"Material Test: {text}"])
