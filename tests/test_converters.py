"""Nodes that turn numbers and colours into others: their results are those of Cycles."""

import itertools
import math

import bpy
import numpy as np
import pytest
from blender_scenes import MaterialTree, add_node, extract, read_material
from material_scenes import emission_row, render_row

from lighttree_core import Settings
from lighttree_core.scene import BACK, FRONT
from lighttree_core.textures import texture_value
from lighttree_core.world import build_world

pytestmark = pytest.mark.blender

NUMBERS = [
    (0.3, 0.7, 0.2),
    (1.7, 0.4, 0.5),
    (-0.6, 0.25, 0.1),
    (0.5, 0.5, 0.0),
    (-1.3, 2.0, 0.3),
    (2.5, -0.7, 1.0),
]
COLORS = [
    ((0.2, 0.5, 0.9), (0.7, 0.1, 0.4)),
    ((0.8, 0.8, 0.8), (0.1, 0.9, 0.3)),
    ((0.0, 1.3, 0.4), (0.5, 0.5, 0.5)),
    ((0.6, 0.3, 0.0), (1.0, 0.0, 1.0)),
]


def _enum(node, name):
    items = getattr(bpy.types, node).bl_rna.properties[name].enum_items
    return [item.identifier for item in items]


def _link_lifted(tree, output, emission):
    """Link an output plus 10 to the colour of an emission, which may not be negative."""
    add = tree.nodes.new("ShaderNodeVectorMath")
    add.inputs[1].default_value = (10, 10, 10)
    tree.links.new(output, add.inputs[0])
    tree.links.new(add.outputs[0], emission.inputs["Color"])


def _input(node, identifier):
    return next(socket for socket in node.inputs if socket.identifier == identifier)


def _assert_row_agrees(cases, build, tmp_path, rtol=2e-5):
    ours, cycles, notes = emission_row(cases, build, tmp_path)
    assert notes == []
    for case, own, seen in zip(cases, ours, cycles, strict=True):
        np.testing.assert_allclose(own, seen, rtol=rtol, atol=1e-5, err_msg=str(case))


def test_math(tmp_path):
    def build(case, tree, emission):
        operation, numbers, clamps = case
        node = tree.nodes.new("ShaderNodeMath")
        node.operation, node.use_clamp = operation, clamps
        for socket, number in zip(node.inputs, numbers, strict=True):
            socket.default_value = number
        _link_lifted(tree, node.outputs[0], emission)

    operations = _enum("ShaderNodeMath", "operation")
    cases = list(itertools.product(operations, NUMBERS, [False]))
    cases += [("ADD", numbers, True) for numbers in NUMBERS]
    _assert_row_agrees(cases, build, tmp_path)


def test_vector_math(tmp_path):
    def build(case, tree, emission):
        node = tree.nodes.new("ShaderNodeVectorMath")
        node.operation, vectors = case
        for socket, vector in zip(node.inputs, vectors, strict=True):
            socket.default_value = vector
        output = next(output for output in node.outputs if output.enabled)
        _link_lifted(tree, output, emission)

    operations = [
        operation
        for operation in _enum("ShaderNodeVectorMath", "operation")
        if operation not in ("REFRACT", "FACEFORWARD")
    ]
    vectors = [
        ((0.3, -0.2, 0.5), (0.7, 1.2, -0.4), (0.1, 0.9, 1.5), 0.7),
        ((1.2, 2.2, -0.5), (0.7, 0.0, 0.4), (0.1, 0.0, 1.5), -0.7),
    ]
    _assert_row_agrees(list(itertools.product(operations, vectors)), build, tmp_path)


