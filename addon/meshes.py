"""Blender's meshes -> triangles in the world, with what their corners carry.

A mesh is read once and placed as often as it is instanced. Of normals, UV maps and attributes only
those are kept that some triangle is smooth by, or some material needs.
"""

from __future__ import annotations

import numpy as np

from lighttree_core.scene import CAMERA_RAY

from .lamps import NOT_LINKED, is_linked, ray_visibility
from .materials import MaterialTable
from .mesh_data import read_colors, read_mesh, read_uvs
from .nodes import Notes

COINCIDENT = (
    "some of its faces lie in the place of others: each is lit here as if it were alone, by Cycles "
    "they are in each other's shadow."
)
HASH_FACTORS = np.uint64([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9])


class MeshTable:
    """Gathers the mesh objects of a view layer."""

    def __init__(self, view_layer, notes: Notes):
        self.view_layer, self.notes = view_layer, notes
        self.override = view_layer.material_override  # the material of all of them, or None
        self.materials = MaterialTable(notes)
        self.visible = {}  # addresses of an object and its holder -> rays that meet it
        self.meshes = {}  # address -> Mesh, None if it has no faces
        # (address, material rows of its slots) -> [(matrix, object name, rays that meet it)]
        self.placed = {}

    def add(self, thing, matrix, holder):
        """Add an object of type MESH and its matrix in the world.

        holder: the instancer that places it, or itself.
        """
        key = thing.data.as_pointer()
        if key not in self.meshes:
            self.meshes[key] = read_mesh(_data(thing))
        mesh = self.meshes[key]
        if mesh is not None:
            # Instances come one after another at the same address.
            origin = thing.original.as_pointer(), holder.original.as_pointer()
            if origin not in self.visible:
                self._note(thing, holder, mesh)
                self.visible[origin] = self._visible(thing, holder)
            rows = tuple(self.materials.row(self._material(thing, slot)) for slot in mesh.slots)
            if (key, rows) not in self.placed:
                self.placed[key, rows] = []
                self._read_corners(thing, mesh, rows)
            # Copied at once: Blender writes the next instance's matrix to the same place.
            copy = matrix[0][:] + matrix[1][:] + matrix[2][:]
            self.placed[key, rows].append((copy, thing.name, self.visible[origin]))
            if matrix.determinant() == 0 and _is_flattened(mesh, copy):
                self.notes.add(thing.name, COINCIDENT)

    def _visible(self, thing, holder):
        """Bits of the rays that meet an object where its holder places it."""
        visible = ray_visibility(thing) & ray_visibility(holder)
        if holder.indirect_only_get(view_layer=self.view_layer):
            visible &= ~CAMERA_RAY
        return visible

    def _material(self, thing, slot):
        """What a slot holds; an index beyond the slots means the last, as in Blender."""
        slots = thing.material_slots
        if self.override or not slots:
            return self.override
        return slots[min(max(int(slot), 0), len(slots) - 1)].material

    def _read_corners(self, thing, mesh, rows):
        """Read the UV maps and attributes that some materials need of an object's mesh."""
        data = _data(thing)
        names = {row: name for name, row in self.materials.uv_maps.items()}
        sources = {row: source for source, row in self.materials.attributes.items()}
        for uv_rows, color_rows in (self.materials.needs[row] for row in rows):
            for row in uv_rows - mesh.uvs.keys():
                mesh.uvs[row] = read_uvs(data, mesh, names[row])
                if getattr(names[row], "space", "") == "Generated" and _is_modified(thing):
                    self.notes.add(thing.name, "its Generated coordinates are as modified.")
            for row in color_rows - mesh.colors.keys():
                mesh.colors[row] = read_colors(data, mesh, *sources[row])

    def _note(self, thing, holder, mesh):
        is_holdout = thing.is_holdout or holder.holdout_get(view_layer=self.view_layer)
        if is_holdout or thing.is_shadow_catcher:
            self.notes.add(thing.name, "rendered as an ordinary object.")
        if is_linked(thing):
            self.notes.add(thing.name, NOT_LINKED)
        if mesh.is_broken:
            self.notes.add(thing.name, "its faces with a vertex at no finite place are left out.")
        hair = (system.settings for system in thing.particle_systems)
        if any(x.type == "HAIR" and x.render_type == "PATH" for x in hair):
            self.notes.add(thing.name, "its hair is left out.")

    def geometry(self) -> dict[str, np.ndarray | list[str]]:
        """The triangles and objects, by their names in Scene."""
        groups = [(self.meshes[key], rows, placed) for (key, rows), placed in self.placed.items()]
        num_vertices = sum(len(mesh.positions) * len(placed) for mesh, _, placed in groups)
        num_triangles = sum(len(mesh.triangles) * len(placed) for mesh, _, placed in groups)
        is_smooth = any(mesh.normals is not None for mesh, _, _ in groups)
        out = {
            "vertices": np.empty((num_vertices, 3), np.float32),
            "triangles": np.empty((num_triangles, 3), np.int32),
            "triangle_material": np.empty(num_triangles, np.int32),
            "corner_normals": np.empty((num_triangles * is_smooth, 3, 3), np.float32),
            "uvs": np.zeros((len(self.materials.uv_maps), num_triangles, 3, 2), np.float32),
            "colors": np.zeros((len(self.materials.attributes), num_triangles, 3, 3), np.float32),
        }
        vertex = triangle = 0
        names, first_triangles, visible = [], [], []
        for mesh, rows, placed in groups:
            end_vertex = vertex + len(mesh.positions) * len(placed)
            end_triangle = triangle + len(mesh.triangles) * len(placed)
            here = _Room(out, slice(vertex, end_vertex), slice(triangle, end_triangle), len(placed))
            here.place(mesh, np.array(rows, np.int32), [matrix for matrix, _, _ in placed])
            names += [name for _, name, _ in placed]
            visible += [rays for _, _, rays in placed]
            first_triangles += range(triangle, end_triangle, len(mesh.triangles))
            vertex, triangle = end_vertex, end_triangle
        out["object_names"] = names
        out["object_first_triangle"] = np.array(first_triangles, np.int32)
        out["object_visible"] = np.array(visible, np.int32)
        self._note_coincident(out)
        return out

    def _note_coincident(self, out):
        triangles = find_coincident(out["vertices"], out["triangles"])
        objects = np.searchsorted(out["object_first_triangle"], triangles, side="right") - 1
        for row in np.unique(objects):
            self.notes.add(out["object_names"][row], COINCIDENT)


