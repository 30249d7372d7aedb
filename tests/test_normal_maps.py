"""Normal maps and bump maps, also as in Cycles."""

import math

import numpy as np
import pytest
from core_scenes import fewer, needs_float32
from test_surface import (
    DOWN,
    SQUARE,
    SQUARE_UVS,
    TILTED,
    UP,
    floats,
    random_barycentric,
    scene_of,
    unit,
    weights,
    world_of,
)
from test_textures import reference, textures_of

from lighttree_core import Settings
from lighttree_core.normal_maps import bumped_normal, mapped_normal
from lighttree_core.scene import (
    CLIP,
    COLOR_ATTRIBUTE,
    FACING,
    GREEN,
    LINEAR,
    LUMINANCE_OF_RGB,
    MIRROR,
    RED,
    REPEAT,
    RGB,
)
from lighttree_core.surface import load_surface
from lighttree_core.vec import LUMINANCE
from lighttree_core.world import build_world

NUM = fewer(200, 20)


def mapped(world, triangle, barycentric, direction, strength=1.0):
    """(mapped normal, n_geo, n_shade) of a hit."""
    b = floats(barycentric)
    _, _, n_geo, n_shade, side = load_surface(world.geometry, triangle, *b, floats(direction))
    n_geo, n_shade = floats(n_geo), floats(n_shade)
    wo = floats(np.negative(direction))
    n = mapped_normal(
        world.geometry,
        world.textures,
        0,
        np.float32(strength),
        triangle,
        *b,
        wo,
        n_geo,
        n_shade,
        side,
    )
    return np.array(n, np.float64), np.array(n_geo), np.array(n_shade)


@pytest.mark.parametrize("direction", [DOWN, UP])
@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0, 3.0])
def test_a_flat_normal_map_changes_nothing(direction, strength):
    rng = np.random.default_rng(7)
    corners, normals = rng.normal(size=(1, 3, 3)), unit([(0.3, 0, 1), (0, 0.2, 1), (-0.2, 0.1, 1)])
    for world in (
        world_of(corners, [normals], rng.uniform(0, 1, (3, 2)), color=(0.5, 0.5, 1)),
        world_of(corners, None, rng.uniform(0, 1, (3, 2)), color=(0.5, 0.5, 1)),
    ):
        n, _, n_shade = mapped(world, 0, (0.3, 0.4), direction, strength)
        np.testing.assert_allclose(n, n_shade, atol=1e-6)


@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0, 2.0])
def test_normals_lean_along_the_uv_map(strength):
    z = 1 + min(strength, 1) * (0.4 - 1)
    leaning = unit((strength * 0.6, strength * -0.2, z))
    for u_axis, v_axis in (
        ((1, 0), (0, 1)),
        ((0, 2), (-2, 0)),  # turned and smaller: u grows along y
        ((-1, 0), (0, 1)),  # mirrored
        ((0.5, 0), (0, 3)),  # stretched
    ):
        uvs = np.array(SQUARE)[..., :2] @ np.array([u_axis, v_axis]).T
        world = world_of(SQUARE, None, uvs)
        # Where u and v grow on the square, at right angles.
        u, v = (np.array([*np.sign(a), 0]) for a in (u_axis, v_axis))
        expected = leaning[0] * u + leaning[1] * v + leaning[2] * np.array(UP)
        n, _, _ = mapped(world, 0, (0.3, 0.4), DOWN, strength)
        np.testing.assert_allclose(n, expected, atol=1e-6)
        # From behind, the same bumps are dents.
        n, _, _ = mapped(world, 0, (0.3, 0.4), UP, strength)
        np.testing.assert_allclose(n, -expected, atol=1e-6)