def test_mix_of_colours(tmp_path):
    def build(case, tree, emission):
        blend, factor, (a, b), clamps = case
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type, node.blend_type = "RGBA", blend
        node.clamp_factor = node.clamp_result = clamps
        _input(node, "Factor_Float").default_value = factor
        _input(node, "A_Color").default_value = (*a, 1)
        _input(node, "B_Color").default_value = (*b, 1)
        output = next(x for x in node.outputs if x.identifier == "Result_Color")
        _link_lifted(tree, output, emission)

    blends = _enum("ShaderNodeMix", "blend_type")
    cases = list(itertools.product(blends, [0.3, 1.0], COLORS, [False]))
    cases += [("ADD", 1.4, COLORS[2], clamps) for clamps in (False, True)]
    _assert_row_agrees(cases, build, tmp_path)


def test_mix_of_numbers_and_vectors_and_the_node_before_it(tmp_path):
    def build(case, tree, emission):
        if case == "legacy":
            node = add_node(tree, "ShaderNodeMixRGB", Color1=COLORS[0][0], Color2=COLORS[0][1])
            node.inputs[0].default_value, node.blend_type = 1.5, "MULTIPLY"
            tree.links.new(node.outputs[0], emission.inputs["Color"])
            return
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type, node.factor_mode = case
        _input(node, "Factor_Float").default_value = 0.25
        _input(node, "Factor_Vector").default_value = (0.25, 0.5, 2.0)
        for key in "AB":
            _input(node, f"{key}_Float").default_value = ord(key)
            _input(node, f"{key}_Vector").default_value = (ord(key), 2.0, 3.0)
        _link_lifted(tree, next(x for x in node.outputs if x.enabled), emission)

    cases = [("FLOAT", "UNIFORM"), ("VECTOR", "UNIFORM"), ("VECTOR", "NON_UNIFORM"), "legacy"]
    _assert_row_agrees(cases, build, tmp_path)


def test_map_range_and_clamp(tmp_path):
    def build(case, tree, emission):
        kind, clamps, value, limits = case
        if kind in ("MINMAX", "RANGE"):
            node = add_node(tree, "ShaderNodeClamp", Value=value, Min=limits[0], Max=limits[1])
            node.clamp_type = kind
        else:
            node = tree.nodes.new("ShaderNodeMapRange")
            node.interpolation_type, node.clamp = kind, clamps
            for socket, number in zip(node.inputs, (value, *limits, 4), strict=False):
                socket.default_value = number
        _link_lifted(tree, node.outputs[0], emission)

    kinds = _enum("ShaderNodeMapRange", "interpolation_type")
    limits = [(0.0, 1.0, 2.0, 5.0), (0.8, 0.2, 3.0, -1.0)]
    cases = list(itertools.product(kinds, [False, True], [-0.21, 0.33, 0.71, 1.43], limits))
    cases += list(itertools.product(["MINMAX", "RANGE"], [True], [-0.21, 0.33, 1.43], limits))
    _assert_row_agrees(cases, build, tmp_path)


def test_map_range_of_vectors(tmp_path):
    def build(kind, tree, emission):
        node = tree.nodes.new("ShaderNodeMapRange")
        node.data_type, node.interpolation_type = "FLOAT_VECTOR", kind
        _input(node, "Vector").default_value = (-0.21, 0.33, 0.71)
        _input(node, "To_Max_FLOAT3").default_value = (3.0, 2.0, -1.0)
        _link_lifted(tree, node.outputs[1], emission)

    _assert_row_agrees(_enum("ShaderNodeMapRange", "interpolation_type"), build, tmp_path)


@pytest.mark.parametrize(
    "node, rows",
    [
        ("ShaderNodeInvert", [{0: t, 1: (0.2, 0.5, 1.5, 1)} for t in (0.0, 0.3, 1.0)]),
        (
            "ShaderNodeGamma",
            [{0: (x, 0.5, 1.5, 1), 1: g} for x, g in ((0.2, 0), (-1, 0.45), (-1, 2.2))],
        ),
        (
            "ShaderNodeBrightContrast",
            [{0: (0.2, 0.5, 1.5, 1), 1: b, 2: c} for b, c in ((0.1, 0.5), (-0.4, 0.0), (0, -2))],
        ),
        (
            "ShaderNodeHueSaturation",
            [
                {0: h, 1: s, 2: v, 3: t, 4: (*color, 1)}
                for h, s, v, t in ((0.5, 1, 1, 1), (0.7, 1.5, 0.8, 0.6), (0.1, 0.2, 2.0, 1.0))
                for color, _ in COLORS
            ],
        ),
        ("ShaderNodeRGBToBW", [{0: (0.2, 0.5, 1.5, 1)}]),
    ],
)
def test_colour_nodes(node, rows, tmp_path):
    def build(inputs, tree, emission):
        made = tree.nodes.new(node)
        for key, value in inputs.items():
            made.inputs[key].default_value = value
        _link_lifted(tree, made.outputs[0], emission)

    _assert_row_agrees(rows, build, tmp_path)


