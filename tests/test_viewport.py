"""Rendered shading: pictures that get finer, and edits that build anew only what they change."""

import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import blender_scenes as blend
import bpy
import numpy as np
import pytest
from mathutils import Matrix

from lighttree_addon.camera import extract_camera, view_camera
from lighttree_addon.extract import extract_scene
from lighttree_addon.properties import render_settings
from lighttree_addon.viewport import Viewport
from lighttree_core import render

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("registered")]

WIDTH, HEIGHT = 20, 12


@pytest.fixture
def scene():
    """A lamp over a floor and a box of it, seen from above."""
    scene = blend.new_file()
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.lighttree.viewport_samples = 3
    blend.add_plane(6, blend.new_material("Grey", Color=(0.5, 0.4, 0.3)), name="Floor")
    blue = blend.new_material("Blue", Color=(0.1, 0.4, 0.8))
    blend.add_plane(1, blue, name="Table", location=(1, 0, 1))
    blend.add_lamp("POINT", location=(0, 0, 2))
    blend.add_camera(ortho_scale=6, location=(0, 0, 5))
    return scene


@pytest.fixture
def view(scene):
    """A viewport that hears of edits as Blender tells of them."""
    view, seen_by = Viewport(), camera()
    view.update(bpy.context.evaluated_depsgraph_get(), seen_by)
    handlers = bpy.app.handlers.depsgraph_update_post
    handlers.append(lambda scene, depsgraph: view.update(depsgraph, seen_by))
    yield view
    handlers.clear()
    view.close()
    view._thread.join()


def camera():
    return extract_camera(bpy.context.evaluated_depsgraph_get())


def finish(view):
    """The picture after the last sample."""
    end = time.monotonic() + 120
    while view.message != "Sample 3" or view.picture.shape[:2] != (HEIGHT, WIDTH):
        assert time.monotonic() < end, view.message
        time.sleep(0.01)
    return view.picture


def edit(view, change):
    """What is seen after a change."""
    finish(view)
    view.message = ""
    change()
    bpy.context.view_layer.update()
    return finish(view)


def test_the_last_picture_is_what_a_render_gives(view, scene):
    settings = replace(render_settings(scene), samples=3)
    film = render(extract_scene(bpy.context.evaluated_depsgraph_get()), settings)
    np.testing.assert_array_equal(finish(view), np.dstack([film.mean, film.alpha]))


def test_pictures_get_finer(view, monkeypatch):
    shapes, show = [], view._show
    monkeypatch.setattr(
        view, "_show", lambda film: (shapes.append(film.mean.shape[:2]), show(film))
    )
    edit(view, lambda: setattr(bpy.data.lights["Lamp"], "energy", 20))
    assert list(dict.fromkeys(shapes)) == [(2, 3), (3, 5), (6, 10), (HEIGHT, WIDTH)]


def test_no_more_pixels_than_the_pixel_size_asks_for(view, scene):
    scene.render.preview_pixel_size = "4"
    finish(view)
    bpy.data.lights["Lamp"].energy = 20
    bpy.context.view_layer.update()
    end = time.monotonic() + 20
    while view.picture.shape[:2] != (3, 5) or view.message != "Sample 3":
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_moved_lamp_leaves_meshes_and_embree_alone(view):
    first, known, tracer = finish(view), view._scene, view._renderer.tracer
    moved = edit(view, lambda: setattr(bpy.data.objects["Lamp"], "location", (1, 1, 1)))
    assert view._scene.vertices is known.vertices and view._renderer.tracer is tracer
    assert not np.array_equal(first, moved)


def test_a_material_leaves_embree_alone(view):
    first, tracer = finish(view), view._renderer.tracer
    nodes = bpy.data.materials["Grey"].node_tree.nodes
    color = next(n for n in nodes if n.bl_idname == "ShaderNodeBsdfDiffuse").inputs["Color"]
    painted = edit(view, lambda: setattr(color, "default_value", (1, 0, 0, 1)))
    assert view._renderer.tracer is tracer
    assert painted[..., 0].sum() > 1.5 * first[..., 0].sum() and painted[0, 0, 1] == 0


