"""Shader nodes -> closures: their kinds, inputs, masks and normals; notes for what is left out."""

import bpy
import numpy as np
import pytest
from blender_scenes import MaterialTree, assert_material, extract
from material_scenes import closures_of, the_closure

from lighttree_core.scene import (
    ALPHA,
    BACK,
    COAT_IOR,
    COAT_ROUGHNESS,
    COAT_TINT,
    COAT_WEIGHT,
    COLOR,
    DIFFUSE,
    DIFFUSE_ROUGHNESS,
    FRONT,
    GLASS,
    GLOSSY,
    IOR,
    LUMINANCE_OF_RGB,
    METALLIC,
    NO_TEXTURE,
    NUM_VALUES,
    PRINCIPLED,
    REFRACTION,
    RGB,
    ROUGHNESS,
    SPECULAR_LEVEL,
    SPECULAR_TINT,
    TRANSLUCENT,
    TRANSMISSION,
    TRANSPARENT,
)
from lighttree_core.scene import RED as RED_CHANNEL

pytestmark = pytest.mark.blender

RED, GREEN = (0.5, 0.0, 0.0), (0.0, 0.25, 0.0)


def test_principled_without_gloss_is_a_diffuse_closure():
    for matt in ({"Specular_IOR_Level": 0.0}, {"IOR": 1.0}):
        tree = MaterialTree()
        inputs = {"Base_Color": GREEN, "Diffuse_Roughness": 0.25, **matt}
        tree.surface(tree.add("ShaderNodeBsdfPrincipled", **inputs))
        closure = the_closure(extract())
        assert (closure.kind, closure.values[ROUGHNESS]) == (DIFFUSE, 0.25)
        np.testing.assert_allclose(closure.values[COLOR : COLOR + 3], GREEN)


def test_principled_is_one_closure_of_all_its_inputs():
    tree = MaterialTree()
    numbers = {
        "Metallic": (METALLIC, 0.25),
        "Roughness": (ROUGHNESS, 0.125),
        "IOR": (IOR, 1.75),
        "Alpha": (ALPHA, 0.5),
        "Diffuse Roughness": (DIFFUSE_ROUGHNESS, 0.375),
        "Specular IOR Level": (SPECULAR_LEVEL, 0.625),
        "Transmission Weight": (TRANSMISSION, 0.75),
        "Coat Weight": (COAT_WEIGHT, 0.875),
        "Coat Roughness": (COAT_ROUGHNESS, 0.0625),
        "Coat IOR": (COAT_IOR, 1.25),
    }
    colors = {
        "Base Color": (COLOR, GREEN),
        "Specular Tint": (SPECULAR_TINT, RED),
        "Coat Tint": (COAT_TINT, (0.25, 0.5, 0.75)),
    }
    inputs = {key.replace(" ", "_"): x for key, (_, x) in (numbers | colors).items()}
    tree.surface(tree.add("ShaderNodeBsdfPrincipled", **inputs))
    scene = extract()
    closure = the_closure(scene)
    assert closure.kind == PRINCIPLED and closure.multiscatter
    assert closure.weight.tolist() == [1, 1, 1]
    expected = np.zeros(NUM_VALUES)
    for column, number in numbers.values():
        expected[column] = number
    for column, color in colors.values():
        expected[column : column + 3] = color
    np.testing.assert_array_equal(closure.values, expected.astype(np.float32))
    assert (closure.value_texture == NO_TEXTURE).all() and closure.normal_texture == NO_TEXTURE
    np.testing.assert_allclose(scene.materials.albedo[0, 0], (0, 0.125, 0))
    assert scene.not_modelled == []


def test_principled_single_scattering_and_inputs_beyond_their_limits():
    tree = MaterialTree()
    inputs = {"Base_Color": (-1, 2, 0.5), "Roughness": 1.5, "Metallic": -0.5, "Coat_IOR": 0.5}
    node = tree.surface(tree.add("ShaderNodeBsdfPrincipled", Coat_Weight=1.0, **inputs))
    node.distribution = "GGX"
    closure = the_closure(extract())
    assert not closure.multiscatter
    values = closure.values
    assert values[[COLOR, COLOR + 1, ROUGHNESS, METALLIC, COAT_IOR]].tolist() == [0, 2, 1, 0, 1]