@pytest.mark.parametrize("direction", [DOWN, UP])
def test_smooth_normal_maps_match_the_formula(direction):
    rng = np.random.default_rng(7)
    for _ in range(NUM):
        corners = rng.normal(size=(3, 3)) * (1, 1, 0.2)
        plane = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normals = unit(np.sign(plane[2]) * np.array(UP) + 0.3 * rng.normal(size=(3, 3)))
        uvs, b = rng.normal(size=(3, 2)), random_barycentric(rng)
        world = world_of([corners], [normals], uvs)
        n, n_geo, _ = mapped(world, 0, b, direction, 0.7)
        # Derivatives of the position by u and v; tangents at the corners, then between them.
        along_u, along_v = np.linalg.solve(uvs[1:] - uvs[0], corners[1:] - corners[0])
        tangents = unit(along_u - normals * (normals @ along_u)[:, None])
        tangent, normal = weights(b) @ tangents, weights(b) @ normals
        across = np.cross(normal, tangent) * np.sign(np.cross(along_u, along_v) @ plane)
        side = 1 if n_geo @ plane > 0 else -1
        expected = 0.7 * 0.6 * tangent + 0.7 * -0.2 * across + (1 - 0.7 * 0.6) * normal
        np.testing.assert_allclose(n, side * unit(expected), atol=2e-5)


def test_without_a_tangent_the_normal_stays():
    normals = [unit([(0.3, 0, 1), (0, 0.2, 1), (-0.2, 0.1, 1)])]
    for uvs in (None, [(0, 0), (1, 1), (2, 2)], [(0.5, 0.5)] * 3):
        n, _, n_shade = mapped(world_of(SQUARE, normals, uvs), 0, (0.3, 0.4), DOWN)
        np.testing.assert_array_equal(n, n_shade)
    # Nor does a map help that points nowhere.
    n, _, n_shade = mapped(
        world_of(SQUARE, normals, SQUARE_UVS, color=(0.5, 0.5, 0.5)), 0, (0.3, 0.4), DOWN
    )
    np.testing.assert_array_equal(n, n_shade)


@needs_float32
def test_vectors_are_unit_and_of_float32():
    rng = np.random.default_rng(7)
    world = world_of(1e5 + rng.normal(size=(1, 3, 3)), unit(rng.normal(size=(1, 3, 3))), SQUARE_UVS)
    for direction in unit(rng.normal(size=(8, 3))):
        n, n_geo, n_shade = mapped(world, 0, (0.3, 0.4), direction)
        for a in (n, n_geo, n_shade):
            assert math.isclose(np.linalg.norm(a), 1, rel_tol=1e-6)
            np.testing.assert_array_equal(a, a.astype(np.float32))


def bumped(world, triangle, barycentric, direction, strength=1.0):
    """(bumped normal, n_shade) of a hit; the first texture is the height."""
    b = floats(barycentric)
    n_shade = floats(load_surface(world.geometry, triangle, *b, floats(direction))[3])
    n = bumped_normal(
        world.geometry, world.textures, 0, np.float32(strength), triangle, *b, n_shade
    )
    return np.array(n, np.float64), np.array(n_shade, np.float64)


def raised_normal(corners, heights, n):
    """The normal of a triangle whose corners are raised along n, on the side of n."""
    raised = np.asarray(corners) + np.outer(heights, n)
    return unit(np.cross(raised[1] - raised[0], raised[2] - raised[0])) * math.copysign(
        1, np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ n
    )


@pytest.mark.parametrize("output", [RGB, GREEN, LUMINANCE_OF_RGB])
@pytest.mark.parametrize("direction", [DOWN, UP])
def test_heights_of_corners_raise_them_towards_the_viewer(direction, output):
    rng = np.random.default_rng(7)
    for size in 10.0 ** rng.uniform(-3, 3, NUM):
        corners = size * rng.normal(size=(3, 3)) * (1, 1, 0.2)
        scene = scene_of([corners])
        scene.textures.kind[0], scene.textures.output[0] = COLOR_ATTRIBUTE, output
        scene.textures.scale[0] = size
        scene.colors = rng.uniform(0, 1, (1, 1, 3, 3)).astype(np.float32)
        n, n_shade = bumped(build_world(scene, Settings()), 0, (0.2, 0.3), direction)
        rgb = scene.colors[0, 0]
        heights = {RGB: rgb[:, 0], GREEN: rgb[:, 1], LUMINANCE_OF_RGB: rgb @ LUMINANCE}[output]
        assert n_shade @ direction < 0
        np.testing.assert_allclose(n, raised_normal(corners, size * heights, n_shade), atol=2e-4)


