"""Blender's evaluated depsgraph -> Scene. Here Blender ends.

Every object arrives as an instance of some data: a mesh is read once and placed as often as it is
instanced. What LightTree renders otherwise than Cycles is told in `Scene.not_modelled`.
"""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np

from lighttree_core.scene import Scene, SceneError

from .camera import extract_camera
from .lamps import NOT_LINKED, LampTable, is_linked
from .materials import MaterialTable, read_background
from .nodes import Notes

LEFT_OUT = {
    "CURVES": "hair curves are left out.",
    "POINTCLOUD": "point clouds are left out.",
    "VOLUME": "volumes are left out.",
    "GREASEPENCIL": "Grease Pencil is left out.",
}
RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow")


def extract_scene(depsgraph, width_px: int | None = None, height_px: int | None = None) -> Scene:
    """One frame of an evaluated depsgraph; width and height are those of the full frame.

    Raises SceneError for what cannot be rendered at all.
    """
    notes = Notes()
    scene, view_layer = depsgraph.scene_eval, depsgraph.view_layer_eval
    _check_working_space()
    camera = extract_camera(depsgraph, width_px, height_px, notes)
    world = view_layer.world_override or scene.world
    background = read_background(world, notes)
    _note_settings(scene.render, world, notes)

    lamps, meshes = LampTable(notes), MeshTable(view_layer.material_override, notes)
    for instance in depsgraph.object_instances:
        thing = instance.object
        if not instance.show_self:
            continue
        # Text, curves and metaballs come a second time, as the mesh they make.
        if thing.type == "MESH":
            meshes.add(thing, instance.matrix_world)
        elif thing.type == "LIGHT":
            lamps.add(thing, instance.matrix_world)
        elif thing.type in LEFT_OUT:
            notes.add(thing.name, LEFT_OUT[thing.type])
    return Scene(
        camera=camera,
        lamps=lamps.lamps(),
        background=background.astype(np.float32),
        **meshes.geometry(),
        materials=meshes.materials.materials(),
        not_modelled=notes.sentences(),
    )


def _check_working_space():
    # Up to 4.5 there is no choice.
    space = getattr(getattr(bpy.data, "colorspace", None), "working_space", "Linear Rec.709")
    if space != "Linear Rec.709":
        raise SceneError(
            f"The working space of the file is {space}: LightTree renders in Linear Rec.709, set "
            "it under Scene properties > Color Management."
        )


def _note_settings(render, world, notes):
    if render.use_motion_blur:
        notes.add("Scene", "without motion blur.")
    if render.film_transparent:
        notes.add("Scene", "the film is not transparent, the background is seen.")
    visibility = getattr(world, "cycles_visibility", None)
    if visibility and not all(getattr(visibility, ray) for ray in RAYS):
        notes.add(f"World {world.name}", "its Ray Visibility is ignored.")


class _Mesh(NamedTuple):
    """A mesh in its local space.

    positions: (V, 3) float64. triangles: (T, 3) int32. slots: the material slots in use.
    triangle_slot: (T,) index into `slots`.
    """

    positions: np.ndarray
    triangles: np.ndarray
    slots: np.ndarray
    triangle_slot: np.ndarray
    is_smooth: bool


