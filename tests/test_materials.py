"""Materials and worlds -> closures, emission, radiance; a note for what is rendered otherwise."""

import bpy
import numpy as np
import pytest
from blender_scenes import (
    MaterialTree,
    add_node,
    add_plane,
    add_probe,
    assert_material,
    assert_probe_agrees,
    extract,
    new_material,
    new_scene,
    new_world,
    radians,
    read_material,
)
from material_scenes import the_closure

from lighttree_core.scene import BACK, COLOR, FRONT, PRINCIPLED, TRANSPARENT

pytestmark = pytest.mark.blender

RED, GREEN = (0.5, 0.0, 0.0), (0.0, 0.25, 0.0)
# A Principled BSDF without gloss, which is a Diffuse BSDF.
MATT = {"Specular_IOR_Level": 0.0}


def test_diffuse_is_its_colour_on_both_sides():
    tree = MaterialTree()
    tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED))
    assert_material(albedo=RED)


def test_emission_is_colour_times_strength_on_both_sides():
    tree = MaterialTree()
    tree.surface(tree.add("ShaderNodeEmission", Color=RED, Strength=4.0))
    assert_material(emission=(2, 0, 0))


def test_principled_is_its_base_and_emission():
    tree = MaterialTree()
    inputs = {"Base_Color": GREEN, "Emission_Color": RED, "Emission_Strength": 4.0, **MATT}
    tree.surface(tree.add("ShaderNodeBsdfPrincipled", **inputs))
    assert_material(albedo=GREEN, emission=(2, 0, 0))


def test_shaders_add_and_mix():
    tree = MaterialTree()
    diffuse = tree.add("ShaderNodeBsdfDiffuse", Color=RED)
    emission = tree.add("ShaderNodeEmission", Color=GREEN, Strength=4.0)
    add, mix = tree.add("ShaderNodeAddShader"), tree.surface(tree.add("ShaderNodeMixShader"))
    tree.link(diffuse, add, 0)
    tree.link(emission, add, 1)
    tree.link(add, mix, 1)
    tree.link(diffuse, mix, 2)
    mix.inputs[0].default_value = 0.25
    assert_material(albedo=RED, emission=(0, 0.75, 0))


def test_shader_without_a_share_causes_no_note():
    tree = MaterialTree()
    mix = tree.surface(tree.add("ShaderNodeMixShader"))
    tree.link(tree.add("ShaderNodeBsdfGlass"), mix, 1)
    tree.link(tree.add("ShaderNodeBsdfDiffuse", Color=RED), mix, 2)
    mix.inputs[0].default_value = 1.0
    assert_material(albedo=RED)


@pytest.mark.parametrize("through", ["shader", "strength"])
def test_backfacing_tells_the_sides_apart(through):
    tree = MaterialTree()
    emission = tree.add("ShaderNodeEmission", Color=RED, Strength=1.0)
    geometry = tree.add("ShaderNodeNewGeometry")
    backfacing = geometry.outputs.find("Backfacing")
    if through == "shader":
        mix = tree.surface(tree.add("ShaderNodeMixShader"))
        tree.link(geometry, mix, 0, backfacing)
        tree.link(tree.add("ShaderNodeBsdfDiffuse", Color=GREEN), mix, 1)
        tree.link(emission, mix, 2)
    else:
        tree.link(geometry, tree.surface(emission), "Strength", backfacing)
    sides, notes = read_material()
    front_albedo = GREEN if through == "shader" else (0, 0, 0)
    np.testing.assert_allclose(sides[FRONT], (front_albedo, (0, 0, 0)), rtol=1e-6)
    np.testing.assert_allclose(sides[BACK], ((0, 0, 0), RED), rtol=1e-6)
    assert notes == []


@pytest.mark.parametrize(
    "shader, albedo, text",
    [
        ("ShaderNodeHoldout", (0, 0, 0), "Holdout is rendered black."),
        ("ShaderNodeBsdfToon", (0.8, 0.8, 0.8), "Toon BSDF is rendered as diffuse."),
        (
            "ShaderNodeSubsurfaceScattering",
            (0.8, 0.8, 0.8),
            "Subsurface Scattering is rendered as diffuse.",
        ),
    ],
)
def test_other_shaders_are_black_or_diffuse_and_noted(shader, albedo, text):
    tree = MaterialTree()
    tree.surface(tree.add(shader))
    assert_material(albedo=albedo, notes=[f"Material Test: {text}"])


def test_no_output_and_nothing_linked_are_black():
    tree = MaterialTree()
    assert_material()
    tree.nodes.nodes.clear()
    assert_material()


def test_volume_and_displacement_are_noted():
    tree = MaterialTree()
    tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED))
    tree.link(tree.add("ShaderNodeVolumeScatter"), tree.output, "Volume")
    tree.link(tree.add("ShaderNodeVectorDisplacement"), tree.output, "Displacement")
    notes = [
        "Material Test: the Volume of its nodes is left out.",
        "Material Test: the displacement by Vector Displacement is left out.",
    ]
    assert_material(albedo=RED, notes=notes)


