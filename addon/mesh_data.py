"""What is read of one of Blender's meshes, by the fast ways through its API."""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

from .values import Projection

# What an attribute's elements call their numbers, and how many there are.
NUMBERS = {
    "FLOAT": ("value", 1),
    "INT": ("value", 1),
    "INT8": ("value", 1),
    "BOOLEAN": ("value", 1),
    "FLOAT2": ("vector", 2),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4),
}
DTYPES = {"INT": np.int32, "INT8": np.int8, "BOOLEAN": bool}


@dataclass
class Mesh:
    """A mesh in its local space.

    positions: (V, 3) float64. triangles, corners: (T, 3) int32, its vertices, and the corners of
    polygons that those of the triangles are. slots: the material slots in use. triangle_slot: (T,)
    index into `slots`. normals: (T, 3, 3) at the corners, 0 for the triangle's own, None if all are
    that. is_broken: whether triangles with vertices nowhere are gone. uvs: row of `Scene.uvs` ->
    (T, 3, 2). colors: row of `Scene.colors` -> (T, 3, 3).
    """

    positions: np.ndarray
    triangles: np.ndarray
    corners: np.ndarray
    slots: np.ndarray
    triangle_slot: np.ndarray
    normals: np.ndarray | None
    is_broken: bool = False
    uvs: dict[int, np.ndarray] = field(default_factory=dict)
    colors: dict[int, np.ndarray] = field(default_factory=dict)


def read_mesh(mesh) -> Mesh | None:
    """A mesh, without UV maps and colours; None if it has no faces."""
    mesh.calc_loop_triangles()
    num_triangles = len(mesh.loop_triangles)
    if num_triangles == 0:
        return None
    corners = np.empty(3 * num_triangles, np.int32)
    mesh.loop_triangles.foreach_get("loops", corners)
    corners = corners.reshape(-1, 3)
    vertex_of_corner = np.empty(len(mesh.loops), np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", vertex_of_corner)
    triangles = vertex_of_corner[corners]

    slots, triangle_slot = np.zeros(1, np.int32), np.zeros(num_triangles, np.int32)
    if "material_index" in mesh.attributes:  # else all are 0
        polygon_slot = np.empty(len(mesh.polygons), np.int32)
        mesh.attributes["material_index"].data.foreach_get("value", polygon_slot)
        slots, polygon_slot = np.unique(polygon_slot, return_inverse=True)
        triangle_slot = polygon_slot[_polygons(mesh)]
    positions = _numbers(mesh.attributes["position"]).astype(np.float64)
    normals = _read_normals(mesh, corners, triangles)
    return Mesh(
        positions=positions,
        triangles=triangles,
        corners=corners,
        slots=slots,
        triangle_slot=triangle_slot,
        normals=normals,
        is_broken=_collapse_broken(positions, triangles),
    )


def _collapse_broken(positions, triangles):
    """Leave triangles with a vertex that is not finite without area, as Cycles does; whether
    there are any."""
    is_nowhere = ~np.isfinite(positions).all(axis=1)
    is_broken = is_nowhere[triangles].any(axis=1)
    positions[is_nowhere] = 0.0
    triangles[is_broken] = triangles[is_broken, :1]
    return bool(is_broken.any())


def _polygons(mesh):
    """(T,) int32, the polygon that each triangle is part of."""
    polygon = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangle_polygons.foreach_get("value", polygon)
    return polygon


def _read_normals(mesh, corners, triangles):
    """(T, 3, 3) float32 at the corners of triangles, 0 for the triangle's own; None if all are."""
    if mesh.normals_domain == "FACE":
        return None
    # Up to 4.5 Cycles takes those of vertices for faces that have nothing but flat ones beside.
    is_early = bpy.app.version < (5, 0) and not mesh.has_custom_normals
    by_vertex = mesh.normals_domain == "POINT" or (
        is_early and not _flags(mesh, "sharp_edge").any()
    )
    source = mesh.vertex_normals if by_vertex else mesh.corner_normals
    normals = np.empty((len(source), 3), np.float32)
    source.foreach_get("vector", normals.reshape(-1))
    normals = normals[triangles if by_vertex else corners]
    is_flat = _flags(mesh, "sharp_face")
    if by_vertex and is_flat.any():
        normals[is_flat[_polygons(mesh)]] = 0.0
    return normals


def _flags(mesh, name):
    """(N,) bool, an attribute, none where there is no such attribute."""
    attribute = mesh.attributes.get(name)
    return _numbers(attribute)[:, 0] if attribute else np.zeros(0, bool)


def _numbers(attribute):
    """(N, k) numbers of an attribute, byte colours as linear ones."""
    name, width = NUMBERS[attribute.data_type]
    numbers = np.empty(len(attribute.data) * width, DTYPES.get(attribute.data_type, np.float32))
    attribute.data.foreach_get(name, numbers)
    return numbers.reshape(-1, width)


def _read_attribute(data, mesh, name):
    """(T, 3, k) numbers at the corners of triangles, None where the mesh has no such attribute.

    What is not finite is 0, so that no image is looked up there.
    """
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type not in NUMBERS:
        return None
    numbers = np.nan_to_num(_numbers(attribute), copy=False, posinf=0.0, neginf=0.0)
    if attribute.domain == "FACE":
        return np.repeat(numbers[_polygons(data), None], 3, axis=1)
    elements = {"CORNER": mesh.corners, "POINT": mesh.triangles}.get(attribute.domain)
    return None if elements is None else numbers[elements]


def read_uvs(data, mesh: Mesh, name: str | Projection) -> np.ndarray:
    """(T, 3, 2) a UV map, of no name the one to render with; zeros where the mesh has none."""
    if isinstance(name, Projection):
        return _project(data, mesh, name)
    if not name:
        name = next((layer.name for layer in data.uv_layers if layer.active_render), "")
    corners = _read_attribute(data, mesh, name)
    uvs = np.zeros((len(mesh.triangles), 3, 2), np.float32)
    if corners is not None:
        uvs[:] = corners[..., :2] if corners.shape[2] > 1 else corners
    return uvs


def _project(data, mesh, projection):
    """(T, 3, 2) float32, a UV map made of places."""
    places = mesh.positions
    if projection.space == "Generated":
        size = 2 * np.array(data.texspace_size, float)  # it is given as half of the box
        scale = np.divide(1.0, size, out=np.zeros(3), where=size != 0)
        places = (places - np.array(data.texspace_location)) * scale + 0.5
    matrix = np.array(projection.matrix)
    return (places @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32)[mesh.triangles]


def read_colors(data, mesh: Mesh, name: str, part: str) -> np.ndarray:
    """(T, 3, 3) the Color, Fac or Alpha of an attribute; zeros where the mesh has none.

    Of no name the colour attribute to render with.
    """
    if not name:
        index, layers = data.color_attributes.render_color_index, data.color_attributes
        name = layers[index].name if 0 <= index < len(layers) else ""
    corners = _read_attribute(data, mesh, name)
    colors = np.zeros((len(mesh.triangles), 3, 3), np.float32)
    if corners is None:
        return colors
    width = corners.shape[2]
    if part == "Alpha":
        colors[:] = corners[..., 3:] if width == 4 else 1.0
    elif part == "Fac":
        # Cycles takes the first of two numbers, of more the mean of the first three.
        colors[:] = corners[..., : 3 if width > 2 else 1].mean(axis=2, keepdims=True)
    else:
        colors[..., : min(width, 3)] = corners[..., :3]
        if width == 1:
            colors[:] = corners
    return colors