class MeshTable:
    """Gathers mesh objects; override: the material of all of them, or None."""

    def __init__(self, override, notes: Notes):
        self.override = override
        self.notes = notes
        self.materials = MaterialTable(notes)
        self.meshes = {}  # address -> _Mesh
        self.placed = {}  # (address, material rows of its slots) -> [(matrix, object name)]

    def add(self, thing, matrix):
        """Add an object of type MESH and its matrix in the world."""
        key = thing.data.as_pointer()
        if key not in self.meshes:
            self.meshes[key] = _read_mesh(thing.data)
        mesh = self.meshes[key]
        if len(mesh.triangles) > 0:
            self._note(thing, mesh)
            rows = tuple(self.materials.row(self._material(thing, slot)) for slot in mesh.slots)
            # Copied at once: Blender writes the next instance's matrix to the same place.
            copy = matrix[0][:] + matrix[1][:] + matrix[2][:]
            self.placed.setdefault((key, rows), []).append((copy, thing.name))

    def _material(self, thing, slot):
        """What a slot holds; an index beyond the slots means the last, as in Blender."""
        slots = thing.material_slots
        if self.override or not slots:
            return self.override
        return slots[min(max(int(slot), 0), len(slots) - 1)].material

    def _note(self, thing, mesh):
        if mesh.is_smooth:
            self.notes.add(thing.name, "smooth shading is rendered flat.")
        if not all(getattr(thing, f"visible_{ray}") for ray in RAYS):
            self.notes.add(thing.name, "its Ray Visibility is ignored.")
        if thing.is_holdout or thing.is_shadow_catcher:
            self.notes.add(thing.name, "rendered as an ordinary object.")
        if is_linked(thing):
            self.notes.add(thing.name, NOT_LINKED)
        hair = (system.settings for system in thing.particle_systems)
        if any(x.type == "HAIR" and x.render_type == "PATH" for x in hair):
            self.notes.add(thing.name, "its hair is left out.")

    def geometry(self) -> dict[str, np.ndarray | list[str]]:
        """The triangles and objects, by their names in Scene."""
        vertices, triangles, materials, names, num_triangles = [], [], [], [], []
        num_vertices = 0
        for (key, rows), instances in self.placed.items():
            mesh = self.meshes[key]
            matrices = np.array([matrix for matrix, _ in instances]).reshape(-1, 3, 4)
            world_from_local, offset = matrices[:, :, :3], matrices[:, None, :, 3]
            world = mesh.positions @ world_from_local.transpose(0, 2, 1) + offset
            first_vertex = num_vertices + len(mesh.positions) * np.arange(len(instances))
            placed = mesh.triangles + first_vertex[:, None, None]
            # A mirrored triangle turns its front away unless its corners change their order.
            mirrored = np.linalg.det(world_from_local) < 0
            placed[mirrored] = placed[mirrored, :, ::-1]

            vertices.append(world.reshape(-1, 3).astype(np.float32))
            triangles.append(placed.reshape(-1, 3).astype(np.int32))
            materials.append(np.tile(np.array(rows, np.int32)[mesh.triangle_slot], len(instances)))
            names += [name for _, name in instances]
            num_triangles += [len(mesh.triangles)] * len(instances)
            num_vertices += len(mesh.positions) * len(instances)
        return {
            "vertices": np.concatenate([np.zeros((0, 3), np.float32), *vertices]),
            "triangles": np.concatenate([np.zeros((0, 3), np.int32), *triangles]),
            "triangle_material": np.concatenate([np.zeros(0, np.int32), *materials]),
            "object_names": names,
            "object_first_triangle": (np.cumsum(num_triangles) - num_triangles).astype(np.int32),
        }


def _read_mesh(mesh):
    """A mesh, by the fast ways through Blender's API."""
    mesh.calc_loop_triangles()
    num_triangles = len(mesh.loop_triangles)
    triangles = np.empty(3 * num_triangles, np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)

    slots, triangle_slot = np.zeros(1, np.int32), np.zeros(num_triangles, np.int32)
    if "material_index" in mesh.attributes:  # else all are 0
        polygon_slot = np.empty(len(mesh.polygons), np.int32)
        mesh.attributes["material_index"].data.foreach_get("value", polygon_slot)
        polygon = np.empty(num_triangles, np.int32)
        mesh.loop_triangle_polygons.foreach_get("value", polygon)
        slots, polygon_slot = np.unique(polygon_slot, return_inverse=True)
        triangle_slot = polygon_slot[polygon]
    return _Mesh(
        positions=positions.reshape(-1, 3).astype(np.float64),
        triangles=triangles.reshape(-1, 3),
        slots=slots,
        triangle_slot=triangle_slot,
        is_smooth=mesh.normals_domain != "FACE",
    )
