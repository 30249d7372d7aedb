"""Hits: their side, safe starting points, shading normals and normal maps; the latter also as in
Cycles."""

import math

import numpy as np
import pytest
from core_scenes import fewer, floor_scene, needs_float32

from lighttree_core import Settings
from lighttree_core.scene import BACK, FRONT, Textures
from lighttree_core.surface import hit_side, load_surface, mapped_normal
from lighttree_core.world import World, build_world

NUM = fewer(200, 20)
TILTED = (0.8, 0.4, 0.7)  # of a normal map: 0.6 along u, -0.2 along v, 0.4 along the normal
DOWN = (0.0, 0.0, -1.0)
UP = (0.0, 0.0, 1.0)


def world_of(corners, normals=None, uvs=None, color=TILTED) -> World:
    """Triangles with (n, 3, 3) corners and perhaps normals there; a normal map of one colour."""
    scene = floor_scene()
    corners = np.asarray(corners, np.float32)
    scene.vertices = corners.reshape(-1, 3)
    scene.triangles = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    scene.textures = Textures.empty(1, 1)
    scene.textures.size[0], scene.textures.is_float[0] = 1, True
    scene.textures.float_texels = np.array([[*color, 1]], np.float32)
    if normals is not None:
        scene.corner_normals = np.asarray(normals, np.float32)
    if uvs is not None:
        scene.uvs = np.asarray(uvs, np.float32).reshape(1, -1, 3, 2)
    scene.triangle_material = np.zeros(len(corners), np.int32)
    return build_world(scene, Settings())


def floats(a):
    """Numbers as kernels take them."""
    return tuple(np.float32(x) for x in a)


def surface(world, triangle, barycentric, direction):
    """(p_front, p_back, n_geo, n_shade, side), vectors as float64."""
    *vectors, side = load_surface(world, triangle, *floats(barycentric), floats(direction))
    return *(np.array(a, np.float64) for a in vectors), side


def mapped(world, triangle, barycentric, direction, strength=1.0):
    """(mapped normal, n_geo, n_shade) of a hit."""
    b = floats(barycentric)
    _, _, n_geo, n_shade, side = load_surface(world, triangle, *b, floats(direction))
    n_geo, n_shade = floats(n_geo), floats(n_shade)
    n = mapped_normal(world, 0, np.float32(strength), triangle, *b, n_geo, n_shade, side)
    return np.array(n, np.float64), np.array(n_geo), np.array(n_shade)


def unit(a):
    a = np.asarray(a, np.float64)
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def weights(barycentric):
    return np.array([1 - sum(barycentric), *barycentric])


def random_barycentric(rng):
    a, b = np.sort(rng.uniform(0, 1, 2))
    return a, b - a


def sphere(num=24):
    """(n, 3, 3) corners of a unit sphere made of triangles, counter-clockwise from outside."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, num + 1), np.linspace(0, 2 * np.pi, 2 * num + 1))
    p = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    corners = np.concatenate(
        [np.stack(q, axis=2).reshape(-1, 3, 3) for q in ((a, b, c), (a, c, d))]
    )
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    return corners[area > 1e-9]


SQUARE = [[(0, 0, 0), (1, 0, 0), (1, 1, 0)]]
SQUARE_UVS = [[(0, 0), (1, 0), (1, 1)]]


@pytest.mark.parametrize("far", [0.0, 1e3, 1e6])
def test_rays_start_on_the_side_they_are_meant_for(far):
    rng = np.random.default_rng(7)
    for _ in range(NUM):
        offset = rng.uniform(-far, far, 3)
        # Smaller triangles than this have no plane where float32 is so coarse.
        size = 10 ** rng.uniform(-4, 2) + 1e-4 * far
        world = world_of([offset + size * rng.normal(size=(3, 3))])
        v0, v1, v2 = world.vertices.astype(np.float64)
        plane = unit(np.cross(v1 - v0, v2 - v0))
        direction = unit(rng.normal(size=3))
        p_front, p_back, n_geo, n_shade, side = surface(
            world, 0, random_barycentric(rng), direction
        )
        expected = FRONT if direction @ plane < 0 else BACK
        if abs(direction @ plane) > 1e-2:
            assert side == hit_side(world, 0, floats(direction)) == expected
        np.testing.assert_allclose(n_geo, plane if side == FRONT else -plane, atol=2e-3)
        np.testing.assert_array_equal(n_shade, n_geo)
        assert (p_front - v0) @ n_geo > 0 > (p_back - v0) @ n_geo
        # No farther than rounding asks for.
        reach = np.abs(world.vertices).max()
        assert np.linalg.norm(p_front - p_back) < 4e-6 * reach


def test_normals_of_a_sphere_are_those_of_the_sphere():
    rng = np.random.default_rng(7)
    corners = sphere()
    world = world_of(corners, corners)
    for triangle in rng.integers(len(corners), size=NUM):
        b = random_barycentric(rng)
        p = weights(b) @ corners[triangle]
        for outwards, direction in ((1, -p), (-1, p)):
            _, _, n_geo, n_shade, side = surface(world, int(triangle), b, unit(direction))
            assert side == (FRONT if outwards == 1 else BACK)
            # Corners lie on the sphere, so interpolated normals point where p lies.
            np.testing.assert_allclose(n_shade, outwards * unit(p), atol=1e-6)
            assert n_geo @ n_shade > 0.99


def test_shading_normals_follow_the_geometric_side():
    # The normals lean so far that a steep ray from the front sees them from behind.
    leaning = unit([(1, 0, 0.1)] * 3)
    world = world_of(SQUARE, [leaning])
    direction = unit((1, 0, -0.05))
    _, _, n_geo, n_shade, side = surface(world, 0, (0.2, 0.2), direction)
    assert side == FRONT and n_geo[2] == 1
    np.testing.assert_allclose(n_shade, leaning[0], rtol=1e-6)
    _, _, _, n_shade, side = surface(world, 0, (0.2, 0.2), -direction)
    assert side == BACK
    np.testing.assert_allclose(n_shade, -leaning[0], rtol=1e-6)


def test_normals_that_cancel_are_replaced():
    world = world_of(SQUARE, [[(1, 0, 0), (-1, 0, 0), (0, 0, 0)]])
    for direction in (DOWN, UP):
        _, _, n_geo, n_shade, _ = surface(world, 0, (0.5, 0.0), direction)
        np.testing.assert_array_equal(n_shade, n_geo)


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
    a, b, c = (world.vertices[world.triangles[:, k], :2].astype(np.float64) for k in range(3))
    s, t = np.linalg.solve(np.stack([b - a, c - a], axis=2), ((x, y) - a)[..., None])[..., 0].T
    triangle = int(np.argmax(np.minimum(np.minimum(s, t), 1 - s - t)))
    n, _, _ = mapped(world, triangle, (s[triangle], t[triangle]), DOWN, 0.8)
    return max(0.0, n @ to_sun)