def find_coincident(vertices, triangles) -> np.ndarray:
    """Ids of the triangles that lie in the place of another, whichever way they face."""
    if len(triangles) < 2:
        return np.zeros(0, np.int64)
    bits = (vertices + np.float32(0)).view(np.uint32)  # no negative zeros
    hashes = sum(bits[:, i] * factor for i, factor in enumerate(HASH_FACTORS))
    hashes ^= hashes >> np.uint64(29)
    keys = sum(hashes[triangles[:, i]] for i in range(3))  # whatever the order of the corners
    if np.diff(np.sort(keys)).all():
        return np.zeros(0, np.int64)
    order = np.argsort(keys)
    is_same = np.diff(keys[order]) == 0
    found = order[np.append(is_same, False) | np.append(False, is_same)]
    corners = vertices[triangles[found]]
    edges = corners[:, 1:].astype(np.float64) - corners[:, :1]
    found = found[np.cross(edges[:, 0], edges[:, 1]).any(axis=1)]
    return np.sort(found)


def _is_flattened(mesh, matrix):
    """Whether a matrix of 12 numbers leaves a mesh areas, but takes its thickness away."""
    is_lost = ~np.reshape(matrix, (3, 4))[:, :3].any(axis=0)
    return is_lost.sum() == 1 and bool(np.ptp(mesh.positions[:, is_lost]) > 0)


