"""The construction kit of the scene recipes: boxes and rectangles in numpy, and how they and
their materials, lights and cameras enter the file that is open in Blender.

A box is its (low, high) corners, (2, 3); a quad its four corners, (4, 3), counter-clockwise seen
from outside. Metres, z up.
"""

from __future__ import annotations

from math import atan2
from typing import NamedTuple

import bmesh
import bpy
import numpy as np
from mathutils import Euler, Vector

EAST, NORTH, UP = np.eye(3)

# A .blend of 400,000 objects takes a minute to save, and 10 GB; of instances, neither.
MAX_OBJECTS = 20_000

# The six quads of the unit cube.
CUBE = np.array(
    [
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[1, 1, 0], [0, 1, 0], [0, 1, 1], [1, 1, 1]],
        [[0, 1, 0], [0, 0, 0], [0, 0, 1], [0, 1, 1]],
    ]
)


class Face(NamedTuple):
    """An upright rectangle, such as one side of a house.

    corner: (3,) the lower left one seen from outside. along: unit vector to the right.
    normal: unit vector outwards.
    """

    corner: np.ndarray
    along: np.ndarray
    normal: np.ndarray
    width: float
    height: float

    def at(self, right, up, out) -> np.ndarray:
        """Points (..., 3) so far to the right of the corner, above it, and in front of the face."""
        right, up, out = (np.asarray(distance)[..., None] for distance in (right, up, out))
        return self.corner + right * self.along + up * UP + out * self.normal

    def box(self, right, up, out) -> np.ndarray:
        """The box that spans three (from, to) pairs of the distances of `at`."""
        ends = self.at(right, up, out)
        return np.array([ends.min(axis=0), ends.max(axis=0)])

    def quads(self, right, up, width: float, height: float, out: float) -> np.ndarray:
        """Equal rectangles (n, 4, 3) in front of the face; `right`, `up` (n,): lower left."""
        right = right[:, None] + width * np.array([0, 1, 1, 0])
        up = up[:, None] + height * np.array([0, 0, 1, 1])
        return self.at(right, up, out)


def sides(low, high) -> list[Face]:
    """The south, east, north and west face of a box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    corners = np.array([(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)])
    along = (EAST, NORTH, -EAST, -NORTH)
    normal = (-NORTH, EAST, NORTH, -EAST)
    width = (x1 - x0, y1 - y0) * 2
    return [Face(*side, z1 - z0) for side in zip(corners, along, normal, width, strict=True)]


def box_quads(boxes) -> np.ndarray:
    """The surfaces (6 n, 4, 3) of boxes (n, 2, 3)."""
    low, high = np.swapaxes(np.asarray(boxes, float), 0, 1)[:, :, None, None]
    return (low + CUBE * (high - low)).reshape(-1, 4, 3)


def new_mesh(name: str, quads: np.ndarray, *materials, material_ids=None) -> bpy.types.Mesh:
    """A mesh of unconnected quads (n, 4, 3); material_ids: (n,), all the first if left out."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(4 * len(quads))
    _fill(mesh.attributes["position"], quads)
    mesh.loops.add(4 * len(quads))
    corners = np.arange(4 * len(quads), dtype=np.int32)
    mesh.attributes[".corner_vert"].data.foreach_set("value", corners)
    mesh.polygons.add(len(quads))
    mesh.polygons.foreach_set("loop_start", corners[::4].copy())
    for material in materials:
        mesh.materials.append(material)
    if material_ids is not None:
        mesh.polygons.foreach_set("material_index", np.asarray(material_ids, np.int32))
    is_flat = mesh.attributes.new("sharp_face", "BOOLEAN", "FACE")
    is_flat.data.foreach_set("value", np.ones(len(quads), bool))
    mesh.update(calc_edges=True)
    return mesh


def _fill(attribute, vectors) -> None:
    attribute.data.foreach_set("vector", np.ravel(vectors).astype(np.float32))


def new_sphere(name: str, radius: float, columns: int, rows: int, material) -> bpy.types.Mesh:
    """A ball of 2 `columns` (`rows` - 1) triangles, in quads but around the poles."""
    mesh, ball = bpy.data.meshes.new(name), bmesh.new()
    bmesh.ops.create_uvsphere(ball, u_segments=columns, v_segments=rows, radius=radius)
    ball.to_mesh(mesh)
    ball.free()
    mesh.materials.append(material)
    return mesh


def new_material(name: str, shader: str, **inputs) -> bpy.types.Material:
    """A material of one shader node, such as "ShaderNodeBsdfDiffuse", with these inputs."""
    material = bpy.data.materials.new(name)
    set_shader(material, "ShaderNodeOutputMaterial", shader, inputs)
    return material


