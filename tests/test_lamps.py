"""Every kind of lamp: what Blender's numbers mean, checked against Cycles' own irradiance."""

import math

import bpy
import numpy as np
import oracle
import pytest
from blender_scenes import (
    add_lamp,
    add_node,
    add_object,
    add_plane,
    add_probe,
    assert_probe_agrees,
    enable_nodes,
    extract,
    new_scene,
    radians,
    render,
)

from lighttree_core.scene import (
    ALL_BOUNCES,
    ALL_RAYS,
    DIFFUSE_RAY,
    DISK,
    ELLIPSE,
    GLOSSY_RAY,
    POINT,
    RECTANGLE,
    SPHERE,
    SUN,
    TRANSMISSION_RAY,
    SceneError,
)

pytestmark = pytest.mark.blender

# TILTED lamps see the origin 16.4 degrees off their axis, which is on the edge of a NARROW cone.
ABOVE = {"location": (0.5, 0.2, 1.0)}
TILTED = {"location": (0.5, 0.2, 1.0), "rotation": radians(20, 25, 30)}
SPHERE_LIKE = {"shadow_soft_size": 0.4, "use_soft_falloff": False}
DISK_LIKE = {"shadow_soft_size": 0.4, "use_soft_falloff": True}
NARROW = {"spot_size": math.radians(34)}
SOFT = {"spot_size": math.radians(60), "spot_blend": 1.0}
LONG = {"shape": "RECTANGLE", "size": 0.5, "size_y": 0.8}
OVAL = {"shape": "ELLIPSE", "size": 0.5, "size_y": 0.8}

# What the lamp is, the data-block's settings, where the object is.
LAMPS = {
    "point": ("POINT", {}, ABOVE),
    "point-not-normalized": ("POINT", {"normalize": False}, ABOVE),
    "point-scaled": ("POINT", SPHERE_LIKE, {**ABOVE, "scale": (3, 2, 1)}),
    "sphere": ("POINT", SPHERE_LIKE, ABOVE),
    "sphere-not-normalized": ("POINT", {**SPHERE_LIKE, "normalize": False}, ABOVE),
    "sphere-cut-by-horizon": ("POINT", SPHERE_LIKE, {"location": (0.5, 0, 0.1)}),
    "sphere-around-the-point": ("POINT", {**SPHERE_LIKE, "shadow_soft_size": 2.0}, ABOVE),
    "disk": ("POINT", DISK_LIKE, ABOVE),
    "disk-wider-than-far": ("POINT", {"shadow_soft_size": 1.5}, {"location": (0, 0, 1)}),
    "spot": ("SPOT", NARROW, TILTED),
    "spot-hard": ("SPOT", {**NARROW, "spot_blend": 0.0}, TILTED),
    "spot-missing": ("SPOT", {"spot_size": math.radians(32), "spot_blend": 0.0}, TILTED),
    "spot-soft": ("SPOT", SOFT, TILTED),
    "spot-180-degrees": ("SPOT", {"spot_size": math.pi, "spot_blend": 1.0}, TILTED),
    "spot-scaled": ("SPOT", SOFT, {**TILTED, "scale": (1, 2, 1.5)}),
    "spot-scaled-evenly": ("SPOT", SOFT, {**TILTED, "scale": (3, 3, 3)}),
    "spot-mirrored": ("SPOT", SOFT, {**TILTED, "scale": (-1, 1, 1)}),
    "spot-sphere": ("SPOT", {**NARROW, **SPHERE_LIKE}, TILTED),
    "spot-disk": ("SPOT", {**NARROW, **DISK_LIKE}, TILTED),
    "spot-disk-scaled": ("SPOT", {**NARROW, **DISK_LIKE}, {**TILTED, "scale": (2, 2, 1)}),
    "spot-disk-not-normalized": ("SPOT", {**NARROW, **DISK_LIKE, "normalize": False}, TILTED),
    "square": ("AREA", {"size": 0.7}, TILTED),
    "rectangle": ("AREA", LONG, TILTED),
    "rectangle-not-normalized": ("AREA", {**LONG, "normalize": False}, TILTED),
    "round": ("AREA", {"shape": "DISK", "size": 0.7}, TILTED),
    "ellipse": ("AREA", OVAL, TILTED),
    "ellipse-not-normalized": ("AREA", {**OVAL, "normalize": False}, TILTED),
    "rectangle-scaled": ("AREA", LONG, {**TILTED, "scale": (2, 0.5, 3)}),
    "ellipse-scaled": ("AREA", OVAL, {**TILTED, "scale": (2, 0.5, 3)}),
    "rectangle-scaled-not-normalized": (
        "AREA",
        {**LONG, "normalize": False},
        {**TILTED, "scale": (2, 0.5, 3)},
    ),
    "area-mirrored": ("AREA", LONG, {**TILTED, "scale": (-1, 1, 1)}),
    "area-upside-down": ("AREA", LONG, {**TILTED, "scale": (1, 1, -1)}),
    "area-upside-down-twice": (
        "AREA",
        LONG,
        {"location": (0.5, 0.2, 1), "rotation": radians(170, 0, 0), "scale": (1, 1, -1)},
    ),
    "area-spread-120": ("AREA", {**LONG, "spread": math.radians(120)}, TILTED),
    "area-spread-45": ("AREA", {**LONG, "spread": math.radians(45)}, {"location": (0.1, 0, 1)}),
    "area-spread-2": ("AREA", {**OVAL, "spread": math.radians(2)}, {"location": (0.1, 0, 1)}),
    "area-spread-not-normalized": (
        "AREA",
        {**LONG, "spread": math.radians(90), "normalize": False},
        TILTED,
    ),
    "sun-of-no-size": ("SUN", {"angle": 0.0}, TILTED),
    "sun": ("SUN", {"angle": math.radians(10)}, {**TILTED, "scale": (2, 3, 4)}),
    "sun-setting": ("SUN", {"angle": math.radians(40)}, {"rotation": radians(80, 0, 0)}),
    "sun-180-degrees": ("SUN", {"angle": math.pi}, TILTED),
    "sun-not-normalized": ("SUN", {"angle": math.radians(10), "normalize": False}, TILTED),
    "sun-of-no-size-not-normalized": ("SUN", {"angle": 0.0, "normalize": False}, TILTED),
    "exposure": ("POINT", {"exposure": 2.5}, ABOVE),
    "colour": ("POINT", {"color": (0.1, 0.5, 2.0)}, ABOVE),
    "temperature": ("AREA", {"use_temperature": True, "temperature": 3000.0}, TILTED),
    "negative": ("POINT", {"energy": -50.0}, ABOVE),
}


