"""Small .blend files of the kinds that strangers have; each function makes one of the open file.

The open file has a camera above a grey plane, a box on it and a lamp. What a function returns, if
anything, is done to the folder once the file is saved there.
"""

import math
from pathlib import Path

import blender_scenes as blend
import bmesh
import bpy
import numpy as np

FILES = {}


def strange(build):
    FILES[build.__name__] = build
    return build


def build_file(name: str, folder: Path) -> Path:
    """Save the strange file of that name in a folder."""
    blend.new_file(samples=64)
    scene = bpy.context.scene
    blend.add_camera(location=(0, 0, 6))
    blend.add_plane(6, blend.new_material("Ground", Color=(0.6, 0.5, 0.4)), name="Ground")
    add_box("Box", blend.new_material("Box", Color=(0.2, 0.4, 0.7)))
    blend.add_lamp("POINT", "Lamp", {"energy": 300, "shadow_soft_size": 0.3}, location=(2, 1, 4))
    scene.render.resolution_x = scene.render.resolution_y = 32
    path = folder / f"{name}.blend"
    afterwards = FILES[name](scene, folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    if afterwards:
        afterwards()
    return path


def add_box(name="Box", material=None, size=1.0, **place):
    mesh = bpy.data.meshes.new(name)
    shape = bmesh.new()
    bmesh.ops.create_cube(shape, size=size)
    shape.to_mesh(mesh)
    if material:
        mesh.materials.append(material)
    return blend.add_object(name, mesh, **{"location": (0, 0, 0.5)} | place)


def the_box():
    return bpy.data.objects["Box"]


# What the file does to its render


@strange
def sequencer_strips(scene, folder):
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strips.new_effect("Red", "COLOR", channel=1, frame_start=1, **_length(strips, 100))


def _length(strips, length):
    names = strips.bl_rna.functions["new_effect"].parameters.keys()
    return {"length": length} if "length" in names else {"frame_end": 1 + length}


@strange
def freestyle(scene, folder):
    scene.render.use_freestyle = True


@strange
def compositor_without_inputs(scene, folder):
    tree = _compositor(scene)
    tree.nodes.new("CompositorNodeRLayers").layer = scene.view_layers[0].name
    tree.nodes.new("CompositorNodeImage")
    tree.nodes.new("CompositorNodeBlur")


@strange
def compositor_that_writes_files(scene, folder):
    tree = _compositor(scene)
    layers = tree.nodes.new("CompositorNodeRLayers")
    output = tree.nodes.new("CompositorNodeOutputFile")
    if hasattr(output, "base_path"):
        output.base_path = str(folder / "written")
    else:
        output.directory = str(folder / "written")
        output.file_output_items.new("RGBA", "Image")
    tree.links.new(layers.outputs[0], output.inputs[0])


def _compositor(scene):
    if bpy.app.version < (5, 0):
        scene.use_nodes = True
        return scene.node_tree
    scene.compositing_node_group = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
    return scene.compositing_node_group


@strange
def border_with_crop(scene, folder):
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = 0.7, 1
    render.border_min_y, render.border_max_y = 0.25, 0.75


@strange
def a_scene_of_scenes(scene, folder):
    bpy.data.scenes.new("Empty")


@strange
def a_view_layer_that_is_off(scene, folder):
    scene.view_layers.new("Other")
    scene.view_layers[0].use = False


@strange
def frames_and_a_step(scene, folder):
    scene.frame_start, scene.frame_end, scene.frame_step = -10, 1000, 7
    the_box().keyframe_insert("location", frame=1)
    the_box().location.x = 2
    the_box().keyframe_insert("location", frame=20)
    scene.frame_set(10)


@strange
def filepath_with_templates(scene, folder):
    scene.render.filepath = "//{blend_name}/%s '#' \"{0}\"/####"


# What is missing


@strange
def missing_library(scene, folder):
    library = link_sphere(scene, folder)
    return library.unlink


@strange
def damaged_library(scene, folder):
    library = link_sphere(scene, folder)
    content = library.read_bytes()
    return lambda: library.write_bytes(content[: len(content) // 2])


@strange
def library_without_the_object(scene, folder):
    library = link_sphere(scene, folder)
    world = bpy.data.worlds.new("Elsewhere")
    bpy.data.libraries.write(str(library), {world}, fake_user=True)


@strange
def library_override(scene, folder):
    link_sphere(scene, folder)
    bpy.data.objects["Linked"].override_create(remap_local_usages=True).location.x = -1


def link_sphere(scene, folder):
    """Link an object from a library beside the file; the library."""
    library, linked = folder / "library.blend", add_box("Linked", location=(1, 0, 0.5))
    bpy.data.libraries.write(str(library), {linked}, fake_user=True)
    bpy.data.objects.remove(linked)
    with bpy.data.libraries.load(str(library), link=True) as (_, chosen):
        chosen.objects = ["Linked"]
    scene.collection.objects.link(chosen.objects[0])
    return library


@strange
def missing_image(scene, folder):
    image = bpy.data.images.new("Bricks", 4, 4)
    image.source, image.filepath = "FILE", "//nowhere/bricks.png"
    _show_image(image)


@strange
def huge_image(scene, folder):
    image = bpy.data.images.new("Huge", 4096, 4096)
    image.pixels.foreach_set(np.tile(np.float32([0.5, 0.2, 0.1, 1]), 4096 * 4096))
    image.pack()
    _show_image(image)


def _show_image(image):
    material = bpy.data.materials["Box"]
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    shader = next(node for node in material.node_tree.nodes if "Color" in node.inputs)
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Color"])


@strange
def no_world_and_no_materials(scene, folder):
    for item in list(bpy.data.materials):
        bpy.data.materials.remove(item)


@strange
def thousands_of_material_slots(scene, folder):
    for number in range(2000):
        the_box().data.materials.append(bpy.data.materials["Box"] if number % 2 else None)


# Shapes


@strange
def nothing_at_all(scene, folder):
    for item in list(scene.objects):
        if item.type != "CAMERA":
            bpy.data.objects.remove(item)


@strange
def cyclic_parents(scene, folder):
    other = add_box("Other", location=(1, 1, 0.5))
    the_box().parent = other
    constraint = other.constraints.new("COPY_LOCATION")
    constraint.target, constraint.influence = the_box(), 0  # or it wanders with each evaluation


@strange
def zero_scale(scene, folder):
    the_box().scale = (0, 0, 0)
    add_box("Flat", location=(1, 1, 0.5), scale=(1, 1, 0))


@strange
def sheared(scene, folder):
    parent = blend.add_object("Parent", None, scale=(3, 0.3, 1))
    child = add_box("Sheared", rotation=(0.3, 0.2, 0.7), location=(0.2, 1, 0.5))
    child.parent = parent


@strange
def mirrored(scene, folder):
    the_box().scale = (-1, 1, 1)


@strange
def vertices_that_are_not_numbers(scene, folder):
    broken = add_box("Broken", location=(-1, -1, 0.5))
    broken.data.vertices[0].co = (math.nan, 0, 0)
    broken.data.vertices[1].co = (math.inf, 0, 0)


@strange
def empty_meshes(scene, folder):
    blend.add_object("No Faces", bpy.data.meshes.new("No Faces"))
    points = bpy.data.meshes.new("Points")
    points.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    blend.add_object("Points", points)


@strange
def degenerate_and_loose_faces(scene, folder):
    mesh = bpy.data.meshes.new("Degenerate")
    corners = [(0, 0, 1), (1, 0, 1), (0.5, 0, 1), (0, 1, 1), (0, 0, 1), (1, 1, 1.5)]
    mesh.from_pydata(corners, [], [(0, 1, 2), (0, 4, 3), (0, 1, 3), (1, 3, 5), (3, 1, 5)])
    blend.add_object("Degenerate", mesh)


@strange
def metaballs(scene, folder):
    ball = bpy.data.metaballs.new("Ball")
    ball.elements.new().radius = 1.0
    blend.add_object("Ball", ball, location=(-1, 1, 0.5))


@strange
def text(scene, folder):
    letters = bpy.data.curves.new("Letters", "FONT")
    letters.body, letters.extrude = "Ab", 0.2
    blend.add_object("Letters", letters, location=(-1, 1, 0.5))


@strange
def curves(scene, folder):
    line = bpy.data.curves.new("Line", "CURVE")
    line.dimensions, line.bevel_depth = "3D", 0.2
    spline = line.splines.new("POLY")
    spline.points.add(2)
    spline.points.foreach_set("co", [-2, 0, 0.5, 1, 0, 1, 0.5, 1, 2, 0, 0.5, 1])
    blend.add_object("Line", line)


@strange
def grease_pencil(scene, folder):
    data = getattr(bpy.data, "grease_pencils_v3", bpy.data.grease_pencils)
    blend.add_object("Pencil", data.new("Pencil"))


@strange
def a_volume(scene, folder):
    blend.add_object("Cloud", bpy.data.volumes.new("Cloud"))


@strange
def ten_thousand_objects_of_one_mesh(scene, folder):
    mesh = the_box().data
    for number in range(10_000):
        place = (number % 100 / 20 - 2.5, number // 100 / 20 - 2.5, 0.05)
        blend.add_object("Copy", mesh, location=place, scale=(0.02, 0.02, 0.02))


@strange
def instances_of_instances(scene, folder):
    inner, outer = bpy.data.collections.new("Inner"), bpy.data.collections.new("Outer")
    inner.objects.link(add_box("Seed", location=(0, 0, 0.3), size=0.4))
    for x in (-1, 1):
        row = bpy.data.objects.new("Row", None)
        row.instance_type, row.instance_collection, row.location.x = "COLLECTION", inner, x
        outer.objects.link(row)
    for y in (-1, 1):
        item = blend.add_object("Rows", None, location=(0, y, 0))
        item.instance_type, item.instance_collection = "COLLECTION", outer


@strange
def hidden_collections(scene, folder):
    for name, hide in (("Off", "hide_render"), ("Unseen", "hide_viewport")):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        collection.objects.link(add_box(name, location=(1, 1, 0.5)))
        scene.collection.objects.unlink(bpy.data.objects[name])
        setattr(collection, hide, True)
    excluded = bpy.data.collections.new("Excluded")
    scene.collection.children.link(excluded)
    scene.view_layers[0].layer_collection.children["Excluded"].exclude = True


@strange
def fluid_without_a_cache(scene, folder):
    add_box("Domain", size=2).modifiers.new("Fluid", "FLUID").fluid_type = "DOMAIN"
    domain = bpy.data.objects["Domain"].modifiers["Fluid"].domain_settings
    domain.domain_type, domain.cache_directory = "LIQUID", str(folder / "nowhere")


# Lamps and cameras


@strange
def negative_lamp(scene, folder):
    blend.add_lamp("POINT", "Dark", {"energy": -50}, location=(-2, 0, 3))


@strange
def strong_lamp(scene, folder):
    bpy.data.lights["Lamp"].energy = 1e12


@strange
def weak_lamp(scene, folder):
    bpy.data.lights["Lamp"].energy = 1e-12


@strange
def camera_in_an_object(scene, folder):
    scene.camera.location = (0, 0, 0.5)


@strange
def a_million_metres_away(scene, folder):
    for item in scene.objects:
        item.location.x += 1e6


@strange
def drivers_and_scripts(scene, folder):
    driver = the_box().driver_add("location", 0).driver
    driver.expression = f"__import__('os').mkdir({str(folder / 'ran')!r}) or 1"
    script = bpy.data.texts.new("run.py")
    script.use_module = True
    script.write(f"import os\nos.mkdir({str(folder / 'ran')!r})\n")
    return lambda: (folder / "ran").exists() and (folder / "ran").rmdir()


@strange
def no_camera(scene, folder):
    bpy.data.objects.remove(scene.camera)
