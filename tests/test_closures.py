"""Closures become lobes that keep energy and match known cases; tables match Monte Carlo."""

from dataclasses import fields

import numpy as np
import pytest
from core_scenes import fewer, floor_scene

from lighttree_core import scene as sc
from lighttree_core.albedo_tables import load_albedo_tables
from lighttree_core.closure_parts import reflecting_normal
from lighttree_core.closures import setup_lobes, straight_transparency
from lighttree_core.fresnel import F82, fresnel_dielectric, fresnel_f82
from lighttree_core.jit import kernel
from lighttree_core.lobes import (
    DIFFUSE_LOBE,
    MAX_LOBES,
    MICROFACET_LOBE,
    TRANSPARENT_LOBE,
    allocate_lobes,
    sample_lobes,
    transparency,
)
from lighttree_core.sampling import uniform, uniform_pair
from lighttree_core.scene import BACK, FRONT, Closures, Textures
from lighttree_core.settings import Settings
from lighttree_core.vec import store3
from lighttree_core.world import build_world

NUM = fewer(16_384, 200)
UP = (0.0, 0.0, 1.0)
RED = (0.8, 0.3, 0.1)
WHITE = (1.0, 1.0, 1.0)


def _vec3(a):
    return tuple(np.float32(x) for x in a)


def _from_cos(cos):
    return _vec3((np.sqrt(1 - cos * cos), 0, cos))


def _closures(*rows, multiscatter=True):
    """Closures of weight 1 from (kind, {column: value})."""
    table = Closures.empty(len(rows))
    table.weight[:], table.multiscatter[:] = 1, multiscatter
    for row, (kind, values) in enumerate(rows):
        table.kind[row] = kind
        for column, value in values.items():
            table.values[row, column : column + np.size(value)] = value
    return table


def _world(closures, textures=None, colors=()):
    """A floor of these closures."""
    scene = floor_scene()
    scene.closures, scene.textures = closures, textures or Textures.empty()
    scene.materials.num_closures[:] = len(closures.kind)
    if len(colors):
        colors = np.asarray(colors, np.float32)[:, None, None]
        scene.colors = np.broadcast_to(colors, (len(colors), 2, 3, 3))
        scene.uvs = np.array([[[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]], np.float32)
    scene.corner_normals = np.broadcast_to(np.float32(UP), (2, 3, 3))
    return build_world(scene, Settings())


def _attributes(num):
    """Textures of the first colour attributes of the scene."""
    textures = Textures.empty(num)
    textures.kind[:], textures.source[:] = sc.COLOR_ATTRIBUTE, np.arange(num)
    return textures


def _setup(world, wo=UP, side=FRONT):
    """(lobes, their number) of the floor seen from wo, given above it, whichever the side."""
    lobes, third = allocate_lobes(), np.float32(1 / 3)
    num = setup_lobes(world, 0, side, third, third, _vec3(UP), _vec3(UP), _vec3(wo), lobes)
    return lobes, num


@kernel
def _sample_all(lobes, num, n_geo, wo, seed, wi, weight):
    for k in range(len(wi)):
        u_lobe = np.float32(uniform(seed, 0, k, 2))
        direction, value, _, _ = sample_lobes(
            lobes, num, n_geo, wo, u_lobe, uniform_pair(seed, 0, k, 0)
        )
        store3(wi, k, direction)
        store3(weight, k, value)


def _sample(world, cos, side=FRONT):
    """(directions, weights) that sampling gives to a view of that cosine, (NUM, 3) both."""
    wo = _from_cos(cos)
    lobes, num = _setup(world, wo, side)
    wi, weight = np.zeros((2, NUM, 3), np.float32)
    _sample_all(lobes, num, _vec3(UP), wo, 7, wi, weight)
    return wi, weight.astype(np.float64)


def _mean(weights):
    """(mean, four deviations of it) as if samples were random; they are stratified and better."""
    return weights.mean(axis=0), 4 * weights.std(axis=0) / np.sqrt(len(weights))


def _lambda(alpha, cos):
    return (np.sqrt(1 + alpha**2 * (1 / cos**2 - 1)) - 1) / 2


def _dielectric(cos, ior):
    squared = ior**2 - 1 + cos**2
    g = np.sqrt(np.maximum(squared, 0))
    r_s, r_p = (cos - g) / (cos + g), (ior**2 * cos - g) / (ior**2 * cos + g)
    return np.where(squared > 0, (r_s**2 + r_p**2) / 2, 1)


def _facets(alpha, wo, wi, ior):
    """Those that send light from wi to wo: (density, cosine to wo, to wi, |wo + ior wi|)."""
    h = wo + ior * wi
    length = np.linalg.norm(h, axis=1)
    h = h / (length * np.sign(h[:, 2]))[:, None]
    density = alpha**2 / np.pi / (1 + (alpha**2 - 1) * h[:, 2] ** 2) ** 2
    return density, h @ wo, np.sum(h * wi, axis=1), length


def _scattered(alpha, mu, ior, num=400_000):
    """Samples of what the tables hold, (num, 3): light reflected by mirrors; reflected and let
    through by glass; the Fresnel blend of the facets that are seen. Walter et al. 2007."""
    rng = np.random.default_rng(7)
    wo = np.array([np.sqrt(1 - mu * mu), 0, mu])
    z, phi = rng.random(num), rng.uniform(0, 2 * np.pi, num)
    s = np.sqrt(1 - z * z)
    wi = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)
    masked = 1 + _lambda(alpha, mu)
    shadowed = masked + _lambda(alpha, z)

    density, cos_o, _, _ = _facets(alpha, wo, wi, 1)
    density *= 2 * np.pi / (4 * mu)
    fresnel, f0 = _dielectric(cos_o, ior), ((ior - 1) / (ior + 1)) ** 2
    reflected = density / shadowed
    blend = density / masked * (fresnel - f0) / (1 - f0)

    density, cos_o, cos_i, length = _facets(alpha, wo, wi * [1, 1, -1], ior)
    passed = 2 * np.pi * density / mu * (ior / length) ** 2 * np.abs(cos_o * cos_i) / shadowed
    passed *= (1 - _dielectric(np.abs(cos_o), ior)) * ((cos_o > 0) & (cos_i < 0))
    return np.stack([reflected, reflected * fresnel + passed, blend], axis=1)