def test_separate_and_combine(tmp_path):
    def build(case, tree, emission):
        mode, color = case
        apart, together = (tree.nodes.new(f"ShaderNode{x}Color") for x in ("Separate", "Combine"))
        apart.mode, together.mode = mode
        apart.inputs[0].default_value = (*color, 1)
        for output, to in zip(apart.outputs, together.inputs, strict=True):
            tree.links.new(output, to)
        _link_lifted(tree, together.outputs[0], emission)

    modes = list(itertools.product(["RGB", "HSV", "HSL"], repeat=2))
    colors = [a for a, _ in COLORS if max(a) <= 1]
    _assert_row_agrees(list(itertools.product(modes, colors)), build, tmp_path)


def test_vectors_are_taken_apart_and_become_numbers_by_their_mean(tmp_path):
    def build(key, tree, emission):
        vector = add_node(tree, "ShaderNodeCombineXYZ", X=0.1, Y=0.5, Z=0.9)
        apart = tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(vector.outputs[0], apart.inputs[0])
        source = vector.outputs[0] if key == "mean" else apart.outputs[key]
        tree.links.new(source, emission.inputs["Strength"])

    _assert_row_agrees(["mean", "X", "Y", "Z"], build, tmp_path)


def test_colour_ramps_and_curves(tmp_path):
    def build(case, tree, emission):
        kind, x = case
        if kind in ("RGBCurve", "VectorCurve", "FloatCurve"):
            node = tree.nodes.new(f"ShaderNode{kind}")
            for i, curve in enumerate(node.mapping.curves):
                curve.points.new(0.4, 0.6 - 0.1 * i)
            node.mapping.update()
            node.inputs[0].default_value = 0.7
            node.inputs[1].default_value = {
                "RGBCurve": (x, 1.1 * x, 0.5 * x, 1),
                "VectorCurve": (x, 1.1 * x, 0.5 * x),
                "FloatCurve": x,
            }[kind]
        else:
            node = add_node(tree, "ShaderNodeValToRGB")
            node.inputs[0].default_value = x
            node.color_ramp.interpolation = kind
            node.color_ramp.elements[0].color = (0.9, 0.1, 0.0, 0.5)
            node.color_ramp.elements.new(0.4).color = (0.2, 0.6, 0.4, 1.0)
        _link_lifted(tree, node.outputs[0], emission)

    kinds = [*_enum("ColorRamp", "interpolation"), "RGBCurve", "VectorCurve", "FloatCurve"]
    cases = list(itertools.product(kinds, [-0.1, 0.0, 0.13, 0.57, 0.9, 1.0, 1.2]))
    # Cycles 4.5 extends float curves beyond their ends, 5.2 does not.
    cases = [case for case in cases if case[0] != "FloatCurve" or 0 <= case[1] <= 1]
    # Cycles looks them up in tables of 256 steps.
    _assert_row_agrees(cases, build, tmp_path, rtol=2e-4)


def test_black_bodies(tmp_path):
    def build(kelvin, tree, emission):
        node = add_node(tree, "ShaderNodeBlackbody", Temperature=kelvin)
        tree.links.new(node.outputs[0], emission.inputs["Color"])

    kelvins = [500, 900, 1200, 1850, 2000, 2700, 4000, 5500, 6500, 9000, 12000, 20000]
    ours, cycles, notes = emission_row(kelvins, build, tmp_path)
    assert notes == []
    np.testing.assert_allclose(ours, cycles, rtol=0.005, atol=2e-3)


