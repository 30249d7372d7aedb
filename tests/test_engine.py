"""F12: what a user of Blender gets when LightTree is the render engine."""

import threading
import time
from dataclasses import fields
from types import SimpleNamespace

import blender_scenes as blend
import bpy
import numpy as np
import OpenEXR
import pytest

from lighttree_addon import engine
from lighttree_addon.properties import render_settings
from lighttree_core import Settings
from lighttree_core.camera import FILTERS
from lighttree_core.compilation import Cancelled
from lighttree_core.light_tree.options import (
    BUCKET_KINDS,
    CONE_AXES,
    IMPORTANCES,
    SPLITS,
    TreeOptions,
)

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]

CHOICES = {
    "split": SPLITS,
    "bucket_kind": BUCKET_KINDS,
    "cone_axis": CONE_AXES,
    "importance": IMPORTANCES,
}


@pytest.fixture(autouse=True)
def no_listener():
    yield
    engine.progress_listener = None


@pytest.fixture
def scene():
    """A lamp and a glowing triangle's worth of plane over a floor, 16 x 16 px, for LightTree."""
    scene = blend.new_file()
    scene.render.engine = "LIGHTTREE"
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.lighttree.samples = 4
    blend.add_plane(6, blend.new_material("Grey", Color=(0.5, 0.4, 0.3)), name="Floor")
    glow = blend.new_material("Glow", "ShaderNodeEmission", Color=(1, 0.5, 0.2), Strength=3.0)
    blend.add_plane(1, glow, name="Sign", location=(2, 2, 1))
    blend.add_lamp("POINT", location=(0, 0, 2))
    blend.add_camera(ortho_scale=4, location=(0, 0, 5))
    return scene


def test_f12_shows_what_cycles_shows(scene, tmp_path):
    scene.lighttree.samples = 256
    ours = blend.render(tmp_path)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 256
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.lighttree.max_bounces
    theirs = blend.render(tmp_path)
    # Means of 256 px x 256 samples; their noise is far below half a percent.
    np.testing.assert_allclose(ours.mean((0, 1)), theirs.mean((0, 1)), rtol=5e-3)
    # Quarters tell apart what is mirrored or turned.
    quarters = [image.reshape(2, 8, 2, 8, 3).mean((1, 3)) for image in (ours, theirs)]
    np.testing.assert_allclose(*quarters, rtol=2e-2)


def write_passes_to(scene, path):
    """Have a render write all its passes into one file."""
    settings = scene.render.image_settings
    if bpy.app.version >= (5, 0):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(path)


def read_passes(path, layer):
    """(H, W, channels) of each pass in a multilayer file, its name as in Blender 5."""
    short = {"Emit": "Emission", "DiffDir": "Diffuse Direct", "DiffInd": "Diffuse Indirect"}
    short["DiffCol"] = "Diffuse Color"
    found = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                key, letter = name.removeprefix(f"{layer}.").rsplit(".", 1)
                found.setdefault(short.get(key, key), {})[letter] = channel.pixels
    return {
        key: np.dstack([c[k] for k in ("RGB" if "R" in c else sorted(c))])
        for key, c in found.items()
    }


def test_passes_reach_the_multilayer_file(scene, tmp_path):
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_normal = True
    write_passes_to(scene, tmp_path / "passes.exr")
    bpy.ops.render.render(write_still=True)
    passes = read_passes(scene.render.filepath, layer.name)
    assert passes["Depth"][8, 8] == pytest.approx(5, rel=1e-5)
    assert passes["Normal"][8, 8, 2] == pytest.approx(1, rel=1e-5)
    assert passes["Albedo"][8, 8] == pytest.approx((0.5, 0.4, 0.3), rel=1e-5)
    assert passes["Combined"].mean() > 0