def test_principled_names_what_it_is_rendered_without():
    tree = MaterialTree()
    inputs = {"Subsurface_Weight": 0.5, "Sheen_Weight": 1.0, "Anisotropic": 0.5}
    node = tree.surface(tree.add("ShaderNodeBsdfPrincipled", Coat_Weight=0.5, **inputs))
    node.inputs["Emission Strength"].default_value = 1.0
    tree.link(tree.add("ShaderNodeBump"), node, "Coat Normal")
    lost = "Subsurface Weight, Sheen Weight, Anisotropic"
    assert set(extract().not_modelled) == {
        f"Material Test: Principled BSDF is rendered without {lost}.",
        "Material Test: Principled BSDF is rendered without Coat Normal.",
        "Material Test: the coat of Principled BSDF does not darken its emission.",
    }


def test_thin_walls_are_noted():
    tree = MaterialTree()
    node = tree.surface(tree.add("ShaderNodeBsdfPrincipled"))
    if "Thin Wall" not in node.inputs:
        pytest.skip("Blender 4.5 has none")
    node.inputs["Thin Wall"].default_value = True
    assert extract().not_modelled == [
        "Material Test: Principled BSDF is rendered without Thin Wall."
    ]


def test_rough_diffuse_is_a_closure():
    tree = MaterialTree()
    tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED, Roughness=0.5))
    scene = extract()
    closure = the_closure(scene)
    assert (closure.kind, closure.values[ROUGHNESS]) == (DIFFUSE, 0.5)
    np.testing.assert_allclose(scene.materials.albedo[0], [RED, RED])
    assert scene.not_modelled == []


SHADERS = {
    "ShaderNodeBsdfTranslucent": (TRANSLUCENT, {}),
    "ShaderNodeBsdfTransparent": (TRANSPARENT, {}),
    "ShaderNodeBsdfAnisotropic": (GLOSSY, {"Roughness": ROUGHNESS}),
    "ShaderNodeBsdfRefraction": (REFRACTION, {"Roughness": ROUGHNESS, "IOR": IOR}),
    "ShaderNodeBsdfGlass": (GLASS, {"Roughness": ROUGHNESS, "IOR": IOR}),
}


@pytest.mark.parametrize("shader", SHADERS)
def test_each_shader_is_a_closure_on_both_sides(shader):
    kind, numbers = SHADERS[shader]
    tree = MaterialTree()
    inputs = {key: 0.25 + column / 8 for key, column in numbers.items()}
    node = tree.surface(tree.add(shader, Color=GREEN, **inputs))
    if hasattr(node, "distribution"):
        node.distribution = "GGX"
    scene = extract()
    assert scene.not_modelled == []
    for side in (FRONT, BACK):
        closure = the_closure(scene, side)
        assert closure.kind == kind and not closure.multiscatter
        assert closure.weight.tolist() == [1, 1, 1]
        np.testing.assert_allclose(closure.values[COLOR : COLOR + 3], GREEN)
        for key, column in numbers.items():
            assert closure.values[column] == min(inputs[key], 1.0 if key == "Roughness" else 9)
    assert len(scene.closures.kind) == 1  # both sides share it
    mean = (0, 0, 0) if kind == TRANSPARENT else GREEN
    np.testing.assert_allclose(scene.materials.albedo[0], [mean, mean])


@pytest.mark.parametrize("shader", ["ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfGlass"])
def test_distributions(shader):
    tree = MaterialTree()
    node = tree.surface(tree.add(shader, Roughness=0.5))
    assert node.distribution == "MULTI_GGX" and the_closure(extract()).multiscatter
    node.distribution = "BECKMANN"
    scene = extract()
    assert not the_closure(scene).multiscatter
    text = f"the distribution Beckmann of {node.name} is rendered as GGX."
    assert scene.not_modelled == [f"Material Test: {text}"]
    node.inputs["Roughness"].default_value = 0.0  # where all are the same
    assert extract().not_modelled == []