@pytest.mark.parametrize("name", LAMPS)
def test_irradiance_of_a_lamp_is_that_of_cycles(name, tmp_path):
    kind, settings, place = LAMPS[name]
    add_probe()
    add_lamp(kind, settings=settings, **place)
    assert_probe_agrees(tmp_path)


def test_constant_nodes_of_a_light_multiply_its_power(tmp_path):
    add_probe(64)
    light = add_lamp("POINT", **ABOVE).data
    tree = enable_nodes(light)
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    emission.inputs["Color"].default_value = (0.5, 1.0, 0.25, 1.0)
    emission.inputs["Strength"].default_value = 3.0
    assert_probe_agrees(tmp_path)
    assert extract().not_modelled == []


def test_lamps_instanced_with_a_collection_all_light_the_plane(tmp_path):
    scene = add_probe(64)
    collection = bpy.data.collections.new("Lantern")
    lamp = add_lamp("POINT", name="Bulb", location=(0, 0, 1))
    collection.objects.link(lamp)
    scene.collection.objects.unlink(lamp)
    for x in (-0.5, 0.5, 1.0):
        instancer = add_object("Instancer", None, location=(x, 0, 0.2))
        instancer.instance_type, instancer.instance_collection = "COLLECTION", collection
    assert extract().lamps.names == ["Bulb"] * 3
    assert_probe_agrees(tmp_path)


def test_kinds_follow_type_radius_and_shape():
    cases = {
        ("POINT", "shadow_soft_size", 0.0): POINT,
        ("POINT", "shadow_soft_size", 0.1): DISK,
        ("SPOT", "shadow_soft_size", 0.0): POINT,
        ("AREA", "shape", "SQUARE"): RECTANGLE,
        ("AREA", "shape", "DISK"): ELLIPSE,
        ("SUN", "angle", 0.1): SUN,
    }
    for (kind, key, value), expected in cases.items():
        new_scene()
        add_lamp(kind, settings={key: value})
        assert extract().lamps.kind.tolist() == [expected], (kind, key, value)
    new_scene()
    add_lamp("SPOT", settings=SPHERE_LIKE)
    assert extract().lamps.kind.tolist() == [SPHERE]


@pytest.mark.parametrize(
    "kind, settings, scale",
    [
        ("AREA", {"size": 0.0}, (1, 1, 1)),
        ("AREA", {"shape": "RECTANGLE", "size_y": 0.0}, (1, 1, 1)),
        ("AREA", {}, (1, 0, 1)),
        ("SPOT", {}, (0, 0, 0)),
        ("SUN", {}, (1, 1, 0)),
    ],
)
def test_lamp_without_extent_is_left_out_and_named(kind, settings, scale, tmp_path):
    add_probe(16)
    add_lamp(kind, name="Flat", settings=settings, location=(0.1, 0.1, 1), scale=scale)
    scene = extract()
    assert scene.lamps.names == []
    assert scene.not_modelled == ["Flat: left out, as its size or scale is 0."]
    assert render(tmp_path).max() == 0.0


