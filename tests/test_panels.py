"""Presets, LightTree's panels of lights, objects and view layers, and Blender's own that show."""

from pathlib import Path
from types import SimpleNamespace

import blender_scenes as blend
import bpy
import pytest

import lighttree_addon
from lighttree_addon import preset_menus
from lighttree_addon.properties import render_settings

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]

SUBDIRS = {
    "sampling": ("Draft", "Good", "Final"),
    "light_paths": ("Direct_Light_Only", "Default", "Full"),
}


@pytest.fixture
def scene():
    scene = blend.new_file()
    scene.render.engine = "LIGHTTREE"
    return scene


def presets(subdir):
    """The presets that Blender finds for a menu: name -> path."""
    folders = bpy.utils.preset_paths(f"lighttree/{subdir}")
    return {path.stem: str(path) for folder in folders for path in Path(folder).glob("*.py")}


def apply(subdir, name):
    """Choose a preset from its menu."""
    menu = f"RENDER_PT_lighttree_{subdir}_presets"
    bpy.ops.script.execute_preset(filepath=presets(subdir)[name], menu_idname=menu)


@pytest.mark.parametrize("subdir", SUBDIRS)
def test_each_preset_sets_what_a_preset_keeps_and_nothing_else(scene, subdir):
    add = getattr(preset_menus, f"RENDER_OT_lighttree_{subdir}_preset_add")
    kept = {path.removeprefix("lighttree.") for path in add.preset_values}
    assert set(presets(subdir)) == set(SUBDIRS[subdir])
    seen = set()
    for name, path in presets(subdir).items():
        lines = Path(path).read_text().splitlines()[4:]
        assert {line.split(" = ")[0] for line in lines} == {f"lighttree.{key}" for key in kept}
        for key in kept:
            scene.lighttree.property_unset(key)
        apply(subdir, name)
        render_settings(scene)  # which checks them
        seen.add(tuple(getattr(scene.lighttree, key) for key in kept))
    assert len(seen) == len(SUBDIRS[subdir])


def test_the_default_presets_are_the_defaults(scene):
    names = set(scene.lighttree.bl_rna.properties.keys()) - {"rna_type"}
    before = {name: getattr(scene.lighttree, name) for name in names}
    apply("light_paths", "Full")
    apply("sampling", "Final")
    assert scene.lighttree.max_bounces == 32 and scene.lighttree.samples == 1024
    apply("light_paths", "Default")
    apply("sampling", "Good")
    assert {name: getattr(scene.lighttree, name) for name in names} == before


def test_more_samples_with_each_preset(scene):
    samples = []
    for name in SUBDIRS["sampling"]:
        apply("sampling", name)
        samples.append(scene.lighttree.samples * scene.lighttree.split_lights)
    assert samples == sorted(set(samples))


def test_a_user_adds_a_preset_and_removes_it(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(bpy.utils, "user_resource", lambda *_, path="", **__: _made(tmp_path, path))
    scene.lighttree.samples = 7
    assert bpy.ops.render.lighttree_sampling_preset_add(name="Mine") == {"FINISHED"}
    (path,) = tmp_path.rglob("*.py")
    assert path.parts[-4:] == ("presets", "lighttree", "sampling", "Mine.py")
    scene.lighttree.samples = 9
    menu = "RENDER_PT_lighttree_sampling_presets"
    bpy.ops.script.execute_preset(filepath=str(path), menu_idname=menu)
    assert scene.lighttree.samples == 7


def _made(folder, path):
    (folder / path).mkdir(parents=True, exist_ok=True)
    return str(folder / path)


def draw(panel, **context):
    """The names of the properties that a panel shows."""
    drawn = []

    class Layout:
        def column(self, align=False, heading=""):
            return self

        def prop(self, data, name, text=""):
            assert name in data.bl_rna.properties
            drawn.append(name)

    context = SimpleNamespace(engine="LIGHTTREE", view_layer=bpy.context.view_layer, **context)
    assert panel.poll(context)
    panel.draw(SimpleNamespace(layout=Layout()), context)
    return drawn


def test_lights_show_what_cycles_shows_of_them(scene):
    rays = bpy.types.DATA_PT_lighttree_rays
    visibility = bpy.types.OBJECT_PT_lighttree_ray_visibility
    lamp = blend.add_lamp("POINT")
    assert draw(rays, light=lamp.data) == ["use_shadow"]
    assert draw(rays, light=blend.add_lamp("AREA").data) == ["spread", "use_shadow"]
    seen_by = ["visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission"]
    assert draw(visibility, object=lamp) == seen_by
    assert draw(visibility, object=blend.add_plane()) == [*seen_by, "visible_shadow"]
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    other = SimpleNamespace(engine="LIGHTTREE", object=camera, light=None)
    assert not visibility.poll(other) and not rays.poll(other)


def test_view_layers_show_the_passes_and_what_may_be_overridden(scene):
    assert draw(bpy.types.VIEWLAYER_PT_lighttree_passes) == [
        "use_pass_z",
        "use_pass_normal",
        "use_pass_diffuse_direct",
        "use_pass_diffuse_indirect",
        "use_pass_diffuse_color",
        "use_pass_emit",
        "use_pass_variance",
    ]
    override = draw(bpy.types.VIEWLAYER_PT_lighttree_override)
    assert override == ["material_override", "world_override"]


def is_shown(name):
    """Whether one of Blender's panels shows with LightTree."""
    return "LIGHTTREE" in getattr(bpy.types, name).COMPAT_ENGINES


def test_of_blenders_panels_those_show_that_work(scene):
    for name in (
        "DATA_PT_camera",
        "DATA_PT_camera_dof",
        "DATA_PT_EEVEE_light",
        "DATA_PT_lens",
        "DATA_PT_preview",
        "DATA_PT_spot",
        "EEVEE_MATERIAL_PT_surface",
        "EEVEE_WORLD_PT_surface",
        "MATERIAL_PT_preview",
        "OBJECT_PT_visibility",
        "RENDER_PT_color_management",
        "RENDER_PT_format",
        "RENDER_PT_freestyle",
        "RENDER_PT_output",
        "RENDER_PT_post_processing",
        "RENDER_PT_stamp",
        "VIEWLAYER_PT_layer",
    ):
        assert is_shown(name), name
    for name in (
        "DATA_PT_camera_stereoscopy",
        "OBJECT_PT_shading",
        "RENDER_PT_stereoscopy",
        "VIEWLAYER_PT_filter",
        "VIEWLAYER_PT_layer_passes",
    ):
        assert not is_shown(name), name
    lighttree_addon.unregister()
    assert not is_shown("RENDER_PT_format")
    lighttree_addon.register()


def test_simplify_reaches_the_render(scene, tmp_path):
    from lighttree_addon.engine import LightTreeEngine

    blend.add_lamp("POINT", location=(0, 0, 2))
    blend.add_camera(location=(0, 0, 5))
    blend.add_plane().modifiers.new("Subdivision", "SUBSURF").render_levels = 2
    scene.lighttree.samples = 1
    for is_simple, num_triangles in ((False, 32), (True, 2)):
        scene.render.use_simplify = is_simple
        scene.render.simplify_subdivision_render = 0
        blend.render(tmp_path)
        ((_, rendered),) = LightTreeEngine.rendered
        assert len(rendered.triangles) == num_triangles