# Out of glass just straight on: elsewhere the table counts light that is refracted back.
@pytest.mark.parametrize(("side", "mu_knot"), [(0, 5), (0, 15), (1, 15)])
def test_tables_hold_what_monte_carlo_finds(side, mu_knot):
    tables, z, rough_knot = load_albedo_tables(), 8, 12
    roughness, mu, z_sq = rough_knot / 15, mu_knot / 15, (z / 15) ** 2
    ior = (1 + z_sq) / (1 - z_sq)
    mean, tolerance = _mean(_scattered(roughness**2, mu, 1 / ior if side else ior))
    found = tables.glass[side, z, mu_knot, rough_knot]
    np.testing.assert_array_less(abs(found - mean[1]), tolerance[1])
    if side == 0:
        found = tables.dielectric_blend[z, mu_knot, rough_knot]
        np.testing.assert_array_less(abs(found - mean[2]), tolerance[2])


def test_table_of_reflection_holds_what_monte_carlo_finds():
    tables = load_albedo_tables()
    for knot in (20, 31):
        for mu_knot in (8, 31):
            mean, tolerance = _mean(_scattered((knot / 31) ** 2, mu_knot / 31, 1.5))
            assert abs(tables.reflected[mu_knot, knot] - mean[0]) < tolerance[0]
    mu = np.arange(32) / 31
    weighted = 2 * mu[:, None] * tables.reflected
    means = (weighted[1:] + weighted[:-1]).sum(axis=0) / 62
    np.testing.assert_allclose(tables.reflected_mean, means, atol=2e-3)


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.4, 0.7, 1.0])
@pytest.mark.parametrize(
    "kind", [sc.DIFFUSE, sc.TRANSLUCENT, sc.TRANSPARENT, sc.GLOSSY, sc.GLASS, sc.PRINCIPLED]
)
def test_white_surfaces_scatter_all_light(kind, roughness):
    values = {sc.COLOR: WHITE, sc.ROUGHNESS: roughness, sc.METALLIC: 1.0, sc.IOR: 1.45}
    world = _world(_closures((kind, values)))
    for cos in (0.15, 0.5, 1.0):
        mean, tolerance = _mean(_sample(world, cos)[1])
        tolerance += 0.02 if kind == sc.GLASS else 0.01
        np.testing.assert_array_less(abs(mean - 1), tolerance, err_msg=f"cosine {cos}")