def test_around_a_volume_alone_a_surface_is_clear():
    tree = MaterialTree()
    tree.link(tree.add("ShaderNodeVolumeScatter"), tree.output, "Volume")
    scene = extract()
    for side in (FRONT, BACK):
        closure = the_closure(scene, side)
        assert closure.kind == TRANSPARENT and closure.weight.tolist() == [1, 1, 1]
        assert closure.values[COLOR : COLOR + 3].tolist() == [1, 1, 1]
    assert scene.not_modelled == ["Material Test: the Volume of its nodes is left out."]


def test_one_sentence_serves_all_materials_it_is_true_of():
    new_scene()
    for i in range(5):
        add_plane(material=new_material(f"M{i}", "ShaderNodeBsdfToon"), location=(0, 0, i))
    expected = [
        "Material M0, Material M1, Material M2 and 2 more: Toon BSDF is rendered as diffuse."
    ]
    assert extract().not_modelled == expected


@pytest.mark.parametrize(
    "sampling, expected",
    [
        ("NONE", [False, False]),
        ("FRONT", [True, False]),
        ("BACK", [False, True]),
        ("FRONT_BACK", [True, True]),
        ("AUTO", [True, True]),
    ],
)
def test_emission_sampling_chooses_the_sides_that_are_lights(sampling, expected):
    tree = MaterialTree()
    tree.material.cycles.emission_sampling = sampling
    assert extract().materials.light_sampled.tolist() == [expected]


def test_a_mesh_without_material_looks_like_blenders_default():
    new_scene()
    add_plane()
    assert_material(albedo=(0.8, 0.8, 0.8))
    if bpy.app.version >= (5, 0):
        add_plane(material=new_material("New", "ShaderNodeBsdfPrincipled"))
        scene = extract()
        assert scene.closures.kind.tolist() == [PRINCIPLED, PRINCIPLED]
        np.testing.assert_array_equal(*scene.closures.values)
    else:
        assert extract().materials.num_closures.tolist() == [[0, 0]]


@pytest.mark.skipif(bpy.app.version >= (5, 0), reason="nodes cannot be switched off")
def test_nodes_switched_off_leave_the_viewport_colours():
    tree = MaterialTree()
    tree.material.use_nodes = False
    tree.material.diffuse_color = (0.1, 0.2, 0.3, 1.0)
    assert_material(albedo=(0.1, 0.2, 0.3))
    world = bpy.data.worlds.new("World")
    world.color = (0.3, 0.2, 0.1)
    bpy.context.scene.world = world
    np.testing.assert_allclose(extract().background, (0.3, 0.2, 0.1), rtol=1e-6)


# Looks as Cycles renders them, and the world.


@pytest.mark.parametrize("flip", [0, 180])
def test_an_emitting_mesh_shines_to_both_sides_as_in_cycles(flip, tmp_path):
    add_probe()
    material = new_material("Glow", "ShaderNodeEmission", Color=(1, 0.5, 0.25), Strength=5.0)
    place = {
        "location": (0.2, 0.1, 1.0),
        "rotation": radians(flip + 10, 20, 0),
        "scale": (1, 0.5, 1),
    }
    add_plane(1.0, material, **place)
    assert_probe_agrees(tmp_path)


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, 1, -1), (-1, -1, -1), (-1, -1, 1)])
def test_front_and_back_of_mirrored_meshes_are_those_of_cycles(scale, tmp_path):
    add_probe(256)
    material = new_material("Sided", "ShaderNodeMixShader")
    tree = material.node_tree
    mix = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeMixShader")
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    tree.links.new(geometry.outputs["Backfacing"], mix.inputs[0])
    for key, color in ((1, RED), (2, GREEN)):
        emission = add_node(tree, "ShaderNodeEmission", Color=color, Strength=3.0)
        tree.links.new(emission.outputs[0], mix.inputs[key])
    add_plane(0.8, material, location=(0.2, 0.1, 1.2), rotation=radians(150, 20, 30), scale=scale)
    assert_probe_agrees(tmp_path)


def test_principled_emission_is_scaled_by_alpha_as_in_cycles(tmp_path):
    add_probe()
    inputs = {"Emission_Color": (1, 0.5, 0.25), "Emission_Strength": 5.0, "Alpha": 0.5, **MATT}
    material = new_material("Glow", "ShaderNodeBsdfPrincipled", Base_Color=(0, 0, 0), **inputs)
    add_plane(0.8, material, location=(0.2, 0.1, 1.2))
    assert_probe_agrees(tmp_path)


def test_a_constant_world_is_the_background(tmp_path):
    add_probe(256)
    _, background = new_world()
    background.inputs["Color"].default_value = (0.5, 0.25, 0.125, 1.0)
    background.inputs["Strength"].default_value = 4.0
    np.testing.assert_allclose(extract().background, (2, 1, 0.5), rtol=1e-6)
    assert extract().not_modelled == []
    assert_probe_agrees(tmp_path)


def test_no_world_is_black():
    new_scene()
    assert extract().background.tolist() == [0, 0, 0]
