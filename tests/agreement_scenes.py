"""What the scenes of `agreement_rows.py` are made of.

Most show a feature on a ball and on a sheet above a floor, under three lamps with extent, so that a
fault in any of its parts (values, densities, what is let through) changes brightness somewhere.
"""

from functools import partial

import blender_scenes as blend
import bmesh
import bpy
import numpy as np
from agreement_materials import BLUE, ORANGE, WHITE, mixed, new_image, plain, spots, textured
from blender_scenes import radians

AIMED = radians(25, 0, -20)  # from above the camera's left at the middle

# What the lamps of the stage are, their settings, where they are.
KEY = (
    "AREA",
    {"shape": "RECTANGLE", "size": 1.6, "size_y": 1.0},
    {"location": (-1.6, -1.6, 3), "rotation": radians(37, 0, -45)},
)
FILL = (
    "POINT",
    {"shadow_soft_size": 0.4, "use_soft_falloff": False, "color": (1.0, 0.6, 0.3)},
    {"location": (1.8, -1.2, 2.2)},
)
BEHIND = (
    "AREA",
    {"shape": "DISK", "size": 1.2, "color": (0.5, 0.7, 1.0)},
    {"location": (1.0, 2.4, 2.0), "rotation": radians(-55, 0, 0)},
)


# Objects


def add_mesh(name, make, material, is_smooth=False, **place):
    """An object of the mesh that make(bmesh) fills, with a UV map and the attribute Paint."""
    mesh, shape = bpy.data.meshes.new(name), bmesh.new()
    shape.loops.layers.uv.new("UVMap")
    make(shape)
    for face in shape.faces:
        face.smooth = is_smooth
    shape.to_mesh(mesh)
    shape.free()
    paint = mesh.color_attributes.new("Paint", "FLOAT_COLOR", "CORNER")
    colors = np.ones((len(mesh.loops), 4), np.float32)
    colors[:, :3] = np.random.default_rng(7).uniform(0.05, 0.95, (len(mesh.loops), 3))
    paint.data.foreach_set("color", colors.ravel())
    mesh.materials.append(material)
    return blend.add_object(name, mesh, **place)