def bumpy_scene(rng, extension, normals=None):
    """A triangle of about a metre whose height is an image of a few texels, up to 0.2 m."""
    corners, uvs = rng.normal(size=(3, 3)) * (1, 1, 0.2), rng.normal(size=(3, 2))
    image = rng.uniform(0, 0.2, (5, 7, 4)).astype(np.float32)
    scene = scene_of([corners], normals, uvs)
    scene.textures = textures_of(image, extension=extension, output=RED)
    scene.textures.image_from_uv[0] = [[0.5, 0.1, 0.3], [-0.2, 0.4, 0.1]]
    return scene, corners, image


def image_heights(scene, image, points, extension):
    """Heights at (n, 2) points of the UV map."""
    m = scene.textures.image_from_uv[0].astype(np.float64)
    return reference(image, points @ m[:, :2].T + m[:, 2], extension, LINEAR)[:, 0]


@pytest.mark.parametrize("extension", [REPEAT, MIRROR, CLIP])
def test_images_raise_the_plane_as_they_do_between_their_texels(extension):
    rng = np.random.default_rng(7)
    for _ in range(NUM):
        scene, corners, image = bumpy_scene(rng, extension)
        b = random_barycentric(rng)
        n, n_shade = bumped(build_world(scene, Settings()), 0, b, DOWN)
        uvs = scene.uvs[0, 0].astype(np.float64)
        m = scene.textures.image_from_uv[0, :, :2].astype(np.float64)
        here, slopes = weights(b) @ uvs, []
        for axis, num_texels in ((0, 7), (1, 5)):
            step = np.linalg.solve(m, 1e-6 / num_texels * np.eye(2)[axis])
            low, high = image_heights(scene, image, np.array([here - step, here + step]), extension)
            slopes.append((high - low) / 2e-6 * num_texels)
        heights = (uvs @ m.T) @ slopes
        np.testing.assert_allclose(n, raised_normal(corners, heights, n_shade), atol=1e-3)


def test_strength_leads_from_the_normal_to_the_bump_and_beyond():
    rng = np.random.default_rng(7)
    normals = unit([(0.3, 0, 1), (0, 0.2, 1), (-0.2, 0.1, 1)])
    scene, _, _ = bumpy_scene(rng, REPEAT, [normals])
    world = build_world(scene, Settings())
    whole, n_shade = bumped(world, 0, (0.3, 0.4), DOWN)
    assert whole @ n_shade < 0.999
    for strength in (0.0, 0.3, 1.0, 1.5):
        n, _ = bumped(world, 0, (0.3, 0.4), DOWN, strength)
        np.testing.assert_allclose(n, unit(strength * whole + (1 - strength) * n_shade), atol=1e-6)


def test_even_heights_and_slivers_leave_the_normal():
    scene = scene_of(SQUARE, None, SQUARE_UVS)
    assert_normal_stays(scene)
    scene.textures = textures_of(np.random.default_rng(7).random((4, 4, 4)).astype(np.float32))
    scene.textures.kind[0] = FACING
    assert_normal_stays(scene)
    scene = scene_of([[(0, 0, 0), (1, 0, 0), (2, 0, 0)]], [[UP] * 3], SQUARE_UVS)
    assert_normal_stays(scene)


def assert_normal_stays(scene):
    n, n_shade = bumped(build_world(scene, Settings()), 0, (0.3, 0.4), DOWN)
    np.testing.assert_array_equal(n, n_shade)