def _data(thing):
    """The mesh of an object; of one in edit mode that which is being edited."""
    return thing.to_mesh() if thing.data.is_editmode else thing.data


def _is_modified(thing):
    """Whether an object's mesh is not as it was modelled, which Generated coordinates are of."""
    modifiers = (modifier.show_render for modifier in thing.modifiers)
    return any(modifiers) or getattr(thing.original.data, "shape_keys", None) is not None


class _Room:
    """The rows of a scene's arrays that the instances of one mesh take up."""

    def __init__(self, out, vertices, triangles, num_instances):
        self.out, self.vertices, self.triangles = out, vertices, triangles
        self.num_instances = num_instances

    def place(self, mesh, material_rows, matrices):
        """Write all instances of a mesh; matrices: 12 numbers each."""
        matrices = np.array(matrices).reshape(-1, 3, 4)
        world_from_local, offset = matrices[:, :, :3], matrices[:, None, :, 3]
        # BLAS takes ten times as long for matrices of this shape.
        world = np.einsum("vj,ikj->ivk", mesh.positions, world_from_local) + offset
        self.out["vertices"][self.vertices] = world.reshape(-1, 3)
        first = self.vertices.start + len(mesh.positions) * np.arange(self.num_instances)
        # A mirrored triangle turns its front away unless its corners change their order.
        mirrored = np.linalg.det(world_from_local) < 0
        self._write("triangles", mesh.triangles + first[:, None, None], mirrored)
        materials = material_rows[mesh.triangle_slot]
        self.out["triangle_material"][self.triangles] = np.tile(materials, self.num_instances)
        if len(self.out["corner_normals"]):
            self._place_normals(mesh, world_from_local, mirrored)
        for name, arrays in (("uvs", mesh.uvs), ("colors", mesh.colors)):
            for row, corners in arrays.items():
                same = np.broadcast_to(corners, (self.num_instances, *corners.shape))
                self._write(name, same, mirrored, row)

    def _write(self, name, instances, mirrored, *row):
        """Write what the corners of all instances have, (instances, T, 3, ...)."""
        out = self.out[name][row][self.triangles].reshape(
            self.num_instances, -1, 3, *instances.shape[3:]
        )
        out[:] = instances
        out[mirrored] = out[mirrored][:, :, ::-1]

    def _place_normals(self, mesh, world_from_local, mirrored):
        """The inverse transpose carries normals; flat meshes have those of their triangles."""
        out = self.out["corner_normals"][self.triangles]
        if mesh.normals is None:
            out[:] = self._flat_normals(slice(None))[:, None]
            return
        # The cofactors are the inverse transpose times the determinant, whose size has no say.
        u, v, w = np.moveaxis(world_from_local, 2, 0)
        cofactors = np.stack([np.cross(v, w), np.cross(w, u), np.cross(u, v)], axis=2)
        cofactors *= np.where(mirrored, -1.0, 1.0)[:, None, None]
        cofactors /= np.maximum(np.abs(cofactors).max(axis=(1, 2), keepdims=True), 1e-300)
        turned = np.einsum("tcj,ikj->itck", mesh.normals, cofactors.astype(np.float32))
        self._write("corner_normals", turned, mirrored)
        length = np.sqrt(np.einsum("tci,tci->tc", out, out))
        is_lost = ~((length > 0) & np.isfinite(length)).all(axis=1)
        length[is_lost] = 1.0
        out /= length[:, :, None]
        if is_lost.any():
            out[is_lost] = self._flat_normals(is_lost)[:, None]

    def _flat_normals(self, chosen):
        """(n, 3) geometric normals of some of the triangles here; of those without area, up."""
        triangles = self.out["triangles"][self.triangles][chosen]
        a, b, c = (self.out["vertices"][triangles[:, i]].astype(np.float64) for i in range(3))
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.where(length > 0, normals / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