def add_ball(material, segments=24, is_smooth=False, location=(-0.9, 0, 0.85)):
    """A closed ball of 1.6 m."""

    def make(shape):
        sizes = {"u_segments": segments, "v_segments": segments // 2}
        bmesh.ops.create_uvsphere(shape, **sizes, radius=0.8, calc_uvs=True)

    return add_mesh("Ball", make, material, is_smooth, location=location)


def add_sheet(material, thickness=0.0, **place):
    """A square of 1.7 m that leans back, or a closed pane if it is given a thickness in metres."""
    place = {"location": (0.95, 0.3, 0.95), "rotation": radians(70, 0, -20)} | place
    scale = (1.7, 1.7, thickness)

    def make(shape):
        if thickness:
            bmesh.ops.create_cube(shape, size=1.0, calc_uvs=True)
        else:
            bmesh.ops.create_grid(shape, x_segments=1, y_segments=1, size=0.85, calc_uvs=True)

    return add_mesh("Sheet", make, material, scale=scale if thickness else (1, 1, 1), **place)


def add_monkey(material, has_bevel):
    """A smooth head, its edges bevelled if asked."""

    def make(shape):
        bmesh.ops.create_monkey(shape)

    place = {"location": (0.9, 0.2, 0.9), "scale": (0.8, 0.8, 0.8), "rotation": radians(0, 0, -10)}
    head = add_mesh("Head", make, material, is_smooth=True, **place)
    if has_bevel:
        bevel = head.modifiers.new("Bevel", "BEVEL")
        bevel.width, bevel.segments = 0.02, 2


def add_lamps(*lamps):
    """Light objects, (kind, settings, place) each."""
    return [blend.add_lamp(kind, settings=settings, **place) for kind, settings, place in lamps]


def add_stage(floor=None, lamps=(KEY, FILL, BEHIND), size=12.0, **camera):
    """A floor, lamps, and a camera that looks down on the middle."""
    floor = floor or plain("Diffuse", Color=(0.6, 0.5, 0.4))
    blend.add_plane(size, floor, name="Floor")
    place = {"location": (0, -5.2, 2.9), "rotation": radians(66, 0, 0)}
    blend.add_camera(settings={"lens": 38.0} | camera, **place)
    return add_lamps(*lamps)


def show(*makes, floor=None, thickness=0.0, is_smooth=False, **stage):
    """The first material on a ball and the last on a sheet; made late, as they need the file."""
    materials = [make() for make in makes]
    add_stage(floor() if floor else None, **stage)
    add_ball(materials[0], is_smooth=is_smooth)
    add_sheet(materials[-1], thickness)


def surface(kind, distribution=None, thickness=0.0, has_sky=False, **inputs):
    """A scene that shows one shader, under a constant sky instead of lamps if asked."""

    def build():
        material = partial(plain, kind, distribution, **inputs)
        show(material, thickness=thickness, lamps=() if has_sky else (KEY, FILL, BEHIND))
        if has_sky:
            add_sky(is_image=False)

    return build


def add_glossy_out_of_sight(**settings):
    """A glossy thing and a lamp with extent, too far away to matter; settings: of the lamp."""
    add_sheet(plain("Glossy", "GGX"), location=(0, -60, 0))
    upwards = {"location": (0, -60, 2), "rotation": radians(180, 0, 0)}
    add_lamps(("AREA", {"energy": 1e-3} | settings, upwards))


def add_flags_out_of_sight():
    """The same with a lamp that casts no shadows, and a clear sheet."""
    add_glossy_out_of_sight(use_shadow=False)
    add_sheet(plain("Transparent"), location=(3, -60, 0))


def add_all_out_of_sight():
    """Things that need all that surfaces can do, too far away to matter."""
    add_glossy_out_of_sight()
    clear = textured("Principled", spots(channels=4), ("Color", "Base Color"), ("Alpha", "Alpha"))
    add_ball(clear, is_smooth=True, location=(3, -60, 0))
    add_sheet(plain("Glass", "GGX"), 0.1, location=(-3, -60, 0))


GLOSSY_FLOOR = partial(plain, "Glossy", "GGX", Color=WHITE, Roughness=0.25)
MATT = partial(plain, "Diffuse", Color=BLUE)
GLOWING = partial(plain, "Emission", Color=ORANGE, Strength=3.0)


def emitting():
    """A ball that glows dimly, and a sheet that is bright on its front and on its back."""
    dim, bright = (partial(plain, "Emission", Color=ORANGE, Strength=x) for x in (0.5, 4.0))
    show(dim, bright, lamps=())


def transparent_stack():
    """Ten clear sheets before a wall: more than rays are let through."""
    add_stage()
    wall = {"location": (0, 3, 0), "rotation": radians(90, 0, 0)}
    blend.add_plane(8, plain("Diffuse", Color=WHITE), name="Wall", **wall)
    clear = mixed(0.9, ("Diffuse", {"Color": ORANGE}), ("Transparent", {"Color": (0.95, 0.95, 1)}))
    for i in range(10):
        place = {"location": (0.3 * (i - 5), -1 + 0.25 * i, 1), "rotation": radians(90, 0, 0)}
        add_sheet(clear, **place)


def smooth(kind, distribution=None, **inputs):
    """A low-poly ball and a bevelled head, both smooth."""

    def build():
        material = plain(kind, distribution, **inputs)
        add_stage()
        add_ball(material, segments=12, is_smooth=True)
        add_monkey(material, has_bevel=kind == "Diffuse")

    return build


# Lights


def lit_by(*lamps, change=lambda lamps: None, floor=GLOSSY_FLOOR):
    """Matt things on a glossy floor, which shows the lamps and throws their light on."""

    def build():
        show(MATT, partial(plain, "Diffuse", Color=WHITE), floor=floor, lamps=())
        change(add_lamps(*lamps))

    return build


def unseen(ray, make, *lamps, names=("Ball", "Sheet"), has_sky=False):
    """A ball and a sheet of a material on a glossy floor; rays of a kind do not meet some of it."""

    def build():
        show(make, floor=GLOSSY_FLOOR, lamps=lamps)
        for name in names:
            setattr(bpy.data.objects[name], f"visible_{ray}", False)
        if has_sky:
            add_sky(is_image=False)

    return build


def lamp(kind, location=(-0.6, -1.2, 2.4), rotation=AIMED, **settings):
    """A light object for `add_lamps`."""
    return kind, settings, {"location": location, "rotation": rotation}


def set_all(**values):
    """A function that sets properties of all light objects; data__x for x of their data-blocks."""

    def change(lamps):
        for thing in lamps:
            for name, value in values.items():
                owner = thing.data if name.startswith("data__") else thing
                setattr(owner, name.removeprefix("data__"), value)

    return change


def limit_bounces(num):
    """A function that has lights shine after so many bounces at most."""

    def change(lamps):
        for thing in lamps:
            thing.data.cycles.max_bounces = num

    return change


IN_VIEW = (
    lamp("POINT", (-1.2, 1, 2.2), shadow_soft_size=0.4, use_soft_falloff=False, energy=40.0),
    lamp("POINT", (0.2, 1, 2.4), shadow_soft_size=0.4, use_soft_falloff=True, energy=40.0),
    lamp("AREA", (1.5, 1, 2.2), radians(-80, 0, 20), size=0.9, energy=40.0),
    lamp("SPOT", (0, 0.5, 1), radians(70, 0, 0), shadow_soft_size=0.3, energy=40.0),
)


def under_sky(floor=None, **settings):
    """A ball and a sheet of the floor's material under a sky; settings: see `add_sky`."""

    def build():
        show(MATT, floor or MATT, floor=floor, lamps=())
        add_sky(**settings)

    return build


def add_sky(is_image=True, turn_deg=0.0, visible=(), strength=1.0, backdrop=None):
    """A sky, blue with a bright spot if it is an image; visible: the only rays to see it.

    backdrop: a colour that the camera sees instead.
    """
    tree, background = blend.new_world()
    background.inputs["Strength"].default_value = strength
    background.inputs["Color"].default_value = (0.5, 0.7, 1.0, 1.0)
    if is_image:
        sky = np.tile(np.linspace(0.1, 0.6, 16)[:, None, None] * (0.4, 0.6, 1.0), (1, 32, 1))
        sky[11:13, 20:22] = (60, 40, 20)
        # By default Cycles takes seconds to make a map of 8 million directions.
        own = bpy.context.scene.world.cycles
        own.sampling_method, own.sample_map_resolution = "MANUAL", 256
        texture = tree.nodes.new("ShaderNodeTexEnvironment")
        texture.image = new_image(sky, is_float=True)
        tree.links.new(texture.outputs["Color"], background.inputs["Color"])
        if turn_deg:
            place, turn = (tree.nodes.new(f"ShaderNode{x}") for x in ("TexCoord", "Mapping"))
            turn.inputs["Rotation"].default_value = radians(20, 0, turn_deg)
            tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
            tree.links.new(turn.outputs["Vector"], texture.inputs["Vector"])
    if visible:
        for ray in ("camera", "diffuse", "glossy", "transmission"):
            setattr(bpy.context.scene.world.cycles_visibility, ray, ray in visible)
    if backdrop:
        blend.add_backdrop(tree, background, backdrop)


# Camera


def striped(focus=None, blades=0, ortho=False):
    """Glowing bars near and far, and one lamp: edges for what a camera does to them."""
    add_stage(lamps=(KEY,))
    camera = bpy.context.scene.camera.data
    glow = plain("Emission", Color=ORANGE, Strength=2.0)
    for i in range(7):
        place = {"location": (i - 3, 1.5 * i - 3, 0.7), "rotation": radians(90, 0, 0)}
        blend.add_plane(0.6, glow, name="Bar", scale=(0.3, 2, 1), **place)
    if ortho:
        camera.type, camera.ortho_scale = "ORTHO", 6.0
    if focus is not None:
        camera.dof.use_dof, camera.dof.focus_distance = True, focus
        camera.dof.aperture_fstop, camera.dof.aperture_blades = 0.12, blades
        if blades:
            camera.dof.aperture_rotation, camera.dof.aperture_ratio = 0.3, 1.6


def use_filter(cycles, lighttree, width):
    """A function that sets the pixel filter of both engines."""

    def adjust(scene):
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = cycles, width
        scene.lighttree.filter, scene.lighttree.filter_width_px = lighttree, width

    return adjust


def see_through_film(scene):
    scene.render.film_transparent = True


def cut_out():
    """A matt ball and a half transparent sheet, of which the camera sees the edges."""
    clear = partial(mixed, 0.5, ("Diffuse", {"Color": ORANGE}), ("Transparent", {}))
    show(MATT, clear, size=2.5)
    add_sky(is_image=False, strength=0.3)