def test_what_hangs_on_the_ray_is_noted_with_what_is_used():
    tree = MaterialTree()
    emission = tree.surface(tree.add("ShaderNodeEmission"))
    tree.link(tree.add("ShaderNodeLightPath"), emission, "Strength")
    sides, notes = read_material()
    assert sides[0][1] == [0, 0, 0]
    assert notes == ["Material Test: Is Camera Ray of Light Path is not modelled; 0 is used."]


def _by_angle(tree, kind, number):
    """The output of nodes that tell how much a surface faces the ray."""
    if kind == "Index":
        return add_node(tree, "ShaderNodeFresnel", IOR=number).outputs[0]
    layer = add_node(tree, "ShaderNodeLayerWeight", Blend=number)
    if kind != "Ramp":
        return layer.outputs[kind]
    product, ramp = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeValToRGB")
    product.operation = "MULTIPLY"
    ramp.color_ramp.elements[0].color = (0.9, 0.1, 0.4, 1.0)
    for name, socket in zip(("Fresnel", "Facing"), product.inputs, strict=False):
        tree.links.new(layer.outputs[name], socket)
    tree.links.new(product.outputs[0], ramp.inputs[0])
    return ramp.outputs[0]


def test_what_hangs_on_the_angle_is_a_curve(tmp_path):
    kinds = [("Index", 1.5), ("Index", 0.7), ("Fresnel", 0.6), ("Facing", 0.2), ("Facing", 0.5)]
    kinds += [("Facing", 0.8), ("Ramp", 0.3)]
    tilts = np.radians([0, 25, 50, 70, 85, 100, 130, 170])
    cases = list(itertools.product(kinds, tilts))

    def build(case, tree, emission):
        tree.links.new(_by_angle(tree, *case[0]), emission.inputs["Color"])

    def place(case):
        return {"rotation": (case[1], 0, 0), "scale": (1, 4 / abs(math.cos(case[1])), 1)}

    scene, seen = render_row(cases, build, tmp_path, place=place)
    assert scene.not_modelled == []
    world, down = build_world(scene, Settings()), (0.0, 0.0, -1.0)
    for i, ((kind, number), tilt) in enumerate(cases):
        side = FRONT if math.cos(tilt) > 0 else BACK
        material = scene.triangle_material[2 * i]
        texture = scene.materials.emission_texture[material, side]
        color = texture_value(world.geometry, world.textures, texture, 2 * i, 0.3, 0.3, down)
        found = scene.materials.emission[material, side] * color
        np.testing.assert_allclose(found, seen[i], rtol=1e-3, atol=1e-4, err_msg=f"{kind} {number}")


def test_a_bent_normal_of_what_hangs_on_the_angle_is_noted():
    tree = MaterialTree()
    emission, fresnel = tree.surface(tree.add("ShaderNodeEmission")), tree.add("ShaderNodeFresnel")
    tree.link(fresnel, emission, "Strength")
    tree.link(tree.add("ShaderNodeBump"), fresnel, "Normal")
    text = "Normal of Fresnel comes from Bump, which is left out there."
    assert extract().not_modelled == [f"Material Test: {text}"]


def test_ambient_occlusion_is_that_of_an_open_place():
    tree = MaterialTree()
    emission = tree.surface(tree.add("ShaderNodeEmission"))
    occlusion = tree.add("ShaderNodeAmbientOcclusion", Color=(0.2, 0.3, 0.4))
    tree.link(occlusion, emission, "Color", 0)
    tree.link(occlusion, emission, "Strength", 1)
    sides, notes = read_material()
    np.testing.assert_allclose(sides[0][1], (0.2, 0.3, 0.4), rtol=1e-6)
    assert notes == [
        "Material Test: Ambient Occlusion is not modelled; every place is taken as an open one."
    ]