def test_lamps_that_give_no_light_are_dropped_silently():
    new_scene()
    add_lamp("POINT", settings={"energy": 0.0})
    add_lamp("AREA").data.cycles.is_portal = True
    add_lamp("POINT", scale=(0, 0, 0), name="Lit")
    scene = extract()
    assert scene.lamps.names == ["Lit"]
    assert scene.not_modelled == []


@pytest.mark.parametrize("energy, exposure", [(math.nan, 0.0), (math.inf, 32.0)])
def test_light_that_is_not_finite_is_refused_by_name(energy, exposure):
    new_scene()
    add_lamp("POINT", name="Fine")
    add_lamp("SPOT", name="Broken", settings={"energy": energy, "exposure": exposure})
    with pytest.raises(SceneError, match=r"Lamp Broken emits .* not finite"):
        extract()


def test_each_setting_that_is_not_modelled_is_noted_with_its_lamp():
    new_scene()
    lamps = {name: add_lamp("POINT", name=name) for name in "ABCDE"}
    lamps["A"].light_linking.receiver_collection = bpy.data.collections.new("Only these")
    _link_strength(lamps["B"], "ShaderNodeLightFalloff", "Constant", Strength=7.0)
    _link_strength(lamps["C"], "ShaderNodeTexIES", "Fac")
    lamps["D"].data.shadow_soft_size = 0.1
    for name in "DE":
        lamps[name].data.cycles.use_multiple_importance_sampling = False
    add_lamp("AREA", name="F", settings={"spread": 0.0})
    scene = extract()
    assert scene.lamps.names == ["A", "B", "C", "D", "E", "F"]
    assert set(scene.not_modelled) == {
        "A: lights and darkens everything, without light linking.",
        "Light B: Strength of Emission comes from Light Falloff, which is not modelled; 1 is used.",
        "Light C: Strength of Emission comes from IES Texture, which is not modelled; 1 is used.",
        "Light D: is seen in mirrors though its Multiple Importance is off.",
        "Light F: its spread is widened to 0.06 degrees.",
    }


def _link_strength(lamp, bl_idname, output, **inputs):
    """Take the strength of a lamp from a new node."""
    tree = enable_nodes(lamp.data)
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    node = add_node(tree, bl_idname, **inputs)
    tree.links.new(node.outputs[output], emission.inputs["Strength"])


def test_what_sees_a_lamp_and_when_comes_along():
    new_scene()
    lamps = {name: add_lamp("POINT", name=name) for name in "ABCDE"}
    lamps["A"].data.use_shadow = False
    lamps["B"].visible_camera = True
    lamps["C"].visible_diffuse = False
    lamps["D"].data.cycles.max_bounces = 3
    for ray in ("diffuse", "glossy", "transmission"):
        setattr(lamps["E"], f"visible_{ray}", False)
    scene = extract()
    assert scene.lamps.names == ["A", "B", "C", "D"]  # nothing sees E
    scattered = DIFFUSE_RAY | GLOSSY_RAY | TRANSMISSION_RAY
    visible = [scattered, ALL_RAYS, GLOSSY_RAY | TRANSMISSION_RAY, scattered]
    assert scene.lamps.visible.tolist() == visible
    assert scene.lamps.casts_shadow.tolist() == [False, True, True, True]
    assert scene.lamps.max_bounces.tolist() == [ALL_BOUNCES, ALL_BOUNCES, ALL_BOUNCES, 3]
    assert scene.not_modelled == []


def test_a_lamp_without_shadow_shines_through_what_is_in_its_way(tmp_path):
    add_probe(64)
    add_lamp("POINT", settings={"use_shadow": False}, location=(0, 0, 1))
    expected = oracle.irradiance(extract(), (0, 0, 0), (0, 0, 1)) / math.pi
    add_plane(0.5, location=(0, 0, 0.5))
    np.testing.assert_allclose(render(tmp_path).mean(axis=(0, 1)), expected, rtol=0.005)


def test_sheared_area_light_keeps_its_power_and_is_noted():
    new_scene()
    parent = add_object("Parent", None, scale=(1, 3, 1))
    lamp = add_lamp("AREA", name="Sheared", rotation=radians(0, 0, 30))
    lamp.parent = parent
    scene = extract()
    area = np.linalg.norm(np.cross(scene.lamps.axis_u[0], scene.lamps.axis_v[0]))
    np.testing.assert_allclose(scene.lamps.radiance[0] * math.pi * area, 100.0, rtol=1e-5)
    assert scene.not_modelled == ["Sheared: sheared, for which Cycles has other formulas."]