def test_anisotropy_and_thin_films_are_noted():
    tree = MaterialTree()
    glossy = tree.surface(tree.add("ShaderNodeBsdfAnisotropic", Anisotropy=0.5))
    assert extract().not_modelled == [
        f"Material Test: {glossy.name} is rendered without Anisotropy."
    ]
    glass = tree.surface(tree.add("ShaderNodeBsdfGlass"))
    if "Thin Film Thickness" in glass.inputs:
        glass.inputs["Thin Film Thickness"].default_value = 300.0
        assert extract().not_modelled == [
            f"Material Test: {glass.name} is rendered without Thin Film Thickness."
        ]


def test_metallic_is_the_metal_of_principled():
    tree = MaterialTree()
    inputs = {"Base_Color": GREEN, "Edge_Tint": RED, "Roughness": 0.25}
    node = tree.surface(tree.add("ShaderNodeBsdfMetallic", **inputs))
    closure = the_closure(extract())
    assert closure.kind == PRINCIPLED and closure.multiscatter
    values = closure.values
    assert (values[METALLIC], values[ROUGHNESS], values[ALPHA]) == (1, 0.25, 1)
    np.testing.assert_allclose(values[COLOR : COLOR + 3], GREEN)
    np.testing.assert_allclose(values[SPECULAR_TINT : SPECULAR_TINT + 3], RED)
    node.fresnel_type = "PHYSICAL_CONDUCTOR"
    node.inputs["IOR"].default_value = (1.5, 0.2, 2.0)
    node.inputs["Extinction"].default_value = (0.0, 3.0, 4.0)
    scene = extract()
    # |n + ik - 1|^2 / |n + ik + 1|^2
    expected = (0.04, (0.64 + 9) / (1.44 + 9), (1 + 16) / (9 + 16))
    np.testing.assert_allclose(the_closure(scene).values[COLOR : COLOR + 3], expected, rtol=1e-6)
    text = "Metallic BSDF is rendered with the F82 model that is nearest to its IOR."
    assert scene.not_modelled == [f"Material Test: {text}"]


def test_shaders_that_differ_stay_apart_and_matt_ones_become_one():
    tree = MaterialTree()
    matt, glass = tree.add("ShaderNodeBsdfDiffuse", Color=RED), tree.add("ShaderNodeBsdfGlass")
    add, mix = tree.add("ShaderNodeAddShader"), tree.surface(tree.add("ShaderNodeMixShader"))
    tree.link(matt, add, 0)
    tree.link(glass, add, 1)
    tree.link(add, mix, 1)
    tree.link(matt, mix, 2)
    mix.inputs[0].default_value = 0.25
    scene = extract()
    diffuse, glass = closures_of(scene)
    assert (diffuse.kind, glass.kind) == (DIFFUSE, GLASS)
    np.testing.assert_allclose(diffuse.weight * diffuse.values[:3], RED, rtol=1e-6)
    assert glass.weight.tolist() == [0.75, 0.75, 0.75]
    np.testing.assert_allclose(scene.materials.albedo[0, 0], np.add(RED, 0.75), rtol=1e-6)


def test_a_texture_masks_one_shader_and_what_is_left_the_other():
    tree = MaterialTree()
    mix = tree.surface(tree.add("ShaderNodeMixShader"))
    tree.link(tree.add("ShaderNodeVertexColor"), mix, 0)
    tree.link(tree.add("ShaderNodeBsdfTransparent"), mix, 1)
    tree.link(tree.add("ShaderNodeBsdfDiffuse", Color=RED), mix, 2)
    scene = extract()
    transparent, diffuse = closures_of(scene)
    assert (transparent.kind, diffuse.kind) == (TRANSPARENT, DIFFUSE)
    textures = scene.textures
    rows = [transparent.weight_texture, diffuse.weight_texture]
    assert textures.output[rows].tolist() == [LUMINANCE_OF_RGB] * 2
    assert textures.bias[rows].tolist() == [[1, 1, 1], [0, 0, 0]]
    assert textures.scale[rows].tolist() == [[-1, -1, -1], [1, 1, 1]]
    assert transparent.weight.tolist() == diffuse.weight.tolist() == [1, 1, 1]
    assert scene.not_modelled == []


