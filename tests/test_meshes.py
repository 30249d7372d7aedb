"""What the corners of triangles carry: normals, UV maps, colours; stored where it is needed."""

import math
import time

import bpy
import numpy as np
import pytest
from blender_scenes import (
    MaterialTree,
    add_camera,
    add_node,
    add_object,
    add_plane,
    extract,
    new_file,
    new_material,
    new_scene,
    radians,
    render,
)

from lighttree_core.scene import FRONT

pytestmark = pytest.mark.blender

SCALES = [(1, 1, 1), (1, 2, 0.5), (-1, 1, 1), (1, 1, -2), (-1, -1, -1)]


def add_ball(material=None, smooth=True, **place):
    """A coarse sphere of radius 1."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
    mesh = bpy.context.object.data
    bpy.data.objects.remove(bpy.context.object)
    if smooth:
        mesh.shade_smooth()
    if material:
        mesh.materials.append(material)
    return add_object("Ball", mesh, **place)


def flat_normals(scene):
    """(T, 3) unit geometric normals."""
    a, b, c = (scene.vertices[scene.triangles[:, i]].astype(float) for i in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_a_flat_scene_stores_no_normals():
    new_scene()
    add_ball(smooth=False)
    scene = extract()
    assert scene.corner_normals.shape == (0, 3, 3)
    assert scene.uvs.shape == (0, len(scene.triangles), 3, 2)
    assert scene.colors.shape == (0, len(scene.triangles), 3, 3)


@pytest.mark.parametrize("scale", SCALES)
def test_smooth_normals_are_carried_by_the_inverse_transpose(scale):
    new_scene()
    add_ball(scale=scale, rotation=radians(10, 20, 30), location=(1, 2, 3))
    scene = extract()
    normals = scene.corner_normals
    assert normals.dtype == np.float32 and normals.flags.c_contiguous
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1, atol=1e-6)
    # Of an ellipsoid x^T A x = 1 around the centre the normal is A x; A of the corners fits.
    x = scene.vertices[scene.triangles].astype(float) - (1, 2, 3)
    world_from_local = np.array(bpy.data.objects["Ball"].matrix_world)[:3, :3]
    expected = x @ np.linalg.inv(world_from_local @ world_from_local.T).T
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    # A mirrored sphere shows its inside, its front is there.
    expected *= np.sign(np.linalg.det(world_from_local))
    expected *= np.sign(np.sum(normals[0, 0] * expected[0, 0]))
    np.testing.assert_allclose(normals, expected, atol=2e-3)
    assert (np.sum(normals * flat_normals(scene)[:, None], axis=2) > 0.5).all()


def test_flat_objects_beside_smooth_ones_have_their_own_normals():
    new_scene()
    add_plane(name="A", rotation=radians(20, 30, 0))
    add_ball()
    scene = extract()
    flat = flat_normals(scene)
    np.testing.assert_allclose(scene.corner_normals[:2], np.repeat(flat[:2, None], 3, 1), atol=1e-6)
    assert np.abs(scene.corner_normals[2:] - flat[2:, None]).max() > 0.1


def test_a_triangle_without_area_has_a_normal_all_the_same():
    new_scene()
    add_ball(scale=(1, 1, 0))
    add_ball(scale=(0, 0, 0))
    scene = extract()
    np.testing.assert_allclose(np.linalg.norm(scene.corner_normals, axis=2), 1, atol=1e-6)


def _normals_seen(tmp_path):
    """(normals as Cycles shades with them, as extracted), of all pixels that meet the front."""
    cycles = render(tmp_path) * 2 - 1
    scene = extract()
    flat = flat_normals(scene)
    corners = scene.vertices[scene.triangles].astype(float)
    height, width = cycles.shape[:2]
    own, seen = [], []
    for row, column in np.ndindex(height, width):
        x, y = 4 * (column + 0.5) / width - 2, 4 * (row + 0.5) / width - 2 * height / width
        a, b, c = corners[:, 0, :2], corners[:, 1, :2], corners[:, 2, :2]
        edges = np.stack([b - a, c - a], axis=2)
        is_upright = np.abs(np.linalg.det(edges)) > 1e-9
        uv = np.zeros((len(a), 2))
        uv[is_upright] = np.linalg.solve(edges[is_upright], ((x, y) - a)[is_upright, :, None])[
            ..., 0
        ]
        weights = np.column_stack([1 - uv.sum(axis=1), uv])
        inside = np.flatnonzero((weights.min(axis=1) > 0) & is_upright)
        heights = np.einsum("tk,tk->t", weights, corners[:, :, 2])[inside]
        if len(inside) == 0 or np.diff(np.sort(heights)[-2:]).min(initial=1) < 1e-3:
            continue
        top = inside[np.argmax(heights)]
        # Away from edges, within a pixel from which there may be other normals.
        if flat[top, 2] > 0.3 and weights[top].min() > 0.15:
            normal = weights[top] @ scene.corner_normals[top]
            own.append(normal / np.linalg.norm(normal))
            seen.append(cycles[row, column])
    return np.array(seen), np.array(own)


@pytest.mark.parametrize("kind", ["smooth", "sharp", "custom", "partly flat"])
@pytest.mark.parametrize("scale", SCALES)
def test_normals_are_those_cycles_shades_with(kind, scale, tmp_path):
    scene = new_file(16)
    scene.render.resolution_x = scene.render.resolution_y = 64
    material = new_material("Normals", "ShaderNodeEmission")
    tree = material.node_tree
    emission = next(x for x in tree.nodes if x.bl_idname == "ShaderNodeEmission")
    scaled = add_node(tree, "ShaderNodeVectorMath")
    scaled.operation = "MULTIPLY_ADD"
    scaled.inputs[1].default_value = scaled.inputs[2].default_value = (0.5, 0.5, 0.5)
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    tree.links.new(geometry.outputs["Normal"], scaled.inputs[0])
    tree.links.new(scaled.outputs[0], emission.inputs["Color"])
    mesh = add_ball(material, scale=scale, rotation=radians(10, 20, 30)).data
    if kind == "sharp":
        sharp = np.arange(len(mesh.edges)) % 3 == 0
        mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE").data.foreach_set("value", sharp)
    elif kind == "custom":
        normals = np.random.default_rng(7).normal(size=(len(mesh.loops), 3)) * 0.2
        normals += np.array([mesh.vertices[loop.vertex_index].normal for loop in mesh.loops])
        mesh.normals_split_custom_set(normals.tolist())
    elif kind == "partly flat":
        flat = np.arange(len(mesh.polygons)) % 2 == 0
        mesh.polygons.foreach_set("use_smooth", ~flat)
    add_camera(ortho_scale=4.0, location=(0, 0, 4))
    seen, own = _normals_seen(tmp_path)
    assert len(own) > 20
    # 16 samples are of about the centre of a pixel.
    assert np.median(np.abs(seen - own)) < 0.01
    assert np.percentile(np.abs(seen - own), 95) < 0.05


def _image_material(uv_map=None):
    tree = MaterialTree()
    image = tree.add("ShaderNodeTexImage")
    image.image = bpy.data.images.new("Bricks", 4, 4)
    tree.link(image, tree.surface(tree.add("ShaderNodeBsdfDiffuse")), "Color")
    if uv_map:
        node = tree.add("ShaderNodeUVMap")
        node.uv_map = uv_map
        tree.link(node, image)
    return tree


def _add_uv_map(mesh, name, shift=0.0):
    square = np.array([0, 0, 1, 0, 1, 1, 0, 1]) + shift
    mesh.uv_layers.new(name=name).uv.foreach_set("vector", square)


def _corner_xy(scene, triangles):
    return scene.vertices[scene.triangles[triangles]][:, :, :2]


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1)])
def test_uv_maps_stay_at_their_corners(scale):
    tree = _image_material()
    plane = bpy.data.objects["Plane"]
    _add_uv_map(plane.data, "UVMap")
    plane.scale = scale
    scene = extract()
    assert scene.uvs.dtype == np.float32 and len(scene.uvs) == 1
    # The map of a plane from -1 to 1.
    local = _corner_xy(scene, slice(None)) * scale[:2]
    np.testing.assert_allclose(scene.uvs[0], local / 2 + 0.5, atol=1e-6)
    assert scene.textures.uv_map.tolist() == [0]
    assert tree.material.name in scene.materials.names


def test_only_maps_that_materials_need_are_stored_and_what_lacks_them_has_zeros():
    tree = _image_material("Wanted")
    plane = bpy.data.objects["Plane"]
    _add_uv_map(plane.data, "Idle")
    _add_uv_map(plane.data, "Wanted", 2.0)
    add_plane(material=tree.material, name="Without")
    _add_uv_map(add_plane(material=new_material("Plain"), name="Other").data, "Wanted", 5.0)
    scene = extract()
    assert len(scene.uvs) == 1
    by_name = dict(zip(scene.object_names, scene.object_first_triangle, strict=True))
    assert scene.uvs[0, by_name["Plane"]].min() == 2.0
    for name in ("Without", "Other"):
        first = by_name[name]
        assert (scene.uvs[0, first : first + 2] == 0).all()


def test_instances_of_a_mesh_share_what_is_read_of_it():
    tree = _image_material()
    plane = bpy.data.objects["Plane"]
    _add_uv_map(plane.data, "UVMap")
    add_object("Second", plane.data, location=(0, 0, 1), scale=(-1, 1, 1))
    scene = extract()
    for first in (0, 2):
        corners = _corner_xy(scene, slice(first, first + 2)) * (1 if first == 0 else (-1, 1))
        np.testing.assert_allclose(scene.uvs[0, first : first + 2], corners / 2 + 0.5, atol=1e-6)
    assert tree.material.users == 1


def test_a_mesh_may_be_shown_with_materials_that_need_other_maps():
    tree = _image_material()
    plane = bpy.data.objects["Plane"]
    _add_uv_map(plane.data, "UVMap")
    plain = add_object("Plain", plane.data)
    plain.material_slots[0].link = "OBJECT"
    plain.material_slots[0].material = new_material("Plain")
    paint = new_material("Paint")
    color = paint.node_tree.nodes.new("ShaderNodeVertexColor")
    diffuse = next(x for x in paint.node_tree.nodes if x.bl_idname == "ShaderNodeBsdfDiffuse")
    paint.node_tree.links.new(color.outputs[0], diffuse.inputs["Color"])
    plane.data.attributes.new("Color", "FLOAT_COLOR", "POINT").data.foreach_set(
        "color", np.tile([0.25, 0.5, 0.75, 1.0], 4)
    )
    painted = add_object("Painted", plane.data)
    painted.material_slots[0].link = "OBJECT"
    painted.material_slots[0].material = paint
    scene = extract()
    scene.check()
    assert (len(scene.uvs), len(scene.colors)) == (1, 1)
    first = scene.object_first_triangle[scene.object_names.index("Painted")]
    np.testing.assert_allclose(scene.colors[0, first], [(0.25, 0.5, 0.75)] * 3)
    assert scene.materials.num_closures[:, FRONT].sum() == 2
    assert tree.material.name == "Test"


@pytest.mark.slow
def test_a_million_smooth_triangles_with_a_uv_map_take_less_than_two_seconds():
    tree = _image_material()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=708, y_subdivisions=708)
    mesh = bpy.context.object.data
    mesh.materials.append(tree.material)
    mesh.shade_smooth()
    bpy.context.evaluated_depsgraph_get().update()
    start = time.process_time()  # which other programs do not slow down
    scene = extract()
    seconds = time.process_time() - start
    assert len(scene.corner_normals) == scene.uvs.shape[1] == 2 + 2 * 708**2
    assert seconds < 2, seconds


def test_a_mesh_in_edit_mode_is_rendered_as_it_is_being_edited():
    new_scene()
    thing = add_plane(2.0)
    bpy.context.view_layer.objects.active = thing
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.resize(value=(3, 3, 3))
    scene = extract()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(scene.triangles) == 2
    np.testing.assert_allclose(np.abs(scene.vertices).max(axis=0), (3, 3, 0), atol=1e-6)


def test_faces_in_the_place_of_others_are_noted_and_those_beside_or_without_area_are_not():
    new_scene()
    add_plane(name="A")
    add_plane(name="B", rotation=(0, 0, math.pi / 2))  # its triangles lie across those of A
    assert extract().not_modelled == []
    add_plane(name="C")
    add_plane(name="D", scale=(0, 0, 0))
    add_plane(name="E", scale=(1, 1, 0), location=(0, 0, 1))  # had no thickness before
    (note,) = extract().not_modelled
    assert note.startswith("A, C: some of its faces lie in the place of others")


def test_a_vertex_that_is_nowhere_takes_its_faces_away():
    new_scene()
    mesh = add_plane(name="Torn").data
    mesh.vertices[1].co.x = math.nan
    scene = extract()
    assert scene.not_modelled == ["Torn: its faces with a vertex at no finite place are left out."]
    corners = scene.vertices[scene.triangles]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert np.isfinite(corners).all() and np.sum(areas > 0) == 1
