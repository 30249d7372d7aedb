"""Materials for the tests, what LightTree reads of them, and their values as Cycles sees them."""

import bpy
import numpy as np
from blender_scenes import (
    add_camera,
    add_plane,
    enable_nodes,
    extract,
    new_file,
    render,
)

from lighttree_core import Settings
from lighttree_core.scene import FRONT
from lighttree_core.textures import texture_value
from lighttree_core.world import build_world


class Closure:
    """One row of a scene's closures, its textures as rows of their table or -1."""

    def __init__(self, scene, row):
        for name, column in vars(scene.closures).items():
            setattr(self, name, column[row])


def closures_of(scene, side=FRONT, material=0):
    """The closures of one side of a material."""
    first, num = (
        column[material, side]
        for column in (scene.materials.first_closure, scene.materials.num_closures)
    )
    return [Closure(scene, row) for row in range(first, first + num)]


def the_closure(scene, side=FRONT):
    """The only closure of one side of the only material."""
    (closure,) = closures_of(scene, side)
    return closure


def emission_row(cases, build, tmp_path, samples=1):
    """What comes of nodes: (emission as extracted, as Cycles renders it, notes), one row a case.

    build: see `render_row`.
    """
    scene, seen = render_row(cases, build, tmp_path, samples)
    return scene.materials.emission[:, FRONT], seen, scene.not_modelled


def render_row(cases, build, tmp_path, samples=1, place=lambda case: {"scale": (1, 4, 1)}):
    """(a scene of a plane for each case, the (cases, 3) that Cycles sees of them).

    build: of a case, a node tree and its Emission node. Of each case Cycles sees a pixel, from
    above. place: of a case, how its plane is turned and stretched.
    """
    num = len(cases)
    scene = new_file(samples)
    scene.render.resolution_x, scene.render.resolution_y = num, 4  # fewer rows there cannot be
    for i, case in enumerate(cases):
        material = bpy.data.materials.new(f"M{i}")
        tree = enable_nodes(material)
        tree.nodes.clear()
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        build(case, tree, emission)
        add_plane(1.0, material, location=(i - (num - 1) / 2, 0, 0), **place(case))
    add_camera(ortho_scale=max(num, 4), location=(0, 0, 50))
    scene = extract()
    left = (max(num, 4) - num) // 2
    return scene, render(tmp_path)[1, left : left + num]


PIXELS = 8  # along each side of what Cycles sees of a case


def picture_row(cases, build, tmp_path, samples=64, per_pixel=3):
    """The same of materials that vary: ((PIXELS, PIXELS * cases, 3) extracted, rendered, notes).

    build: of a case, the material's node tree, its Emission node and the mesh, whose UV map is
    that of a plane, 0 to 1.
    """
    num = len(cases)
    scene = new_file(samples)
    scene.render.resolution_x, scene.render.resolution_y = PIXELS * num, PIXELS
    for i, case in enumerate(cases):
        material = bpy.data.materials.new(f"M{i}")
        tree = enable_nodes(material)
        tree.nodes.clear()
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        mesh = add_plane(1.0, material, location=(i - (num - 1) / 2, 0, 0)).data
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", [0, 0, 1, 0, 1, 1, 0, 1])
        build(case, tree, emission, mesh)
    add_camera(ortho_scale=num, location=(0, 0, 1))
    scene = extract()
    scene.check()
    return emission_picture(scene, num, per_pixel), render(tmp_path), scene.not_modelled


def emission_picture(scene, num, per_pixel):
    """(PIXELS, PIXELS * num, 3) emission of what a camera above sees, by LightTree's kernels."""
    world = build_world(scene, Settings())
    steps = (np.arange(PIXELS * per_pixel) + 0.5) / (PIXELS * per_pixel)
    picture = np.zeros((len(steps), len(steps) * num, 3))
    corners = scene.vertices[scene.triangles][:, :, :2].astype(float)
    for row, y in enumerate(steps - 0.5):
        for column in range(len(steps) * num):
            x = (column + 0.5) / len(steps) - num / 2
            triangle, u, v = _find(corners, x, y)
            material = scene.triangle_material[triangle]
            emission = scene.materials.emission[material, FRONT]
            texture = scene.materials.emission_texture[material, FRONT]
            if texture >= 0:
                emission = emission * texture_value(
                    world.geometry, world.textures, texture, triangle, u, v, (0.0, 0.0, 1.0)
                )
            picture[row, column] = emission
    shape = (PIXELS, per_pixel, PIXELS * num, per_pixel, 3)
    return picture.reshape(shape).mean(axis=(1, 3))


def _find(corners, x, y):
    """(triangle, and the barycentric coordinates in it) of a point of the plane."""
    a, b, c = np.moveaxis(corners, 1, 0)
    edges = np.stack([b - a, c - a], axis=2)
    u, v = np.linalg.solve(edges, ((x, y) - a)[:, :, None])[..., 0].T
    triangle = int(np.argmax(np.minimum(np.minimum(u, v), 1 - u - v)))
    return triangle, np.float32(u[triangle]), np.float32(v[triangle])
