"""Small Blender files for the tests, and what Cycles and LightTree's extract make of them."""

import math

import bpy
import numpy as np
import OpenEXR
import oracle

from lighttree_addon.extract import extract_scene


def new_file(samples=64, max_bounces=0):
    """An empty file, its settings unbiased and comparable; its scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    settings = {
        "samples": samples,
        "use_adaptive_sampling": False,
        "use_denoising": False,
        "sample_clamp_indirect": 0.0,
        "blur_glossy": 0.0,
        "light_sampling_threshold": 0.0,
        "pixel_filter_type": "BOX",
        "max_bounces": max_bounces,
        "diffuse_bounces": max_bounces,
        "glossy_bounces": max_bounces,
    }
    for name, value in settings.items():
        setattr(scene.cycles, name, value)
    if hasattr(scene, "lighttree"):
        scene.lighttree.filter = "box"
    return scene


def new_scene():
    """An empty file with a camera."""
    new_file()
    add_camera()


def add_object(name, data, location=(0, 0, 0), rotation=(0, 0, 0), scale=(1, 1, 1)):
    """Any object in the scene; rotation: XYZ angles in radians."""
    thing = bpy.data.objects.new(name, data)
    thing.location, thing.rotation_euler, thing.scale = location, rotation, scale
    bpy.context.scene.collection.objects.link(thing)
    return thing


def add_plane(size=2.0, material=None, name="Plane", **place):
    """A square around the origin of its object, its front towards +Z."""
    half = size / 2
    mesh = bpy.data.meshes.new(name)
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    if material:
        mesh.materials.append(material)
    return add_object(name, mesh, **place)


def add_lamp(kind, name="Lamp", settings=None, **place):
    """A light object of 100 W (a sun: 100 W/m^2); settings: of its data-block."""
    light = bpy.data.lights.new(name, kind)
    light.energy = 100.0
    for key, value in (settings or {}).items():
        setattr(light, key, value)
    return add_object(name, light, **place)


def add_camera(ortho_scale=None, settings=None, name="Camera", **place):
    """A camera, made that of the scene; orthographic if a scale is given."""
    camera = bpy.data.cameras.new(name)
    if ortho_scale is not None:
        camera.type, camera.ortho_scale = "ORTHO", ortho_scale
    for key, value in (settings or {}).items():
        setattr(camera, key, value)
    thing = add_object(name, camera, **place)
    bpy.context.scene.camera = thing
    return thing


def enable_nodes(data):
    """The node tree of a material, world or light, which up to 4.5 has to be switched on."""
    if bpy.app.version < (5, 0):
        data.use_nodes = True
    return data.node_tree


def new_material(name="Material", shader="ShaderNodeBsdfDiffuse", **inputs):
    """A material of one shader; inputs by name, blanks as underscores: Emission_Strength=2."""
    material = bpy.data.materials.new(name)
    tree = enable_nodes(material)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    node = add_node(tree, shader, **inputs)
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return material


def add_node(tree, bl_idname, **inputs):
    """A node with the given values at its inputs, a colour as three numbers."""
    node = tree.nodes.new(bl_idname)
    for key, value in inputs.items():
        socket = node.inputs[key.replace("_", " ")]
        socket.default_value = (*value, 1.0) if socket.type == "RGBA" else value
    return node


def new_world():
    """A world for the scene: its node tree and its Background node."""
    world = bpy.data.worlds.new("World")
    bpy.context.scene.world = world
    tree = enable_nodes(world)
    return tree, next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBackground")


def add_backdrop(tree, background, color=None):
    """Mix into a world what the camera sees instead of a Background node: another, returned."""
    backdrop = add_node(tree, "ShaderNodeBackground", **({"Color": color} if color else {}))
    mix, path = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeLightPath")
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(background.outputs[0], mix.inputs[1])
    tree.links.new(backdrop.outputs[0], mix.inputs[2])
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputWorld")
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return backdrop


class MaterialTree:
    """A material under construction, on a plane of its own in a new file."""

    def __init__(self, name="Test"):
        new_scene()
        self.material = bpy.data.materials.new(name)
        add_plane(material=self.material)
        self.nodes = enable_nodes(self.material)
        self.nodes.nodes.clear()
        self.output = self.add("ShaderNodeOutputMaterial")

    def add(self, bl_idname, **inputs):
        return add_node(self.nodes, bl_idname, **inputs)

    def link(self, node, to, socket=0, output=0):
        return self.nodes.links.new(node.outputs[output], to.inputs[socket])

    def surface(self, node):
        self.link(node, self.output)
        return node


def add_probe(samples=1024):
    """A white diffuse plane of 2 m and a camera that sees 1 mm of it, from 5 cm above the origin.

    Its diagonal passes beside the origin: a few of Cycles' rays slip through such edges.
    """
    scene = new_file(samples)
    add_plane(material=new_material("White", Color=(1, 1, 1)), location=(0.3, 0, 0))
    add_camera(ortho_scale=1e-3, settings={"clip_start": 1e-3}, location=(0, 0, 0.05))
    return scene


def extract():
    """The scene as LightTree gets it, though of the depsgraph of the viewport."""
    return extract_scene(bpy.context.evaluated_depsgraph_get())


def extract_in_render():
    """The scene as LightTree gets it from the depsgraph that Blender makes for a render."""
    scenes = []

    class Extractor(bpy.types.RenderEngine):
        bl_idname, bl_label = "EXTRACTOR", "Extractor"

        def render(self, depsgraph):
            scenes.append(extract_scene(depsgraph))

    bpy.utils.register_class(Extractor)
    bpy.context.scene.render.engine = Extractor.bl_idname
    bpy.ops.render.render()
    bpy.utils.unregister_class(Extractor)  # or 4.5 hangs when Python exits
    return scenes[0]


def read_material():
    """The scene's only material, ((albedo, emission) of the front, of the back), and the notes."""
    scene = extract()
    table = scene.materials
    sides = [(table.albedo[0, side].tolist(), table.emission[0, side].tolist()) for side in (0, 1)]
    return sides, scene.not_modelled


def assert_material(albedo=(0, 0, 0), emission=(0, 0, 0), notes=()):
    """Both sides of the only material look like this."""
    sides, not_modelled = read_material()
    for side in sides:
        np.testing.assert_allclose(side, (albedo, emission), rtol=1e-6)
    assert not_modelled == list(notes), not_modelled


def render(tmp_path, channels="RGB"):
    """The scene as its engine renders it: (height, width, 3) float64, first row at the bottom."""
    path = tmp_path / "render.exr"
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        image = np.stack([file.channels()[name].pixels for name in channels], axis=-1)
    return image[::-1].astype(np.float64)


def assert_probe_agrees(tmp_path):
    """Cycles shows the white plane as bright as the oracle makes it from the extracted scene."""
    expected = oracle.irradiance(extract(), (0, 0, 0), (0, 0, 1)) / math.pi
    # 65,536 paths of a smooth integrand: their noise is about 0.1 %, the quadrature's error less.
    np.testing.assert_allclose(render(tmp_path).mean(axis=(0, 1)), expected, rtol=0.005, atol=1e-6)


def radians(*degrees):
    """Angles for `rotation`."""
    return tuple(math.radians(angle) for angle in degrees)
