"""Images and attributes of materials: values, places and colour spaces are those of Cycles."""

import bpy
import numpy as np
import pytest
from blender_scenes import MaterialTree, extract, radians
from material_scenes import PIXELS, picture_row, the_closure

from lighttree_addon.math_nodes import turn_hue
from lighttree_core.scene import (
    ALPHA,
    CLOSEST,
    COLOR,
    COLOR_ATTRIBUTE,
    LINEAR,
    LUMINANCE_OF_RGB,
    OPACITY,
    RED,
    RGB,
    ROUGHNESS,
)

pytestmark = pytest.mark.blender


def new_image(
    name="Bricks", is_float=False, space=None, multiplied=False, shape=(3, 4), alpha=True
):
    """A small picture; multiplied: its colours by its alpha."""
    image = bpy.data.images.new(name, shape[1], shape[0], alpha=True, float_buffer=is_float)
    if space:  # first, as it makes Blender forget the pixels
        image.colorspace_settings.name = space
    pixels = np.random.default_rng(7).uniform(0.1, 1, (*shape, 4)).astype(np.float32)
    if not alpha:
        pixels[..., 3] = 1
    if multiplied:
        pixels[..., :3] *= pixels[..., 3:]
    image.pixels.foreach_set(pixels.ravel())
    return image


def saved(image, tmp_path):
    """A picture, from a file."""
    image.file_format = "OPEN_EXR" if image.is_float else "PNG"
    image.filepath_raw = str(tmp_path / ("bricks.exr" if image.is_float else "bricks.png"))
    image.save()
    return bpy.data.images.load(image.filepath_raw)


def add_image(tree, image, **settings):
    """An Image Texture node."""
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    for name, value in settings.items():
        setattr(node, name, value)
    return node


def assert_pictures_agree(cases, build, tmp_path):
    ours, cycles, notes = picture_row(cases, build, tmp_path)
    assert notes == []
    for i, case in enumerate(cases):
        own, seen = (p[:, PIXELS * i : PIXELS * (i + 1)] for p in (ours, cycles))
        # 64 of Cycles' samples against 9 of ours; its sRGB curve is 0.2 % off.
        np.testing.assert_allclose(own, seen, atol=0.02, rtol=0.02, err_msg=str(case))
        np.testing.assert_allclose(own.mean(), seen.mean(), rtol=0.005, err_msg=str(case))


@pytest.mark.parametrize("from_file", [False, True])
def test_colours_and_alpha(from_file, tmp_path):
    def build(case, tree, emission, mesh):
        is_float, space, mode, output = case
        image = new_image(is_float=is_float, space=space, multiplied=is_float)
        if from_file:
            image = saved(image, tmp_path)
            image.colorspace_settings.name = space
        image.alpha_mode = mode
        node = add_image(tree, image)
        tree.links.new(node.outputs[output], emission.inputs["Color"])

    cases = [
        (is_float, space, mode, output)
        for is_float, space in ((False, "sRGB"), (False, "Non-Color"), (True, "Linear Rec.709"))
        for mode in ("STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE")
        for output in ("Color", "Alpha")
    ]
    # What is not usual for a file format is no matter on which versions of Cycles agree.
    unusual = (False, "PREMUL"), (True, "STRAIGHT")
    cases = [case for case in cases if case[::2] not in unusual]
    assert_pictures_agree(cases, build, tmp_path)


@pytest.mark.parametrize("interpolation", ["Linear", "Closest"])
def test_colour_beside_alpha_is_not_multiplied_by_it(interpolation, tmp_path):
    def build(is_float, tree, emission, mesh):
        image = new_image(is_float=is_float, multiplied=is_float)
        node = add_image(tree, image, interpolation=interpolation)
        node.image.alpha_mode = "PREMUL" if is_float else "STRAIGHT"
        tree.links.new(node.outputs["Color"], emission.inputs["Color"])
        # A link to what is not rendered counts too, so nothing else may use the alpha.
        add = tree.nodes.new("ShaderNodeMath")
        add.operation = "MULTIPLY_ADD"
        add.inputs[1].default_value, add.inputs[2].default_value = 0.0, 1.0
        tree.links.new(node.outputs["Alpha"], add.inputs[0])
        tree.links.new(add.outputs[0], emission.inputs["Strength"])

    ours, cycles, notes = picture_row([False, True], build, tmp_path, samples=256)
    assert notes == []
    assert np.abs(ours - cycles).mean() < 0.01