def test_rough_surfaces_lose_light_unless_it_is_made_up_for():
    values = {sc.COLOR: WHITE, sc.ROUGHNESS: 1.0, sc.IOR: 1.5}
    for kind in (sc.GLOSSY, sc.GLASS, sc.REFRACTION):
        world = _world(_closures((kind, values), multiscatter=False))
        mean, tolerance = _mean(_sample(world, 0.5)[1])
        assert np.all(mean + tolerance < 0.95 + tolerance)


def test_principled_never_gains_energy():
    rng = np.random.default_rng(7)
    for _ in range(fewer(60, 8)):
        values = {column: rng.random() for column in (sc.ROUGHNESS, sc.ALPHA, sc.COAT_ROUGHNESS)}
        for column in (sc.METALLIC, sc.TRANSMISSION, sc.COAT_WEIGHT, sc.DIFFUSE_ROUGHNESS):
            values[column] = rng.choice([0.0, 1.0, rng.random()])
        for column in (sc.COLOR, sc.SPECULAR_TINT, sc.COAT_TINT):
            values[column] = rng.choice([np.ones(3), rng.random(3)])
        values |= {sc.IOR: rng.uniform(1, 2.5), sc.COAT_IOR: rng.uniform(1, 2.5)}
        values[sc.SPECULAR_LEVEL] = rng.random()
        world = _world(_closures((sc.PRINCIPLED, values)))
        mean, tolerance = _mean(_sample(world, rng.uniform(0.05, 1), rng.choice([FRONT, BACK]))[1])
        assert np.all(mean <= 1.02 + tolerance), (values, mean)


def test_metallic_principled_is_a_metal_with_tinted_edges():
    values = {sc.COLOR: RED, sc.METALLIC: 1.0, sc.SPECULAR_TINT: (0.5, 0.7, 1.0), sc.ROUGHNESS: 0.0}
    world = _world(_closures((sc.PRINCIPLED, values)))
    for cos in (1 / 7, 0.8):
        lobes, num = _setup(world, _from_cos(cos))
        assert (num, lobes.kind[0], lobes.fresnel[0]) == (1, MICROFACET_LOBE, F82)
        b = tuple(lobes.f82_b[0])
        expected = fresnel_f82(np.float32(cos), _vec3(RED), b)
        np.testing.assert_allclose(_sample(world, cos)[1].mean(axis=0), expected, rtol=1e-4)
        if cos < 0.5:
            untinted = np.array(RED) + (1 - np.array(RED)) * (6 / 7) ** 5
            np.testing.assert_allclose(expected, untinted * [0.5, 0.7, 1.0], rtol=1e-4)


def test_principled_without_specular_level_is_diffuse():
    values = {sc.COLOR: RED, sc.SPECULAR_LEVEL: 0.0}
    lobes, num = _setup(_world(_closures((sc.PRINCIPLED, values))))
    assert (num, lobes.kind[0]) == (1, DIFFUSE_LOBE)
    np.testing.assert_allclose(lobes.weight[0], RED, rtol=1e-6)


