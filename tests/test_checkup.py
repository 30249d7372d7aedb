"""Check Scene: what the panels tell of a scene that was not rendered, and selecting what it is."""

import blender_scenes as blend
import bpy
import pytest

import lighttree_addon
from lighttree_addon import checkup

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]


@pytest.fixture
def scene():
    """Two lamps over two planes, one with a bevel, before a camera."""
    scene = blend.new_file()
    scene.render.engine = "LIGHTTREE"
    material = blend.new_material("Bevelled", Color=(0.5, 0.5, 0.5))
    nodes = material.node_tree.nodes
    diffuse = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfDiffuse")
    bevel = nodes.new("ShaderNodeBevel")
    material.node_tree.links.new(bevel.outputs[0], diffuse.inputs["Normal"])
    blend.add_plane(6, material, name="Floor")
    blend.add_plane(1, blend.new_material("Plain"), name="Table", location=(0, 0, 1))
    blend.add_lamp("POINT", location=(0, 0, 2))
    blend.add_lamp("SUN", "Sun")
    blend.add_camera(location=(0, 0, 5))
    return scene


class Layout:
    """Records what a panel draws; everything opens another layout, which is the same."""

    def __init__(self):
        self.labels, self.buttons = [], []

    def column(self, align=False):
        return self

    def box(self):
        return self

    def prop(self, data, name):
        pass

    def label(self, text, icon="NONE"):
        self.labels.append(text)

    def operator(self, name, text="", icon="NONE"):
        button = type("Button", (), {})()
        self.buttons.append((name, text, button))
        return button


def draw(panel):
    drawing = type("Drawing", (), {"layout": Layout()})()
    panel.draw(drawing, bpy.context)
    return drawing.layout


def test_before_it_is_asked_nothing_is_told(scene):
    layout = draw(bpy.types.RENDER_PT_lighttree_not_modelled)
    assert [name for name, *_ in layout.buttons] == ["lighttree.check_scene"]
    assert layout.labels == draw(bpy.types.RENDER_PT_lighttree_tree).labels == []
    assert not bpy.ops.lighttree.select_found.poll()


def test_lights_are_counted_and_findings_select_their_objects(scene):
    assert bpy.ops.lighttree.check_scene() == {"FINISHED"}
    labels = draw(bpy.types.RENDER_PT_lighttree_tree).labels
    assert sorted(labels[:2]) == ["1 point light", "1 sun light"]
    assert labels[2].startswith("Depth 1, built in ")
    layout = draw(bpy.types.RENDER_PT_lighttree_not_modelled)
    assert " ".join(layout.labels) == (
        "Normal of Diffuse BSDF comes from Bevel, which is left out."
    )
    (_, _, _), (name, text, button) = layout.buttons
    assert (name, text, button.index) == ("lighttree.select_found", "Material Bevelled", 0)
    assert bpy.ops.lighttree.select_found(index=0) == {"FINISHED"}
    assert [item.name for item in bpy.context.selected_objects] == ["Floor"]
    assert bpy.context.view_layer.objects.active.name == "Floor"
    assert bpy.ops.lighttree.select_found(index=9) == {"CANCELLED"}


def test_a_scene_that_is_modelled_as_a_whole(scene):
    bpy.data.objects.remove(bpy.data.objects["Floor"])
    bpy.ops.lighttree.check_scene()
    assert draw(bpy.types.RENDER_PT_lighttree_not_modelled).labels == [
        "All of the scene is modelled"
    ]


def test_what_is_gone_is_told(scene):
    bpy.ops.lighttree.check_scene()
    bpy.data.objects.remove(bpy.data.objects["Floor"])
    assert bpy.ops.lighttree.select_found(index=0) == {"CANCELLED"}


def test_a_scene_without_a_camera_is_refused_in_a_sentence(scene):
    bpy.data.objects.remove(scene.camera)
    with pytest.raises(RuntimeError, match=r"LightTree: .*camera"):
        bpy.ops.lighttree.check_scene()


def test_another_file_and_another_scene_have_not_been_looked_at(scene):
    bpy.ops.lighttree.check_scene()
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    assert draw(bpy.types.RENDER_PT_lighttree_tree).labels == []
    bpy.ops.wm.read_homefile(use_empty=True)
    assert checkup.last is None


def test_registering_twice_leaves_one_handler(scene):
    lighttree_addon.unregister()
    lighttree_addon.register()
    handlers = [item.__name__ for item in bpy.app.handlers.load_post]
    assert handlers.count("_forget") == 1