def test_light_passes_are_those_of_cycles(scene, tmp_path):
    layer = bpy.context.view_layer
    wet = blend.new_material("Wet", "ShaderNodeBsdfPrincipled", Roughness=0.3)
    blend.add_plane(2, wet, name="Puddle", location=(-1, -1, 0.1))
    wall = blend.add_plane(6, blend.new_material("Wall", Color=(0.9, 0.9, 0.9)), name="Wall")
    wall.location, wall.rotation_euler = (-1.8, 0, 0), (0, 1.4, 0)
    names = ("emit", "diffuse_direct", "diffuse_indirect", "diffuse_color")
    for name in names:
        setattr(layer, f"use_pass_{name}", True)
    layer.lighttree.use_pass_variance = True
    scene.lighttree.samples = scene.cycles.samples = 512
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.lighttree.max_bounces
    scene.cycles.glossy_bounces = scene.lighttree.max_bounces
    images = []
    for engine_id in ("LIGHTTREE", "CYCLES"):
        scene.render.engine = engine_id
        write_passes_to(scene, tmp_path / f"{engine_id}.exr")
        bpy.ops.render.render(write_still=True)
        images.append(read_passes(scene.render.filepath, layer.name))
    ours, theirs = images
    assert np.isfinite(ours["Variance"]).all() and ours["Variance"].max() > 0
    for name in ("Emission", "Diffuse Direct", "Diffuse Indirect", "Diffuse Color"):
        halves = [image[name].reshape(2, 8, 16, 3).mean((1, 2)) for image in images]
        assert theirs[name].any()
        np.testing.assert_allclose(*halves, rtol=3e-2, atol=1e-4, err_msg=name)


def test_a_border_renders_its_part_alone(scene, tmp_path):
    whole = blend.render(tmp_path)
    render = scene.render
    render.use_border, render.use_crop_to_border = True, True
    render.border_min_x, render.border_max_x = 0.25, 0.75
    render.border_min_y, render.border_max_y = 0.5, 1.0
    np.testing.assert_array_equal(blend.render(tmp_path), whole[8:, 4:12])


def test_every_view_layer_is_rendered_with_its_own_lights(scene, tmp_path):
    dark = scene.view_layers.new("Dark")
    lamps = bpy.data.collections.new("Lamps")
    scene.collection.children.link(lamps)
    for name in ("Lamp", "Sign"):
        thing = bpy.data.objects[name]
        scene.collection.objects.unlink(thing)
        lamps.objects.link(thing)
    dark.layer_collection.children["Lamps"].exclude = True
    write_passes_to(scene, tmp_path / "layers.exr")
    bpy.ops.render.render(write_still=True)
    images = [read_passes(scene.render.filepath, layer.name) for layer in scene.view_layers]
    assert images[0]["Combined"].max() > 0 and images[1]["Combined"].max() == 0


def test_an_animation_is_rendered_frame_by_frame(scene, tmp_path):
    lamp = bpy.data.lights["Lamp"]
    for frame, energy in ((1, 10), (2, 100)):
        lamp.energy = energy
        lamp.keyframe_insert("energy", frame=frame)
    bpy.data.objects["Sign"].hide_render = True
    scene.frame_start, scene.frame_end = 1, 2
    write_passes_to(scene, tmp_path / "####.exr")
    bpy.ops.render.render(animation=True)
    name = bpy.context.view_layer.name
    first, second = (read_passes(tmp_path / f"000{i}.exr", name)["Combined"] for i in (1, 2))
    np.testing.assert_allclose(second, 10 * first, rtol=1e-4)