def set_shader(owner, output: str, shader: str, inputs: dict) -> None:
    """Make the node tree of a material or world `shader` -> `output` and nothing else."""
    if owner.node_tree is None:  # before Blender 5 a tree has to be asked for
        owner.use_nodes = True
    nodes, links = owner.node_tree.nodes, owner.node_tree.links
    nodes.clear()
    shader = nodes.new(shader)
    for name, value in inputs.items():
        shader.inputs[name].default_value = value
    links.new(shader.outputs[0], nodes.new(output).inputs["Surface"])


def new_light(name: str, kind: str, color, energy: float, **settings) -> bpy.types.Light:
    """A light of `energy` watts (a sun: W/m^2); `settings` are Blender's own names and units."""
    light = bpy.data.lights.new(name, kind)
    light.color, light.energy = color, energy
    for setting, value in settings.items():
        setattr(light, setting, value)
    return light


def new_collection(name: str) -> bpy.types.Collection:
    """A collection of the open scene, for objects of one kind."""
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    return collection


def place(collection, name: str, data, location=(0, 0, 0), rotation=None) -> bpy.types.Object:
    """An object that shows `data`, a mesh, light or camera."""
    item = bpy.data.objects.new(name, data)
    item.location = location
    if rotation is not None:
        item.rotation_euler = rotation
    collection.objects.link(item)
    return item


def place_all(collection, name: str, items: list[tuple]) -> None:
    """An object `name`-0000 and so on for each (data, location, rotation); instances if very many.

    Blender sorts objects by name and looks for the place of a new one from the end: to make very
    many takes seconds if their names ascend, and hours if they do not.
    """
    if len(items) <= MAX_OBJECTS:
        digits = len(str(len(items)))
        for i, item in enumerate(items):
            place(collection, f"{name}-{i:0{digits}}", *item)
        return
    where = {}
    for data, *location_and_rotation in items:
        where.setdefault(data, []).append(location_and_rotation)
    for data, rows in where.items():
        place_instances(collection, name, data, *map(np.array, zip(*rows, strict=True)))


def place_instances(collection, name: str, data, locations, rotations=None) -> None:
    """Show `data` at all locations (n, 3), turned by XYZ angles (n, 3), as instances.

    A mesh of points carries nodes that instance an object, itself hidden, at each of them.
    """
    item = place(collection, data.name, data)
    item.hide_render = item.hide_viewport = True
    points = bpy.data.meshes.new(f"{name} points")
    points.vertices.add(len(locations))
    _fill(points.attributes["position"], locations)
    angles = points.attributes.new("rotation", "FLOAT_VECTOR", "POINT")
    _fill(angles, np.zeros_like(locations) if rotations is None else rotations)
    carrier = place(collection, points.name, points)
    carrier.modifiers.new("instances", "NODES").node_group = _instancer(item)


def _instancer(item) -> bpy.types.NodeTree:
    """Nodes that show an object at every point, turned by the attribute `rotation`."""
    tree = bpy.data.node_groups.new(f"{item.name} instances", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    names = ("ObjectInfo", "InputNamedAttribute", "InstanceOnPoints")
    shown, rotation, instances = (tree.nodes.new(f"GeometryNode{name}") for name in names)
    shown.inputs["Object"].default_value = item
    shown.inputs["As Instance"].default_value = True
    rotation.data_type = "FLOAT_VECTOR"
    rotation.inputs["Name"].default_value = "rotation"
    points, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(points.outputs["Geometry"], instances.inputs["Points"])
    tree.links.new(shown.outputs["Geometry"], instances.inputs["Instance"])
    tree.links.new(rotation.outputs["Attribute"], instances.inputs["Rotation"])
    tree.links.new(instances.outputs["Instances"], result.inputs["Geometry"])
    return tree


def add_camera(name: str, position, direction, lens_mm: float) -> bpy.types.Object:
    """A camera that sees from 5 cm to 20 km."""
    camera = bpy.data.cameras.new(name)
    camera.lens, camera.clip_start, camera.clip_end = lens_mm, 0.05, 20_000
    return place(bpy.context.scene.collection, name, camera, position, looking(direction))


def looking(direction) -> Euler:
    """The rotation by which a light shines, or a camera looks, along `direction`, upright."""
    return Vector(direction).to_track_quat("-Z", "Y").to_euler()


def heading(direction) -> Euler:
    """The rotation about z that turns an object made to face east."""
    return Euler((0, 0, atan2(direction[1], direction[0])))