@pytest.mark.blender
@pytest.mark.parametrize("smooth, tolerance", [(False, 1e-4), (True, 0.01)])
@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_normal_maps_equal_cycles(smooth, tolerance, scale, tmp_path):
    import blender_scenes as blend
    import bpy

    scene = blend.new_file(samples=16)
    num = 16
    scene.render.resolution_x = scene.render.resolution_y = num
    material = blend.new_material("Bumpy", Color=(1, 1, 1))
    # Without what Cycles does against shadows that end hard on bumps.
    material.cycles.use_bump_map_correction = False
    nodes = material.node_tree.nodes
    node = blend.add_node(material.node_tree, "ShaderNodeNormalMap", Color=TILTED, Strength=0.8)
    diffuse = next(n for n in nodes if n.type == "BSDF_DIFFUSE")
    material.node_tree.links.new(node.outputs["Normal"], diffuse.inputs["Normal"])
    mesh = hill_mesh(bpy, smooth, material, num_squares=12 if smooth else 4)
    thing = blend.add_object("Hill", mesh, rotation=(0, 0, 0.4), scale=(1, scale, 1))
    blend.add_lamp("SUN", settings={"energy": math.pi, "angle": 0.0}, rotation=(0.2, 0.3, 0))
    blend.add_camera(ortho_scale=1.0, location=(0, 0, 5))
    bpy.context.view_layer.update()
    to_sun = np.array(bpy.data.objects["Lamp"].matrix_world.col[2][:3])
    found = blend.render(tmp_path)[..., 0]

    world = mesh_world(mesh, np.array(thing.matrix_world)[:3], smooth)
    # A flat hill has edges, which pixels blur: compare where all points of a pixel are on one face.
    offsets = np.linspace(0.01, 0.99, 4)
    points = (np.arange(num)[:, None] + offsets).reshape(-1) / num - 0.5
    expected = [[shade_from_above(world, x, y, to_sun) for x in points] for y in points]
    blocks = np.array(expected).reshape(num, 4, num, 4).swapaxes(1, 2).reshape(num, num, 16)
    is_plain = np.ptp(blocks, axis=2) < (1.0 if smooth else 1e-6)
    assert is_plain.mean() > 0.2
    difference = abs(found - blocks.mean(axis=2))[is_plain]
    assert difference.max() < tolerance


def hill_mesh(bpy, smooth, material, num_squares):
    """Squares over (-1, 1)^2 on a hill, their UV map sheared."""
    mesh = bpy.data.meshes.new("Hill")
    num = num_squares
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-1, 1, num + 1)] * 2))
    z = 0.5 * np.cos(1.5 * x) * np.cos(1.2 * y) + 0.1 * x
    first = np.arange((num + 1) * num).reshape(num, num + 1)[:, :-1].ravel()
    faces = first[:, None] + (0, 1, num + 2, num + 1)
    mesh.from_pydata(np.column_stack([x, y, z]).tolist(), [], faces.tolist())
    uvs = np.column_stack([x + 0.3 * y, y])[faces.ravel()]
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uvs.astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(faces))
    mesh.materials.append(material)
    mesh.update()
    return mesh


def mesh_world(mesh, world_from_local, smooth):
    """The triangles of a Blender mesh with the normal map of these tests."""
    linear, offset = world_from_local[:, :3], world_from_local[:, 3]
    mesh.calc_loop_triangles()
    loops = np.array([triangle.loops for triangle in mesh.loop_triangles])
    if np.linalg.det(linear) < 0:
        loops = loops[:, ::-1]
    vertex = np.array([loop.vertex_index for loop in mesh.loops])[loops]
    positions = np.array([v.co for v in mesh.vertices]) @ linear.T + offset
    normals = np.array([n.vector for n in mesh.corner_normals]) @ np.linalg.inv(linear)
    uvs = np.array([d.uv for d in mesh.uv_layers[0].data])[loops]
    return world_of(positions[vertex], unit(normals)[loops] if smooth else None, uvs)


def shade_from_above(world, x, y, to_sun):
    """Cosine of the sun at the mapped normal of what lies under a point."""
    vertices, triangles = world.geometry.vertices.astype(np.float64), world.geometry.triangles
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    s, t = np.linalg.solve(np.stack([b - a, c - a], axis=2), ((x, y) - a)[..., None])[..., 0].T
    triangle = int(np.argmax(np.minimum(np.minimum(s, t), 1 - s - t)))
    n, _, _ = mapped(world, triangle, (s[triangle], t[triangle]), DOWN, 0.8)
    return max(0.0, n @ to_sun)