@pytest.mark.parametrize("interpolation", ["Linear", "Closest"])
def test_places_in_the_image(interpolation, tmp_path):
    def build(case, tree, emission, mesh):
        extension, kind, location, angles, scale = case
        image = new_image(alpha=False)
        node = add_image(tree, image, extension=extension, interpolation=interpolation)
        mapping = tree.nodes.new("ShaderNodeMapping")
        mapping.vector_type = kind
        mapping.inputs[1].default_value = location
        mapping.inputs[2].default_value = radians(*angles)
        mapping.inputs[3].default_value = scale
        coordinates = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs[0], node.inputs["Vector"])
        tree.links.new(node.outputs["Color"], emission.inputs["Color"])

    move, turn, grow = (0.3, -0.2, 0.5), (0, 0, 30), (1.5, 2.0, 1.0)
    cases = [(x, "POINT", move, (0, 0, 0), grow) for x in ("REPEAT", "EXTEND", "CLIP", "MIRROR")]
    cases += [("REPEAT", kind, move, turn, grow) for kind in ("POINT", "TEXTURE", "VECTOR")]
    cases += [("REPEAT", kind, move, (20, 40, 60), grow) for kind in ("POINT", "TEXTURE")]
    ours, cycles, notes = picture_row(cases, build, tmp_path, samples=256, per_pixel=6)
    assert notes == []
    # Of blocks of one colour, a pixel at an edge is right within a sixth of their difference.
    error = np.abs(ours - cycles)
    assert error.mean() < (0.002 if interpolation == "Linear" else 0.01), error.mean()


def test_uv_maps_are_found_by_name_and_without_one_the_one_to_render_with(tmp_path):
    def build(case, tree, emission, mesh):
        other = mesh.uv_layers.new(name="Other")
        other.uv.foreach_set("vector", [1, 0, 1, 1, 0, 1, 0, 0])
        mesh.uv_layers["Other"].active_render = case == "to render with"
        node = add_image(tree, new_image(alpha=False))
        if case == "attribute":
            source = tree.nodes.new("ShaderNodeAttribute")
            source.attribute_name = "Other"
            tree.links.new(source.outputs["Vector"], node.inputs["Vector"])
        elif case != "to render with":
            source = tree.nodes.new("ShaderNodeUVMap")
            source.uv_map = case
            tree.links.new(source.outputs[0], node.inputs["Vector"])
        tree.links.new(node.outputs["Color"], emission.inputs["Color"])

    cases = ["UVMap", "Other", "Not there", "", "to render with", "attribute"]
    assert_pictures_agree(cases, build, tmp_path)


def test_places_are_projected(tmp_path):
    def build(case, tree, emission, mesh):
        space, kind, has_box = case
        node, mapping = add_image(tree, new_image(alpha=False)), tree.nodes.new("ShaderNodeMapping")
        mapping.vector_type = kind
        for socket, numbers in zip(
            mapping.inputs[1:],
            ((0.3, -0.2, 0.5), radians(20, 40, 60), (1.5, 2.0, 1.2)),
            strict=False,
        ):
            socket.default_value = numbers
        coordinates = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(coordinates.outputs[space], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs[0], node.inputs["Vector"])
        tree.links.new(node.outputs["Color"], emission.inputs["Color"])
        mesh.vertices[2].co.z = -0.4
        if has_box:
            mesh.use_auto_texspace = False
            mesh.texspace_location, mesh.texspace_size = (0.2, 0.1, 0.3), (0.4, 0.8, 0.5)

    spaces = [("Object", False), ("Generated", False), ("Generated", True)]
    cases = [(space, kind, box) for space, box in spaces for kind in ("POINT", "TEXTURE")]
    assert_pictures_agree(cases, build, tmp_path)