def test_of_masks_within_masks_the_inner_ones_are_their_means():
    tree = MaterialTree()
    outer, inner = tree.surface(tree.add("ShaderNodeMixShader")), tree.add("ShaderNodeMixShader")
    for mix, name in ((outer, "A"), (inner, "B")):
        mask = tree.add("ShaderNodeVertexColor")
        mask.layer_name = name
        tree.link(mask, mix, 0)
    tree.link(tree.add("ShaderNodeBsdfTransparent"), outer, 1)
    tree.link(inner, outer, 2)
    tree.link(tree.add("ShaderNodeBsdfDiffuse", Color=RED), inner, 1)
    tree.link(tree.add("ShaderNodeBsdfGlass"), inner, 2)
    scene = extract()
    transparent, diffuse, glass = closures_of(scene)
    np.testing.assert_allclose([diffuse.weight, glass.weight], 0.5)
    assert diffuse.weight_texture == glass.weight_texture != transparent.weight_texture
    text = "of textures that mask each other, all but the outermost are replaced by their means."
    assert scene.not_modelled == [f"Material Test: {text}"]


def test_textures_at_the_inputs_of_closures():
    tree = MaterialTree()
    node = tree.surface(tree.add("ShaderNodeBsdfPrincipled"))
    color = tree.add("ShaderNodeVertexColor")
    for key in ("Base Color", "Roughness", "Alpha"):
        tree.link(color, node, key)
    scene = extract()
    closure = the_closure(scene)
    rows = closure.value_texture[[COLOR, ROUGHNESS, ALPHA]]
    assert scene.textures.output[rows].tolist() == [RGB, LUMINANCE_OF_RGB, LUMINANCE_OF_RGB]
    assert rows[1] == rows[2]  # equal textures share a row
    others = np.delete(closure.value_texture, [COLOR, ROUGHNESS, ALPHA])
    assert (others == NO_TEXTURE).all()
    assert scene.not_modelled == []


def test_a_texture_that_emits_has_its_strength_apart():
    tree = MaterialTree()
    emission = tree.surface(tree.add("ShaderNodeEmission", Strength=5.0))
    tree.link(tree.add("ShaderNodeVertexColor"), emission, "Color")
    scene = extract()
    assert scene.materials.emission[0, 0].tolist() == [5, 5, 5]
    row = scene.materials.emission_texture[0, 0]
    assert scene.textures.scale[row].tolist() == [1, 1, 1]
    assert scene.textures.bias[row].tolist() == [0, 0, 0]
    assert scene.materials.num_closures.tolist() == [[0, 0]]


def test_emission_of_principled_is_scaled_by_a_textured_alpha():
    tree = MaterialTree()
    inputs = {"Emission_Color": RED, "Emission_Strength": 4.0}
    node = tree.surface(tree.add("ShaderNodeBsdfPrincipled", **inputs))
    tree.link(tree.add("ShaderNodeVertexColor"), node, "Alpha", output=1)
    scene = extract()
    assert scene.materials.emission[0, 0].tolist() == [2, 1, 1]  # of what is 0, no matter
    row = scene.materials.emission_texture[0, 0]
    assert scene.textures.scale[row].tolist() == [1, 0, 0]


def test_several_textures_that_emit_are_noted():
    tree = MaterialTree()
    add = tree.surface(tree.add("ShaderNodeAddShader"))
    for i, name in enumerate("AB"):
        emission, color = tree.add("ShaderNodeEmission"), tree.add("ShaderNodeVertexColor")
        color.layer_name = name
        tree.link(color, emission, "Color")
        tree.link(emission, add, i)
    scene = extract()
    row = scene.materials.emission_texture[0, 0]
    # One texture and the mean of the other, 0.5.
    at_most = scene.materials.emission[0, 0, 0]
    np.testing.assert_allclose(at_most * scene.textures.scale[row], 1)
    np.testing.assert_allclose(at_most * scene.textures.bias[row], 0.5)
    text = "of several textures that emit, all but one are replaced by their means."
    assert scene.not_modelled == [f"Material Test: {text}"]


