"""A camera for a scene that has none: it looks at everything from the front, right and above."""

from __future__ import annotations

import math

import bpy
from mathutils import Matrix, Vector

DIRECTION = Vector((1, -2, 1)).normalized()  # from what is looked at to the camera
NOTHING_SIZE = 2.0  # metres looked at where there is nothing
MARGIN = 1.05


def add_camera(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    """Add a camera of that name to a scene, in which all that is rendered is just seen."""
    lens = bpy.data.cameras.new(name)
    camera = bpy.data.objects.new(name, lens)
    scene.collection.objects.link(camera)
    layer = next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
    layer.update()
    points = _corners(layer.depsgraph)
    place = DIRECTION.to_track_quat("Z", "Y").to_matrix().to_4x4()
    low, high = (Vector(map(pick, *points)) for pick in (min, max))
    middle = (low + high) / 2
    aspect_x = scene.render.resolution_x * scene.render.pixel_aspect_x
    aspect_y = scene.render.resolution_y * scene.render.pixel_aspect_y
    half = math.tan(lens.angle / 2)
    slope_x = half * min(1, aspect_x / aspect_y)
    slope_y = half * min(1, aspect_y / aspect_x)
    from_middle = [place.inverted() @ (point - middle) for point in points]
    reach = max(max(abs(p.x) / slope_x, abs(p.y) / slope_y) + p.z for p in from_middle)
    distance = MARGIN * reach or NOTHING_SIZE  # there may be a single point
    camera.matrix_world = Matrix.Translation(middle + distance * DIRECTION) @ place
    lens.clip_start = distance / 1000
    lens.clip_end = 2 * distance + (high - low).length
    return camera


def _corners(depsgraph: bpy.types.Depsgraph) -> list[Vector]:
    """Corners of the boxes around all that has a surface, in world space."""
    corners = []
    for instance in depsgraph.object_instances:
        item = instance.object
        if instance.show_self and item.type == "MESH" and len(item.data.vertices):
            corners += [instance.matrix_world @ Vector(corner) for corner in item.bound_box]
    corners = [corner for corner in corners if all(map(math.isfinite, corner))]
    if not corners:
        corners = [Vector((x, 0, z)) for x in (-1, 1) for z in (-1, 1)]
        corners = [corner * NOTHING_SIZE / 2 for corner in corners]
    return corners
