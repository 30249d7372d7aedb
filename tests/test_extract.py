"""Blender's objects -> triangles: each kind of object and instance once, in the right place."""

import time

import bpy
import numpy as np
import pytest
from blender_scenes import (
    add_lamp,
    add_object,
    add_plane,
    enable_nodes,
    extract,
    extract_in_render,
    new_material,
    new_scene,
    radians,
)

from lighttree_core.scene import (
    ALL_RAYS,
    CAMERA_RAY,
    SHADOW_RAY,
    TRANSMISSION_RAY,
    Scene,
    SceneError,
)

pytestmark = pytest.mark.blender


def _normals(scene):
    """(T, 3) geometric normals, not of unit length."""
    a, b, c = (scene.vertices[scene.triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def _centers(scene):
    """(O, 3) the middle of each object's box."""
    runs = np.split(scene.triangles, scene.object_first_triangle[1:])
    corners = [scene.vertices[run.ravel()] for run in runs]
    return np.array([(points.min(axis=0) + points.max(axis=0)) / 2 for points in corners])


def _add_cube(name="Cube", **place):
    bpy.ops.mesh.primitive_cube_add(size=1)
    mesh = bpy.context.object.data
    bpy.data.objects.remove(bpy.context.object)
    return add_object(name, mesh, **place)


def test_a_mesh_is_placed_in_the_world():
    new_scene()
    add_plane(location=(1, 2, 3), rotation=radians(0, 90, 0), scale=(2, 1, 1))
    scene = extract()
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    np.testing.assert_allclose([low, high], [(1, 1, 1), (1, 3, 5)], atol=1e-6)
    np.testing.assert_allclose(_normals(scene), [(8, 0, 0)] * 2, atol=1e-5)
    assert scene.object_names == ["Plane"]
    assert scene.object_first_triangle.tolist() == [0]


def test_tables_have_the_types_that_kernels_expect():
    new_scene()
    add_plane(material=new_material("Glass", "ShaderNodeBsdfGlass"))
    add_lamp("SUN")
    scene = extract()
    types = {"vertices": np.float32, "triangles": np.int32, "triangle_material": np.int32}
    types |= {"object_first_triangle": np.int32, "background": np.float32}
    types |= {"corner_normals": np.float32, "uvs": np.float32, "colors": np.float32}
    for name, dtype in types.items():
        assert getattr(scene, name).dtype == dtype, name
    for table in (scene.lamps, scene.materials, scene.closures, scene.textures):
        for name, expected in vars(type(table).empty()).items():
            column = getattr(table, name)
            is_right = name == "names" or column.dtype == expected.dtype
            assert is_right and (name == "names" or column.flags.c_contiguous), name


def test_what_is_extracted_passes_the_check_and_survives_a_file(tmp_path):
    new_scene()
    add_plane(rotation=radians(10, 20, 30))
    for kind in ("POINT", "SPOT", "AREA", "SUN"):
        add_lamp(kind)
    scene = extract()
    scene.check()
    scene.save(tmp_path / "scene.npz")
    loaded = Scene.load(tmp_path / "scene.npz")
    loaded.check()
    assert loaded.camera.crop_px == scene.camera.crop_px
    np.testing.assert_array_equal(loaded.lamps.radiance, scene.lamps.radiance)


def test_an_empty_scene_has_no_triangles():
    new_scene()
    add_object("Vertices only", bpy.data.meshes.new("Empty"))
    scene = extract()
    assert scene.vertices.shape == scene.triangles.shape == (0, 3)
    assert scene.object_names == []


def test_the_front_stays_the_front_for_any_sign_of_scale():
    for scale in ((1, 1, 1), (-1, 1, 1), (1, 1, -1), (-1, -1, 1), (-1, -1, -1)):
        new_scene()
        add_plane(scale=scale)
        # A normal is carried by the inverse transpose: +Z, seen through a scale of z.
        assert np.all(_normals(extract())[:, 2] * scale[2] > 0), scale


def test_each_triangle_has_the_material_of_its_slot():
    new_scene()
    red, green, blue = (new_material(name) for name in ("Red", "Green", "Blue"))
    cube = _add_cube()
    for material in (red, green, blue):
        cube.data.materials.append(material)
    cube.data.polygons.foreach_set("material_index", [0, 0, 2, 2, 2, 9])
    cube.material_slots[0].link = "OBJECT"
    cube.material_slots[0].material = new_material("Object's")
    scene = extract()
    names = np.array(scene.materials.names)
    expected = np.repeat(["Object's"] * 2 + ["Blue"] * 4, 2)
    assert names[scene.triangle_material].tolist() == expected.tolist()
    assert "Green" not in names  # a slot that no face uses


def test_objects_that_share_a_mesh_may_differ_in_material():
    new_scene()
    mesh = add_plane(material=new_material("Mesh's"), name="First").data
    second = add_object("Second", mesh, location=(0, 0, 1))
    second.material_slots[0].link = "OBJECT"
    second.material_slots[0].material = new_material("Object's")
    add_object("Third", mesh, location=(0, 0, 2))
    scene = extract()
    material = np.array(scene.materials.names)[scene.triangle_material[::2]]
    found = sorted(zip(_centers(scene)[:, 2], scene.object_names, material, strict=True))
    assert [row[1:] for row in found] == [
        ("First", "Mesh's"),
        ("Second", "Object's"),
        ("Third", "Mesh's"),
    ]


def test_a_material_override_of_the_view_layer_is_on_everything():
    new_scene()
    add_plane(material=new_material("Own"))
    add_plane()
    bpy.context.view_layer.material_override = new_material("Clay")
    assert extract().materials.names == ["Clay"]


def test_text_curves_surfaces_and_metaballs_come_once():
    for kind, make in {
        "FONT": lambda: bpy.data.curves.new("Text", "FONT"),
        "CURVE": lambda: bpy.data.curves.new("Curve", "CURVE"),
        "META": lambda: bpy.data.metaballs.new("Meta"),
    }.items():
        new_scene()
        data = make()
        if kind == "FONT":
            data.body = "i"
        elif kind == "CURVE":
            data.bevel_depth, data.dimensions = 0.1, "3D"
            spline = data.splines.new("POLY")
            spline.points.add(1)
            spline.points[1].co = (0, 0, 1, 1)
        else:
            data.elements.new()
        thing = add_object("Thing", data)
        scene = extract()
        mesh = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        mesh.calc_loop_triangles()
        assert len(scene.triangles) == len(mesh.loop_triangles) > 0, kind
        assert scene.object_names == ["Thing"], kind


def test_modifiers_are_applied():
    new_scene()
    plane = add_plane()
    array = plane.modifiers.new("Array", "ARRAY")
    array.count = 3
    assert len(extract().triangles) == 6


def test_collections_are_instanced_with_their_nested_places():
    scene = new_scene()
    inner, outer = bpy.data.collections.new("Inner"), bpy.data.collections.new("Outer")
    inner.objects.link(add_plane(location=(1, 0, 0)))
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Plane"])
    nested = add_object("Nested", None, scale=(2, 2, 2))
    nested.instance_type, nested.instance_collection = "COLLECTION", inner
    outer.objects.link(nested)
    bpy.context.scene.collection.objects.unlink(nested)
    for y in (0, 10):
        instancer = add_object("Instancer", None, location=(0, y, 0))
        instancer.instance_type, instancer.instance_collection = "COLLECTION", outer
    scene = extract()
    np.testing.assert_allclose(sorted(_centers(scene).tolist()), [(2, 0, 0), (2, 10, 0)])


def test_a_render_has_what_is_set_to_be_rendered():
    new_scene()
    parent = add_plane(name="Parent")
    add_plane(name="Child").parent = parent
    parent.instance_type = "VERTS"
    add_plane(name="Not rendered").hide_render = True
    add_plane(name="Not in the viewport").hide_viewport = True
    for shown in (True, False):
        parent.show_instancer_for_render = shown
        names = sorted(extract_in_render().object_names)
        assert names == ["Child"] * 4 + ["Not in the viewport"] + ["Parent"] * shown


def test_particles_and_geometry_nodes_instance_objects():
    new_scene()
    cube = _add_cube(scale=(0.1, 0.1, 0.1))
    emitter = add_plane(name="Emitter")
    emitter.modifiers.new("Particles", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.type, settings.count = "HAIR", 7
    settings.render_type, settings.instance_object = "OBJECT", cube
    assert extract().object_names.count("Cube") == 8

    new_scene()
    cube, plane = _add_cube(), add_plane(name="Scattered")
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    scatter = group.nodes.new("GeometryNodeInstanceOnPoints")
    info = group.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = cube
    group.links.new(start.outputs[0], scatter.inputs["Points"])
    group.links.new(info.outputs["Geometry"], scatter.inputs["Instance"])
    group.links.new(scatter.outputs[0], end.inputs[0])
    plane.modifiers.new("Nodes", "NODES").node_group = group
    scene = extract()
    assert sorted(scene.object_names) == ["Cube"] + ["Scattered"] * 4
    centers = sorted(_centers(scene)[[name == "Scattered" for name in scene.object_names]].tolist())
    np.testing.assert_allclose(centers, [(-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)])


def test_which_rays_meet_an_object_where_it_is_placed():
    new_scene()
    add_plane(name="Everywhere")
    add_plane(name="Ghost", location=(0, 0, 1)).visible_shadow = False
    add_plane(name="Reflection", location=(0, 0, 2)).visible_camera = False
    # A collection that only indirect light sees, and one that an object places.
    aside, placed = (bpy.data.collections.new(name) for name in ("Aside", "Placed"))
    bpy.context.scene.collection.children.link(aside)
    aside.objects.link(bpy.data.objects.new("Card", add_plane(name="Gone").data))
    aside.objects["Card"].location.z = 3
    bpy.data.objects.remove(bpy.data.objects["Gone"])
    bpy.context.view_layer.layer_collection.children["Aside"].indirect_only = True
    source = bpy.data.objects.new("Source", bpy.data.objects["Ghost"].data)
    placed.objects.link(source)
    source.visible_glossy = False
    instancer = add_object("Instancer", None, location=(0, 0, 4))
    instancer.instance_type, instancer.instance_collection = "COLLECTION", placed
    instancer.visible_diffuse = False
    scene = extract()
    assert dict(zip(scene.object_names, scene.object_visible.tolist(), strict=True)) == {
        "Everywhere": ALL_RAYS | SHADOW_RAY,
        "Ghost": ALL_RAYS,
        "Reflection": ALL_RAYS & ~CAMERA_RAY | SHADOW_RAY,
        "Card": ALL_RAYS & ~CAMERA_RAY | SHADOW_RAY,
        "Source": CAMERA_RAY | TRANSMISSION_RAY | SHADOW_RAY,
    }
    assert not scene.not_modelled


def test_each_setting_that_is_not_modelled_is_noted():
    new_scene()
    bpy.context.scene.render.use_motion_blur = True
    add_plane(name="B").is_shadow_catcher = True
    add_plane(name="C", location=(0, 0, 1)).data.shade_smooth()
    add_object("D", bpy.data.hair_curves.new("Hair"))
    add_object("E", bpy.data.volumes.new("Smoke"))
    hairy = add_plane(name="F", location=(0, 0, 2))
    hairy.modifiers.new("Hair", "PARTICLE_SYSTEM")
    hairy.particle_systems[0].settings.type = "HAIR"
    for thing in bpy.data.objects:
        if thing.type == "MESH":
            thing.data.materials.append(new_material())
    assert set(extract().not_modelled) == {
        "Scene: without motion blur.",
        "B: rendered as an ordinary object.",
        "D: hair curves are left out.",
        "E: volumes are left out.",
        "F: its hair is left out.",
    }


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="there is one working space only")
def test_other_working_spaces_are_refused():
    new_scene()
    bpy.ops.wm.set_working_color_space(working_space="ACEScg")
    with pytest.raises(SceneError, match="working space of the file is ACEScg"):
        extract()


@pytest.mark.slow
def test_a_million_triangles_and_ten_thousand_lamps_take_less_than_five_seconds():
    new_scene()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=708, y_subdivisions=708)
    for i in range(10_000):
        add_lamp(("POINT", "SPOT", "AREA")[i % 3], name="Lamp", location=(i % 100, i // 100, 3))
        enable_nodes(bpy.data.lights[-1])
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    start = time.process_time()  # which other programs do not slow down
    scene = extract()
    seconds = time.process_time() - start
    assert len(scene.triangles) == 2 * 708**2
    assert len(scene.lamps.names) == 10_000
    assert seconds < 5, seconds