@pytest.mark.parametrize("side", [FRONT, BACK])
def test_smooth_transmissive_principled_is_clear_glass(side):
    values = {sc.COLOR: RED, sc.TRANSMISSION: 1.0, sc.ROUGHNESS: 0.0, sc.IOR: 1.5}
    world = _world(_closures((sc.PRINCIPLED, values)))
    for cos in (0.3, 0.8):
        wi, weight = _sample(world, cos, side)
        ior = 1 / 1.5 if side == BACK else 1.5
        reflected = fresnel_dielectric(np.float32(cos), np.float32(ior))[0]
        is_reflected = (wi[:, 2] > 0)[:, None]
        mean, tolerance = _mean(weight * is_reflected)
        np.testing.assert_array_less(abs(mean - reflected), tolerance + 1e-5)
        mean, tolerance = _mean(weight * ~is_reflected)
        expected = (1 - reflected) * np.sqrt(RED)
        np.testing.assert_array_less(abs(mean - expected), tolerance + 1e-5)
        # Snell's law.
        sines = wi[~is_reflected[:, 0], 0]
        np.testing.assert_allclose(sines, -np.sqrt(1 - cos**2) / ior, rtol=1e-4)


def test_alpha_shares_out_between_the_surface_and_what_is_behind():
    lobes, num = _setup(_world(_closures((sc.PRINCIPLED, {sc.ALPHA: 0.0}))))
    assert (num, lobes.kind[0]) == (1, TRANSPARENT_LOBE)
    world = _world(_closures((sc.PRINCIPLED, {sc.ALPHA: 0.25, sc.COLOR: RED})))
    lobes, num = _setup(world)
    np.testing.assert_allclose(transparency(lobes, num), [0.75] * 3)
    opaque = _world(_closures((sc.PRINCIPLED, {sc.COLOR: RED})))
    (mean, tolerance), (opaque_mean, _) = (_mean(_sample(w, 0.5)[1]) for w in (world, opaque))
    np.testing.assert_array_less(abs(mean - (0.75 + 0.25 * opaque_mean)), tolerance)


def test_a_coat_takes_from_below_what_it_reflects_and_tints():
    coat = {sc.COAT_WEIGHT: 1.0, sc.COAT_ROUGHNESS: 0.0, sc.COAT_IOR: 1.5, sc.SPECULAR_LEVEL: 0.0}
    for cos in (0.2, 1.0):
        reflected = fresnel_dielectric(np.float32(cos), np.float32(1.5))[0]
        world = _world(_closures((sc.PRINCIPLED, coat | {sc.COLOR: (0, 0, 0)})))
        np.testing.assert_allclose(_sample(world, cos)[1].mean(axis=0), reflected, rtol=1e-4)
        tint = (0.9, 0.5, 0.1)
        values = coat | {sc.COLOR: RED, sc.COAT_TINT: tint}
        lobes, num = _setup(_world(_closures((sc.PRINCIPLED, values))), _from_cos(cos))
        depth = 1 / np.sqrt(1 - (1 - cos * cos) / 1.5**2)
        # The table of what a coat reflects is linear between few cosines.
        expected = (1 - reflected) * np.array(RED) * np.array(tint) ** depth
        assert (num, lobes.kind[1]) == (2, DIFFUSE_LOBE)
        np.testing.assert_allclose(lobes.weight[1], expected, rtol=0.02)


def test_textures_multiply_weights_and_replace_values():
    closures = _closures((sc.PRINCIPLED, {sc.SPECULAR_LEVEL: 0.0}), (sc.GLOSSY, {sc.COLOR: WHITE}))
    closures.weight[:] = [[0.5, 0.5, 0.5], [1, 1, 1]]
    closures.weight_texture[0], closures.value_texture[0, sc.COLOR] = 0, 1
    closures.value_texture[1, sc.ROUGHNESS] = 2
    colors = [(1.0, 0.5, 0.2), RED, (0.4, 0, 0)]
    lobes, num = _setup(_world(closures, _attributes(3), colors))
    assert num == 2
    np.testing.assert_allclose(lobes.weight[0], 0.5 * np.array(colors[0]) * RED, rtol=1e-5)
    np.testing.assert_allclose(lobes.alpha[1], 0.16, rtol=1e-5)