def test_blenders_denoiser_takes_the_passes(scene, tmp_path):
    """Less noise in an image denoised with Albedo and Normal, by the compositor."""
    bpy.context.view_layer.use_pass_normal = True
    scene.render.resolution_x = scene.render.resolution_y = 64
    for i in range(40):
        blend.add_lamp("POINT", location=(i % 7 - 3, i % 5 - 2, 0.5 + i % 3))
    scene.lighttree.samples = 512
    reference = blend.render(tmp_path)
    scene.lighttree.samples, scene.lighttree.split_lights = 1, 1
    scene.lighttree.sampler = "uniform"
    noisy = blend.render(tmp_path)
    if bpy.app.version >= (5, 0):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("C", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        output = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("CompositorNodeComposite")
    layers, denoise = (tree.nodes.new(f"CompositorNode{name}") for name in ("RLayers", "Denoise"))
    for name in ("Image", "Albedo", "Normal"):
        tree.links.new(layers.outputs[name], denoise.inputs[name])
    tree.links.new(denoise.outputs["Image"], output.inputs["Image"])
    denoised = blend.render(tmp_path)
    errors = [np.square(image - reference).mean() for image in (noisy, denoised)]
    assert 0 < errors[1] < errors[0] / 2


def test_progress_reaches_a_listener(scene, tmp_path):
    told = []
    engine.progress_listener = lambda share, message: told.append(share)
    blend.render(tmp_path)
    assert told[0] == 0 and told[-1] == 1
    ((film, _),) = engine.LightTreeEngine.rendered
    assert film.num_samples == 4


def test_a_lamp_that_is_not_finite_is_an_error_with_its_name(scene, tmp_path):
    bpy.data.lights["Lamp"].energy = float("inf")
    with pytest.raises(RuntimeError, match="Lamp"):
        blend.render(tmp_path)
    assert not (tmp_path / "render.exr").exists()
    bpy.data.lights["Lamp"].energy = 10
    assert blend.render(tmp_path).mean() > 0


def test_strict_refuses_what_is_not_modelled(scene, tmp_path):
    scene.render.use_motion_blur = True
    assert blend.render(tmp_path).mean() > 0
    scene.lighttree.strict = True
    with pytest.raises(RuntimeError, match="motion blur"):
        blend.render(tmp_path)


def test_escape_ends_compiling_and_the_wait_for_it(monkeypatch):
    ended = threading.Event()

    def compile_until_cancelled(self, scene, settings, progress, tracer=None, cancel=None):
        progress(0.5, "Compiling kernels")
        while not cancel():
            time.sleep(0.01)
        ended.set()
        raise Cancelled

    monkeypatch.setattr(engine, "Renderer", type("R", (), {"__init__": compile_until_cancelled}))
    asked, told = iter([False] * 3), []
    blender = SimpleNamespace(
        test_break=lambda: next(asked, True), _progress=lambda *progress: told.append(progress)
    )
    start = time.monotonic()
    assert engine.LightTreeEngine._prepare(blender, None, None) is None
    assert ended.wait(1) and time.monotonic() - start < 2
    assert told == [(0.5, "Compiling kernels")]


def test_a_fault_inside_is_an_error_without_a_traceback_for_the_user(scene, tmp_path, monkeypatch):
    def fail(depsgraph):
        raise ZeroDivisionError("boom")

    monkeypatch.setattr(engine, "extract_scene", fail)
    with pytest.raises(RuntimeError, match="LightTree failed: boom"):
        blend.render(tmp_path)


def test_a_missing_library_leaves_the_rest_to_be_rendered(scene, tmp_path):
    library, file = tmp_path / "library.blend", tmp_path / "scene.blend"
    sign = bpy.data.objects["Sign"]
    bpy.data.libraries.write(str(library), {sign})
    bpy.data.objects.remove(sign)
    with bpy.data.libraries.load(str(library), link=True) as (_, linked):
        linked.objects = ["Sign"]
    scene.collection.objects.link(linked.objects[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    with_sign = blend.render(tmp_path)
    library.unlink()
    bpy.ops.wm.open_mainfile(filepath=str(file))
    assert bpy.data.objects["Sign"].is_missing
    without = blend.render(tmp_path)
    assert 0 < without.mean() < with_sign.mean()


def test_a_black_image_is_told(scene, tmp_path, capfd):
    for name in ("Lamp", "Sign"):
        bpy.data.objects[name].hide_render = True
    assert blend.render(tmp_path).max() == 0
    output = capfd.readouterr()
    assert "The image is black" in output.out + output.err


def test_the_properties_of_the_tree_are_its_options(scene):
    for field in fields(TreeOptions):
        prop = scene.lighttree.bl_rna.properties[f"tree_{field.name}"]
        assert getattr(scene.lighttree, prop.identifier) == field.default
        if field.name in CHOICES:
            assert set(prop.enum_items.keys()) == set(CHOICES[field.name])
        elif field.name != "thin_box":
            for value in (prop.hard_min, prop.hard_max):
                TreeOptions(**{field.name: value}).check()
            for value in (prop.hard_min - 1, prop.hard_max + 1):
                with pytest.raises(ValueError, match=field.name):
                    TreeOptions(**{field.name: value}).check()


def test_every_option_of_the_tree_reaches_the_renderer(scene):
    options = TreeOptions("equal", False, 7, "count", "union", 3, "clamped", 0.5)
    for field in fields(TreeOptions):
        value = getattr(options, field.name)
        assert value != field.default
        setattr(scene.lighttree, f"tree_{field.name}", value)
    assert render_settings(scene).tree == options


def test_another_tree_gives_other_noise(scene, tmp_path):
    for i in range(40):
        blend.add_lamp("POINT", location=(i % 7 - 3, i % 5 - 2, 1 + i % 3))
    images = []
    for values in ({}, {}, {"tree_split": "equal", "tree_width": 2}):
        for name, value in values.items():
            setattr(scene.lighttree, name, value)
        images.append(blend.render(tmp_path))
    assert np.array_equal(images[0], images[1]) and not np.array_equal(images[1], images[2])


def test_a_tree_that_makes_no_sense_is_refused(scene, tmp_path):
    scene.lighttree.tree_buckets = 1
    with pytest.raises(RuntimeError, match="LightTree: buckets must be 0 for all cuts"):
        blend.render(tmp_path)


def draw(panel):
    """The names of the settings that a panel shows."""
    drawn = []

    class Layout:
        def column(self, align=False, heading=""):
            return self

        def row(self, align=False):
            return self

        def prop(self, data, name, text="", icon="NONE"):
            assert name in data.bl_rna.properties
            drawn.append(name)

        def operator(self, name, icon):
            pass

    class Drawing:
        layout = Layout()

    panel.draw(Drawing(), bpy.context)
    return drawn


def test_the_filter_of_blenders_images_is_that_of_cycles_by_default(scene):
    scene.lighttree.property_unset("filter")
    settings = render_settings(scene)
    assert settings.filter == "blackman-harris" and Settings().filter == "box"
    default = scene.cycles.bl_rna.properties["filter_width"].default
    assert settings.filter_width_px == Settings().filter_width_px == default
    assert set(scene.lighttree.bl_rna.properties["filter"].enum_items.keys()) == set(FILTERS)
    scene.lighttree.filter, scene.lighttree.filter_width_px = "gaussian", 0.0  # as little as goes
    settings = render_settings(scene)
    assert settings.filter == "gaussian"
    assert settings.filter_width_px == pytest.approx(0.01)


def test_the_panels_draw_every_setting_once(scene):
    sampling = bpy.types.RENDER_PT_lighttree_sampling
    tree = bpy.types.RENDER_PT_lighttree_tree
    film = bpy.types.RENDER_PT_lighttree_film
    assert tree.bl_parent_id == sampling.__name__ and tree.bl_options == {"DEFAULT_CLOSED"}
    assert sampling.poll(bpy.context) and tree.poll(bpy.context)
    names = set(scene.lighttree.bl_rna.properties.keys()) - {"rna_type", "name"}
    of_tree = {name for name in names if name.startswith("tree_")}
    assert sorted(draw(tree)) == sorted(of_tree)
    scene.lighttree.filter = "gaussian"
    of_film = {name for name in names if name.startswith("filter")}
    assert sorted(draw(film)) == sorted(of_film | {"film_transparent"})
    of_paths = draw(bpy.types.RENDER_PT_lighttree_light_paths)
    assert of_paths == ["max_bounces", "max_passes"]
    assert draw(bpy.types.RENDER_PT_lighttree_not_modelled) == ["strict"]
    others = of_tree | of_film | {*of_paths, "strict"}
    assert sorted(draw(sampling)) == sorted(names - others)
    scene.lighttree.filter = "box"  # which has no width
    assert sorted(draw(film)) == ["film_transparent", "filter"]
    assert draw(bpy.types.RENDER_PT_lighttree_performance) == ["threads_mode", "threads"]
    simplified = draw(bpy.types.RENDER_PT_lighttree_simplify)
    assert simplified == ["simplify_subdivision_render", "simplify_child_particles_render"]


def test_each_frame_may_have_a_seed_of_its_own(scene):
    scene.lighttree.seed = 5
    scene.frame_set(7)
    assert render_settings(scene).seed == 5
    scene.lighttree.use_animated_seed = True
    seeds = []
    for frame in (-9, 7, 8):
        scene.frame_set(frame)
        seeds.append(render_settings(scene).seed)  # which checks it
    assert seeds[1:] == [12, 13] and len(set(seeds)) == 3