def test_generated_coordinates_of_what_is_modified_are_noted():
    tree = MaterialTree()
    image, coordinates = add_image(tree.nodes, new_image()), tree.add("ShaderNodeTexCoord")
    tree.link(coordinates, image)
    tree.link(image, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    assert extract().not_modelled == []
    bpy.data.objects[-1].modifiers.new("Wave", "WAVE")
    (note,) = extract().not_modelled
    assert note.endswith("its Generated coordinates are as modified.")


def test_nodes_that_are_lines_are_folded_into_the_texture(tmp_path):
    def build(case, tree, emission, mesh):
        image = add_image(tree, new_image(alpha=False)).outputs["Color"]
        nodes = tree.nodes
        if case == "channels":
            apart, together = (nodes.new(f"ShaderNode{x}Color") for x in ("Separate", "Combine"))
            invert = nodes.new("ShaderNodeInvert")
            tree.links.new(image, apart.inputs[0])
            tree.links.new(apart.outputs[1], invert.inputs[1])
            tree.links.new(apart.outputs[0], together.inputs[0])
            tree.links.new(invert.outputs[0], together.inputs[1])
            together.inputs[2].default_value = 0.3
            tree.links.new(together.outputs[0], emission.inputs["Color"])
            return
        if case == "mixed with its inverse":
            node, invert = nodes.new("ShaderNodeMixRGB"), nodes.new("ShaderNodeInvert")
            node.inputs[0].default_value = 0.2
            tree.links.new(image, invert.inputs[1])
            tree.links.new(image, node.inputs[1])
            tree.links.new(invert.outputs[0], node.inputs[2])
        elif case in ("ramp", "factor"):
            is_ramp = case == "ramp"
            node = nodes.new("ShaderNodeValToRGB" if is_ramp else "ShaderNodeMixRGB")
            tree.links.new(image, node.inputs[0])
            if not is_ramp:
                node.inputs[2].default_value = (0.1, 0.9, 0.4, 1)
        elif case in ("MULTIPLY", "SCREEN", "SUBTRACT"):
            node = nodes.new("ShaderNodeMixRGB")
            node.blend_type, node.inputs[0].default_value = case, 0.7
            node.inputs[1].default_value = (0.9, 0.8, 0.7, 1)
            tree.links.new(image, node.inputs[2])
        elif case == "number":
            node = nodes.new("ShaderNodeMath")
            node.operation = "MULTIPLY_ADD"
            tree.links.new(image, node.inputs[0])
        else:
            node = nodes.new(case)
            tree.links.new(
                image, node.inputs["Vector" if case == "ShaderNodeVectorMath" else "Color"]
            )
            if case == "ShaderNodeHueSaturation":
                node.inputs["Value"].default_value = 0.6
            if case == "ShaderNodeBrightContrast":
                node.inputs["Contrast"].default_value = -0.5
        tree.links.new(node.outputs[0], emission.inputs["Color"])

    cases = ["channels", "mixed with its inverse", "ramp", "factor", "MULTIPLY", "SCREEN"]
    cases += ["SUBTRACT", "number", "ShaderNodeVectorMath", "ShaderNodeHueSaturation"]
    cases += ["ShaderNodeBrightContrast", "ShaderNodeRGBToBW", "ShaderNodeGamma"]
    assert_pictures_agree(cases, build, tmp_path)


def _ramp(nodes, interpolation, *stops):
    node = nodes.new("ShaderNodeValToRGB")
    ramp = node.color_ramp
    ramp.interpolation = interpolation
    while len(ramp.elements) < len(stops):
        ramp.elements.new(0.5)
    for element, (position, color) in zip(ramp.elements, stops, strict=True):
        element.position, element.color = position, (*color, 1.0)
    return node


def test_what_nodes_do_to_each_number_of_a_texture_is_its_curve(tmp_path):
    stops = (0.1, (0.9, 0.1, 0.2)), (0.4, (0.1, 0.8, 0.3)), (0.75, (0.2, 0.3, 1.0))

    def build(case, tree, emission, mesh):
        nodes, links = tree.nodes, tree.links
        node = add_image(tree, new_image(alpha=False))
        image = node.outputs["Color"]
        if case in ("LINEAR", "EASE", "CONSTANT"):
            last = _ramp(nodes, case, *stops)
        elif case == "gamma":
            last = nodes.new("ShaderNodeGamma")
            last.inputs["Gamma"].default_value = 2.2
        elif case == "curves":
            last = nodes.new("ShaderNodeRGBCurve")
            for curve in last.mapping.curves[:2]:
                curve.points.new(0.3, 0.8)
            last.mapping.update()
        elif case == "attribute":
            colors = mesh.color_attributes.new("Paint", "FLOAT_COLOR", "CORNER")
            colors.data.foreach_set("color", np.linspace(-0.5, 1.5, 16))
            source, last = nodes.new("ShaderNodeVertexColor"), _ramp(nodes, "LINEAR", *stops)
            image = source.outputs["Color"]
        elif case == "square":
            last = nodes.new("ShaderNodeVectorMath")
            last.operation = "MULTIPLY"
            links.new(image, last.inputs[1])
        else:
            # A ramp of a channel, brightened, times a power of the same channel.
            apart, power = nodes.new("ShaderNodeSeparateColor"), nodes.new("ShaderNodeMath")
            first, last = _ramp(nodes, "LINEAR", *stops), nodes.new("ShaderNodeMixRGB")
            links.new(image, apart.inputs[0])
            power.operation, power.inputs[1].default_value = "POWER", 3.0
            links.new(apart.outputs[1], power.inputs[0])
            links.new(apart.outputs[1], first.inputs[0])
            links.new(first.outputs[0], last.inputs[1])
            links.new(power.outputs[0], last.inputs[2])
            last.blend_type, last.inputs[0].default_value = "MULTIPLY", 0.6
        if not last.inputs[0].is_linked and case != "channel":
            key = {"gamma": "Color", "curves": "Color"}.get(case, 0)
            links.new(image, last.inputs[key])
        links.new(last.outputs[0], emission.inputs["Color"])

    cases = ["LINEAR", "EASE", "CONSTANT", "gamma", "curves", "attribute", "square", "channel"]
    ours, cycles, notes = picture_row(cases, build, tmp_path, samples=256, per_pixel=6)
    assert notes == []
    for i, case in enumerate(cases):
        own, seen = (p[:, PIXELS * i : PIXELS * (i + 1)] for p in (ours, cycles))
        # At steps, a pixel is right within a sixth of their height.
        assert np.abs(own - seen).mean() < (0.01 if case == "CONSTANT" else 0.004), case
        assert np.ptp(seen) > 0.2, case


def test_attributes_beyond_0_to_1_have_no_curve_but_of_what_clamps_them():
    tree = MaterialTree()
    paint, gamma = tree.add("ShaderNodeVertexColor"), tree.add("ShaderNodeGamma", Gamma=2.0)
    tree.link(paint, gamma)
    tree.link(gamma, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    (note,) = extract().not_modelled
    assert "of which only the mean is used" in note


def test_a_curve_keeps_the_mean_of_what_it_makes():
    tree = MaterialTree()
    image = add_image(tree.nodes, new_image(alpha=False))
    gamma = tree.add("ShaderNodeGamma", Gamma=2.0)
    tree.link(image, gamma)
    tree.link(gamma, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    rgb = np.rint(np.array(image.image.pixels[:]).reshape(-1, 4)[:, :3] * 255) / 255
    linear = np.where(rgb < 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    albedo = extract().materials.albedo[0, 0]
    np.testing.assert_allclose(albedo, (linear**2).mean(axis=0), rtol=1e-3)


def test_what_mixes_the_numbers_of_a_texture_is_known_of_the_mean():
    tree = MaterialTree()
    image = add_image(tree.nodes, new_image(alpha=False))
    turned = tree.add("ShaderNodeHueSaturation", Hue=0.7)
    tree.link(image, turned, "Color")
    tree.link(turned, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    scene = extract()
    rgb = np.rint(np.array(image.image.pixels[:]).reshape(-1, 4)[:, :3] * 255) / 255
    mean = np.where(rgb < 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4).mean(axis=0)
    expected = turn_hue([0.7], np.ones(3), np.ones(3), 1.0, mean[:, None])[:, 0]
    np.testing.assert_allclose(scene.materials.albedo[0, 0], expected, rtol=1e-5)
    numbers = ", ".join(f"{number:.3g}" for number in mean)
    assert scene.not_modelled == [
        "Material Test: Color of Hue/Saturation/Value comes from Image Texture, of which only the "
        f"mean is used: {numbers}."
    ]


def test_attributes_of_every_kind(tmp_path):
    def build(case, tree, emission, mesh):
        node_kind, data_type, domain, output = case
        name = "" if case == CASE_OF_DEFAULT else "Paint"
        attribute = mesh.attributes.new("Paint", data_type, domain)
        rng, num = np.random.default_rng(7), len(attribute.data)
        key, width = {"FLOAT": ("value", 1), "INT": ("value", 1)}.get(data_type, ("vector", 3))
        if data_type.endswith("COLOR"):
            key, width = "color", 4
        numbers = rng.uniform(0, 1, num * width) if data_type != "INT" else np.arange(num)
        attribute.data.foreach_set(key, numbers)
        node = tree.nodes.new(node_kind)
        setattr(node, "layer_name" if node_kind.endswith("VertexColor") else "attribute_name", name)
        source = next(x for x in node.outputs if x.identifier == output)
        tree.links.new(source, emission.inputs["Color"])

    color, any_kind = "ShaderNodeVertexColor", "ShaderNodeAttribute"
    CASE_OF_DEFAULT = (color, "BYTE_COLOR", "POINT", "Color")
    cases = [CASE_OF_DEFAULT]
    cases += [
        (color, data_type, domain, output)
        for data_type, domain in (("FLOAT_COLOR", "POINT"), ("BYTE_COLOR", "CORNER"))
        for output in ("Color", "Alpha")
    ]
    cases += [
        (any_kind, data_type, domain, output)
        for data_type, domain in (
            ("FLOAT_COLOR", "CORNER"),
            ("FLOAT", "POINT"),
            ("FLOAT_VECTOR", "FACE"),
            ("INT", "POINT"),
        )
        for output in ("Color", "Vector", "Fac", "Alpha")
    ]
    ours, cycles, notes = picture_row(cases, build, tmp_path, samples=256)
    assert notes == []
    for i, case in enumerate(cases):
        own, seen = (p[:, PIXELS * i : PIXELS * (i + 1)] for p in (ours, cycles))
        np.testing.assert_allclose(own, seen, atol=0.02, rtol=0.02, err_msg=str(case))


@pytest.mark.parametrize(
    "settings, text",
    [
        ({"interpolation": "Cubic"}, "Cubic interpolation of Image Texture is rendered as Linear."),
        ({"interpolation": "Smart"}, "Smart interpolation of Image Texture is rendered as Linear."),
        (
            {"projection": "BOX"},
            "image Bricks in Image Texture is replaced by its mean, as its projection Box is not "
            "modelled.",
        ),
    ],
)
def test_settings_that_are_not_modelled_are_noted(settings, text):
    tree = MaterialTree()
    image = add_image(tree.nodes, new_image(), **settings)
    tree.link(image, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    assert extract().not_modelled == [f"Material Test: {text}"]


def test_images_that_are_not_modelled_are_noted():
    for make, text in (
        (
            lambda: bpy.data.images.new("Bricks", 4, 4, tiled=True),
            "the first of its tiles is rendered everywhere.",
        ),
        (
            lambda: new_image(space="Linear Rec.2020"),
            None,
        ),
    ):
        tree = MaterialTree()
        tree.link(
            add_image(tree.nodes, make()), tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color"
        )
        text = text or "is read as sRGB, not as Linear Rec.2020."
        (note,) = extract().not_modelled
        assert note.startswith("Material Test: image Bricks") and note.endswith(text)


def test_mapping_of_a_constant_is_no_place():
    tree = MaterialTree()
    image = add_image(tree.nodes, new_image())
    tree.link(tree.add("ShaderNodeMapping"), image)
    tree.link(image, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    text = "is replaced by its mean, as Vector of Mapping is not modelled."
    assert extract().not_modelled == [f"Material Test: image Bricks in Image Texture {text}"]


def test_an_image_is_stored_once():
    tree = MaterialTree()
    principled = tree.surface(tree.add("ShaderNodeBsdfPrincipled"))
    image = new_image(alpha=False)
    for key, output in (("Base Color", 0), ("Roughness", 0), ("Alpha", 1)):
        tree.link(add_image(tree.nodes, image), principled, key, output)
    scene = extract()
    textures, closure = scene.textures, the_closure(scene)
    assert textures.size.tolist() == [[4, 3]]
    assert textures.texels.shape == (12, 4) and textures.float_texels.shape == (0, 4)
    rows = closure.value_texture[[COLOR, ROUGHNESS, ALPHA]]
    assert textures.output[rows].tolist() == [RGB, LUMINANCE_OF_RGB, OPACITY]
    clear = new_image("Clear")
    for node in tree.nodes.nodes:
        if node.bl_idname == "ShaderNodeTexImage":
            node.image = clear
    textures = extract().textures
    assert len(textures.size) == 1
    assert sorted(textures.divides_alpha.tolist()) == [False, False, True]


def test_texels_are_the_bytes_of_the_file_and_floats_follow_bytes():
    tree = MaterialTree()
    mix = tree.surface(tree.add("ShaderNodeAddShader"))
    images = new_image("Bytes", alpha=False), new_image("Floats", is_float=True, alpha=False)
    for i, image in enumerate(images):
        diffuse = tree.add("ShaderNodeBsdfDiffuse")
        node = add_image(tree.nodes, image, interpolation="Closest" if i else "Linear")
        tree.link(node, diffuse, "Color")
        tree.link(diffuse, mix, i)
    scene = extract()
    textures = scene.textures
    pixels = np.random.default_rng(7).uniform(0.1, 1, (12, 4)).astype(np.float32)
    pixels[:, 3] = 1
    np.testing.assert_array_equal(textures.texels, np.rint(pixels * 255))
    np.testing.assert_array_equal(textures.float_texels, pixels)
    assert textures.is_float.tolist() == [False, True]
    assert textures.is_srgb.tolist() == [True, False]
    assert textures.first_texel.tolist() == [0, 0]
    assert textures.interpolation.tolist() == [LINEAR, CLOSEST]
    scene.check()


def test_numbers_of_floats_that_are_not_finite_are_black_as_in_cycles():
    tree = MaterialTree()
    image = new_image(is_float=True, alpha=False)
    pixels = np.array(image.pixels[:], np.float32)
    pixels[[0, 5]] = np.nan, np.inf
    image.pixels.foreach_set(pixels)
    tree.link(add_image(tree.nodes, image), tree.surface(tree.add("ShaderNodeEmission")), "Color")
    scene = extract()
    scene.check()
    assert (scene.textures.float_texels[:2] == 0).all()
    assert np.isfinite(scene.textures.float_texels).all()


def test_attributes_are_stored_by_name_and_part():
    tree = MaterialTree()
    principled = tree.surface(tree.add("ShaderNodeBsdfPrincipled"))
    node = tree.add("ShaderNodeAttribute")
    node.attribute_name = "Paint"
    for key, output in (("Base Color", 0), ("Roughness", 2), ("Alpha", 3)):
        tree.link(node, principled, key, output)
    plane = bpy.data.objects["Plane"].data
    paint = plane.attributes.new("Paint", "FLOAT_COLOR", "POINT")
    paint.data.foreach_set("color", np.tile([0.1, 0.2, 0.6, 0.5], 4))
    scene = extract()
    textures, closure = scene.textures, the_closure(scene)
    rows = closure.value_texture[[COLOR, ROUGHNESS, ALPHA]]
    assert (textures.kind[rows] == COLOR_ATTRIBUTE).all()
    assert textures.output[rows].tolist() == [RGB, RED, RED]
    stored = scene.colors[textures.source[rows], 0, 0]
    np.testing.assert_allclose(stored, [(0.1, 0.2, 0.6), (0.3,) * 3, (0.5,) * 3], rtol=1e-6)
    assert scene.uvs.shape[0] == 0