@pytest.mark.parametrize("cos", [1.0, 0.7, 0.2])
def test_the_angle_weighs_closures_and_what_they_let_through_alike(cos):
    closures = _closures((sc.TRANSPARENT, {sc.COLOR: RED}), (sc.DIFFUSE, {sc.COLOR: WHITE}))
    closures.weight_texture[:] = 0, 1
    textures = Textures.empty(2)
    # The cosine itself, and what is left of it.
    textures.kind[:], textures.scale[1], textures.bias[1] = sc.FACING, -1, 1
    world, wo = _world(closures, textures, np.zeros((1, 3))), _from_cos(cos)
    lobes, num = _setup(world, wo)
    assert num == (1 if cos == 1 else 2)
    clear = cos * np.array(RED)
    np.testing.assert_allclose(transparency(lobes, num), clear, rtol=1e-5)
    third, along = np.float32(1 / 3), _vec3(np.negative(wo))
    told = straight_transparency(world, 0, FRONT, third, third, along, lobes.inputs)
    np.testing.assert_allclose(told, clear, rtol=1e-5)


@pytest.mark.parametrize("side", [FRONT, BACK])
def test_normal_maps_tilt_their_own_closure(side):
    closures = _closures((sc.DIFFUSE, {}), (sc.DIFFUSE, {}), (sc.GLOSSY, {}))
    closures.normal_texture[1:] = 0
    tilted = np.array([0.6, 0.0, 0.8])
    world = _world(closures, _attributes(1), [(1 + tilted) / 2])
    lobes, num = _setup(world, side=side)
    assert num == 3
    sign = 1 if side == FRONT else -1
    np.testing.assert_allclose(lobes.normal[0], UP, atol=1e-6)
    np.testing.assert_allclose(lobes.normal[1], tilted * sign, atol=1e-3)
    if side == FRONT:
        np.testing.assert_allclose(lobes.normal[2], tilted, atol=1e-3)


def test_mirrors_never_send_light_below_the_surface():
    rng = np.random.default_rng(7)
    num_tilted = 0
    for _ in range(200):
        wo, n = _from_cos(rng.uniform(0.001, 1)), rng.normal(size=3)
        n[2] = abs(n[2])
        n = _vec3(n / np.linalg.norm(n))
        tilted = np.array(reflecting_normal(_vec3(UP), wo, n), np.float64)
        mirrored = 2 * (tilted @ wo) * tilted - wo
        lowest = min(0.9 * wo[2], 0.01)
        assert abs(np.linalg.norm(tilted) - 1) < 1e-5
        assert mirrored[2] > lowest - 1e-5
        if np.all(tilted == np.array(n)):
            continue
        num_tilted += 1
        # No further than needed, and within the plane of both normals.
        assert mirrored[2] < lowest + 1e-5
        assert abs(np.cross(n, UP) @ tilted) < 1e-5
    assert num_tilted > 20


def test_transparency_is_known_without_setting_up_lobes():
    rows = (sc.TRANSPARENT, {sc.COLOR: RED}), (sc.PRINCIPLED, {sc.ALPHA: 0.4}), (sc.GLASS, {})
    closures = _closures(*rows)
    closures.weight[:] = [[0.5] * 3, [0.3] * 3, [0.2] * 3]
    world = _world(closures)
    lobes, num = _setup(world)
    third = np.float32(1 / 3)
    told = straight_transparency(world, 0, FRONT, third, third, _vec3(UP), lobes.inputs)
    np.testing.assert_allclose(told, transparency(lobes, num), rtol=1e-6)
    np.testing.assert_allclose(told, 0.5 * np.array(RED) + 0.3 * 0.6, rtol=1e-5)


def test_closures_beyond_the_room_for_lobes_are_left_out():
    closures = _closures(*[(sc.DIFFUSE, {})] * (MAX_LOBES + 3))
    assert _setup(_world(closures))[1] == MAX_LOBES
    closures.weight[:] = 1e-7
    assert _setup(_world(closures))[1] == 0


def test_tables_of_kernels_have_exact_types():
    closures = Closures.empty(2)
    closures.kind = closures.kind.astype(np.int64)
    closures.values = np.asfortranarray(closures.values.astype(np.float64))
    table = _world(closures).closures
    for column in fields(Closures):
        found, expected = getattr(table, column.name), getattr(Closures.empty(2), column.name)
        assert found.dtype == expected.dtype
        assert found.shape == expected.shape
        assert found.flags.c_contiguous