@pytest.mark.parametrize(
    "change",
    [
        lambda: setattr(bpy.data.objects["Table"], "location", (-1, 0, 1)),
        lambda: setattr(bpy.data.meshes["Table"].vertices[0], "co", (-1, -1, 3)),
        lambda: bpy.data.objects["Table"].hide_set(True),
        lambda: bpy.data.objects.remove(bpy.data.objects["Table"]),
    ],
    ids=["moved", "edited", "hidden", "deleted"],
)
def test_a_mesh_is_read_again(view, change):
    first, tracer = finish(view), view._renderer.tracer

    def change_and_tell():
        change()
        for mesh in bpy.data.meshes:
            mesh.update()

    assert not np.array_equal(first, edit(view, change_and_tell))
    assert view._renderer.tracer is not tracer


def test_what_becomes_indirect_only_is_not_seen_any_more(view, scene):
    collection, table = bpy.data.collections.new("Reflected"), bpy.data.objects["Table"]

    def move():
        scene.collection.children.link(collection)
        scene.collection.objects.unlink(table)
        collection.objects.link(table)

    first = edit(view, move)
    layer = bpy.context.view_layer.layer_collection.children["Reflected"]
    assert not np.array_equal(first, edit(view, lambda: setattr(layer, "indirect_only", True)))


def test_a_selection_does_not_start_anew(view):
    finish(view)
    job = view._job
    bpy.data.objects["Table"].select_set(True)
    bpy.context.view_layer.update()
    assert view._job is job


def test_another_camera_reads_nothing(view):
    first, known = finish(view), view._scene
    view.message = ""
    view.look(replace(view._job.camera, shift_x=1.0))
    assert not np.array_equal(first, finish(view)) and view._scene is known
    job = view._job
    view.look(replace(view._job.camera))
    assert view._job is job


def test_a_view_that_turns_without_end_shows_pictures(view):
    finish(view)
    pictures, end = set(), time.monotonic() + 1
    for i in range(10**6):
        view.look(replace(view._job.camera, shift_x=i * 1e-3))
        pictures.add(id(view.picture))
        time.sleep(0.002)
        if time.monotonic() > end:
            break
    assert len(pictures) > 5


def test_what_cannot_be_rendered_is_told_until_it_is_mended(view):
    finish(view)
    lamp = bpy.data.lights["Lamp"]
    lamp.energy = float("inf")
    bpy.context.view_layer.update()
    end = time.monotonic() + 20
    while "Lamp" not in view.message:
        assert time.monotonic() < end, view.message
        time.sleep(0.01)
    lamp.energy = 10
    bpy.context.view_layer.update()
    assert finish(view).any()


def test_a_hundred_edits_leave_nothing_behind(view):
    finish(view)
    num_threads = threading.active_count()
    for i in range(100):
        bpy.data.objects["Lamp"].location.x = 0.01 * i
        bpy.context.view_layer.update()
    assert finish(view).any() and len(Viewport.open_ones) == 1
    assert threading.active_count() <= num_threads + 1  # a pool may be about to end


def test_closing_ends_the_thread(view):
    finish(view)
    view.close()
    view._thread.join(timeout=20)
    assert not view._thread.is_alive() and not Viewport.open_ones


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_a_view_through_the_camera_is_the_camera(scene, kind):
    data = scene.camera.data
    data.type, data.shift_x, data.shift_y, data.lens = kind, 0.1, -0.2, 35
    data.dof.use_dof, data.dof.aperture_blades = True, 5
    scene.camera.matrix_world = Matrix.Rotation(0.3, 4, (1, 2, 3)) @ Matrix.Translation((1, 2, 3))
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    matrix = scene.camera.calc_matrix_camera(depsgraph, x=WIDTH, y=HEIGHT)
    view = SimpleNamespace(
        window_matrix=matrix,
        view_matrix=scene.camera.matrix_world.inverted(),
        is_perspective=kind == "PERSP",
        view_perspective="CAMERA",
    )
    found = view_camera(SimpleNamespace(width=WIDTH, height=HEIGHT), view, depsgraph)
    wanted = camera()
    for name, value in vars(wanted).items():
        np.testing.assert_allclose(getattr(found, name), value, 1e-3, 1e-6, err_msg=name)