def test_more_lobes_than_there_is_room_for_are_noted():
    tree = MaterialTree()
    last = tree.add("ShaderNodeBsdfPrincipled")
    for _ in range(8):
        add = tree.add("ShaderNodeAddShader")
        tree.link(last, add, 0)
        tree.link(tree.add("ShaderNodeBsdfPrincipled"), add, 1)
        last = add
    tree.surface(last)
    text = "of its shaders no more than 16 lobes are rendered."
    assert extract().not_modelled == [f"Material Test: {text}"]


def _normal_mapped(shader="ShaderNodeBsdfDiffuse"):
    """(a material with a Normal Map, that node, the shader)."""
    tree = MaterialTree()
    image, node = tree.add("ShaderNodeTexImage"), tree.add("ShaderNodeNormalMap", Strength=0.5)
    image.image = bpy.data.images.new("Bumps", 4, 4)
    surface = tree.surface(tree.add(shader))
    tree.link(image, node, "Color")
    tree.link(node, surface, "Normal")
    return tree, node, surface


@pytest.mark.parametrize("shader", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfPrincipled"])
def test_normal_maps_are_textures_of_closures(shader):
    _, node, _ = _normal_mapped(shader)
    scene = extract()
    closure = the_closure(scene)
    assert closure.normal_strength == 0.5
    row = closure.normal_texture
    assert (scene.textures.output[row], scene.textures.scale[row].tolist()) == (RGB, [1, 1, 1])
    assert scene.not_modelled == []
    if hasattr(node, "convention"):
        node.convention = "DIRECTX"
        scene = extract()
        row = the_closure(scene).normal_texture
        assert scene.textures.scale[row].tolist() == [1, -1, 1]
        assert scene.textures.bias[row].tolist() == [0, 1, 0]


def test_normal_maps_that_are_left_out():
    _, node, _ = _normal_mapped()
    node.space = "OBJECT"
    assert extract().not_modelled == [
        "Material Test: Normal of Diffuse BSDF comes from Normal Map, which is left out."
    ]
    tree, node, surface = _normal_mapped()
    node.uv_map = "Other"
    node.inputs["Strength"].default_value = 0.0
    assert_material(albedo=(0.8, 0.8, 0.8))
    flat = tree.add("ShaderNodeNormalMap")
    tree.link(flat, surface, "Normal")
    assert_material(albedo=(0.8, 0.8, 0.8))
    flat.inputs["Color"].default_value = (0.5, 0.6, 1.0, 1.0)
    text = "Normal Map.001 is left out, as its Color is the same everywhere."
    assert_material(albedo=(0.8, 0.8, 0.8), notes=[f"Material Test: {text}"])


def _bump(tree, surface, **inputs):
    """A Bump node of an image whose red is the height, linked to a shader."""
    image, bump = tree.add("ShaderNodeTexImage"), tree.add("ShaderNodeBump", **inputs)
    image.image = bpy.data.images.new("Heights", 4, 4)
    channels = tree.add("ShaderNodeSeparateColor")
    tree.link(image, channels, "Color")
    tree.link(channels, bump, "Height")
    tree.link(bump, surface, "Normal")
    return bump


@pytest.mark.parametrize("invert", [False, True])
@pytest.mark.parametrize("shader", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfPrincipled"])
def test_bumps_are_heights_of_closures_over_their_normal_maps(shader, invert):
    tree, node, surface = _normal_mapped(shader)
    bump = _bump(tree, surface, Strength=0.7, Distance=0.02)
    bump.invert = invert
    for side in (FRONT, BACK):
        scene = extract()
        closure, textures = the_closure(scene, side), scene.textures
        assert closure.normal_texture == NO_TEXTURE
        assert closure.bump_strength == np.float32(0.7)
        height = closure.height_texture
        assert (textures.output[height], textures.bias[height, 0]) == (RED_CHANNEL, 0)
        assert textures.scale[height, 0] == np.float32(-0.02 if invert else 0.02)
    tree.link(node, bump, "Normal")
    scene = extract()
    assert the_closure(scene).normal_texture != NO_TEXTURE != the_closure(scene).height_texture
    assert scene.not_modelled == []


def test_bumps_that_are_left_out():
    tree = MaterialTree()
    surface = tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED))
    bump = _bump(tree, surface, Strength=0.0)
    assert_material(albedo=RED)
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = 1.0, 0.0
    assert_material(albedo=RED)
    bump.inputs["Distance"].default_value = 1.0
    under = _bump(tree, bump)
    text = "Material Test: of bumps upon bumps only Bump is rendered."
    assert extract().not_modelled == [text]
    tree.nodes.nodes.remove(under)
    tree.link(tree.add("ShaderNodeFresnel"), bump, "Height")
    text = "Material Test: Height of Bump is left out, as it hangs on the ray."
    assert_material(albedo=RED, notes=[text])


def test_displacement_that_hangs_on_the_ray_is_told():
    tree = MaterialTree()
    displacement = tree.add("ShaderNodeDisplacement")
    displacement.space = "WORLD"
    tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED))
    tree.link(tree.add("ShaderNodeFresnel"), displacement, "Height")
    tree.link(displacement, tree.output, "Displacement")
    text = "Height of Displacement is left out, as it hangs on the ray."
    assert_material(albedo=RED, notes=[f"Material Test: {text}"])


@pytest.mark.parametrize("method", ["BUMP", "DISPLACEMENT", "BOTH"])
@pytest.mark.parametrize("space", ["OBJECT", "WORLD"])
def test_displacement_bends_normals_that_nothing_else_bends(method, space):
    tree, _, mapped = _normal_mapped()
    displacement = tree.add("ShaderNodeDisplacement", Scale=0.3)
    displacement.space, tree.material.displacement_method = space, method
    image = tree.add("ShaderNodeTexImage")
    image.image = bpy.data.images.new("Heights", 4, 4)
    tree.link(image, displacement, "Height")
    tree.link(displacement, tree.output, "Displacement")
    add, plain = tree.add("ShaderNodeAddShader"), tree.add("ShaderNodeBsdfDiffuse", Color=RED)
    tree.link(mapped, add, 0)
    tree.link(plain, add, 1)
    tree.surface(add)
    scene = extract()
    of_map, of_plain = closures_of(scene)
    assert of_map.height_texture == NO_TEXTURE == of_plain.normal_texture
    row = of_plain.height_texture
    assert scene.textures.output[row] == LUMINANCE_OF_RGB
    assert (scene.textures.scale[row, 0], of_plain.bump_strength) == (np.float32(0.3), 1)
    notes = []
    if space == "OBJECT":
        notes.append("heights of Displacement are those of objects of scale 1.")
    if method != "BUMP":
        notes.append("its displacement is rendered as bumps.")
    assert scene.not_modelled == [f"Material Test: {note}" for note in notes]


def test_the_normal_of_the_geometry_is_the_surfaces_own():
    tree = MaterialTree()
    diffuse = tree.surface(tree.add("ShaderNodeBsdfDiffuse", Color=RED))
    geometry = tree.add("ShaderNodeNewGeometry")
    tree.link(geometry, diffuse, "Normal", geometry.outputs.find("Normal"))
    assert_material(albedo=RED)


def test_volume_shaders_add_nothing_to_a_surface():
    tree = MaterialTree()
    add = tree.surface(tree.add("ShaderNodeAddShader"))
    tree.link(tree.add("ShaderNodeBsdfDiffuse", Color=RED), add, 0)
    tree.link(tree.add("ShaderNodeVolumeAbsorption"), add, 1)
    assert_material(albedo=RED)
