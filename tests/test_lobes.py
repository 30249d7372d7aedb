"""What lobes sample is what they evaluate, and they keep energy and the sides of a surface."""

import itertools

import numpy as np
import pytest
from core_scenes import JIT_IS_OFF, fewer, needs_float32
from lobe_cases import (
    ALL,
    GRID,
    GRID_ERROR,
    KINDS,
    MIXTURES,
    NUM,
    RED,
    UP,
    WO,
    evaluate,
    f32,
    glass,
    lambert,
    make_lobes,
    mirror,
    refraction,
    rough_matt,
    sample,
    towards,
    translucent,
    transparent,
    unit,
    vec3,
)

from lighttree_core import lobes as lb
from lighttree_core.fresnel import f82_b_from_tint
from lighttree_core.scene import ALL_RAYS, DIFFUSE_RAY, GLOSSY_RAY, TRANSMISSION_RAY


@needs_float32
@pytest.mark.parametrize("name", ALL)
def test_samples_weigh_what_is_evaluated(name):
    makers = ALL[name]
    for wo in WO:
        lobes = make_lobes(makers, wo)
        wi, weight, pdf, kind = sample(lobes, len(makers), wo, samples=fewer(2000, 100))
        assert np.isfinite(weight).all() and np.isfinite(pdf).all() and (weight >= 0).all()
        lives = weight.any(axis=1)
        np.testing.assert_allclose(np.linalg.norm(wi[lives], axis=1), 1, atol=2e-6)
        has_density = pdf > 0
        value, density = evaluate(lobes, len(makers), wo, wi[has_density])
        np.testing.assert_allclose(density, pdf[has_density], rtol=1e-6)
        np.testing.assert_allclose(weight[has_density] * density[:, None], value, rtol=1e-5)
        is_behind = wi[:, 2] < 0
        assert not is_behind[lives & (kind == GLOSSY_RAY)].any()
        assert is_behind[lives & (kind == TRANSMISSION_RAY)].all()
        assert is_behind[lives & (kind == lb.STRAIGHT_RAY)].all()


@pytest.mark.parametrize("name", KINDS)
def test_densities_integrate_to_the_share_that_is_sampled(name):
    for wo in WO:
        lobes = make_lobes((KINDS[name],), wo)
        wi, cell = GRID
        _, pdf = evaluate(lobes, 1, wo, wi)
        share = (sample(lobes, 1, wo)[2] > 0).mean()
        # A share has a deviation of 0.5 / sqrt(NUM) at most.
        assert abs((pdf * cell).sum() - share) < 4 * 0.5 / np.sqrt(NUM) + GRID_ERROR


@pytest.mark.parametrize("name", KINDS)
def test_samples_fall_where_the_density_says(name):
    wo = WO[1]
    lobes = make_lobes((KINDS[name],), wo)
    grid, cell = GRID
    _, pdf = evaluate(lobes, 1, wo, grid)
    wi, _, sampled_pdf, _ = sample(lobes, 1, wo)
    wi = wi[sampled_pdf > 0]

    def bins(w, weights=None):
        x, y = np.arctan2(w[:, 1], w[:, 0]) / np.pi, w[:, 2]
        return np.histogram2d(y, x, (12, 8), ((-1, 1), (-1, 1)), weights=weights)[0]

    expected = bins(grid, pdf * cell) * NUM
    found = bins(wi)
    # Deviations of a bin: that of its count and, as bins cut cells of the grid, a share of it.
    deviation = np.sqrt(expected + 1) + fewer(0.02, 0.5) * expected
    assert np.abs((found - expected) / deviation).max() < 5


@pytest.mark.parametrize("name", ALL)
def test_single_scattering_keeps_energy_and_its_albedo_is_the_integral(name):
    makers = ALL[name]
    if name in MIXTURES:
        makers = tuple(make for make in makers if make in KINDS.values())
    for wo in WO:
        lobes = make_lobes(makers, wo)
        value, _ = evaluate(lobes, len(makers), wo, GRID[0])
        albedo = (value * GRID[1][:, None]).sum(0)
        _, weight, _, _ = sample(lobes, len(makers), wo)
        mean, deviation = weight.mean(0), weight.std(0) / np.sqrt(NUM)
        assert (np.abs(mean - albedo) < 4 * deviation + GRID_ERROR * len(makers)).all()
        assert (mean < len(makers) + 4 * deviation + 1e-5).all()


def test_white_rough_matt_surfaces_keep_all_energy():
    for roughness, wo in itertools.product((1e-4, 0.3, 1.0), WO):
        lobes = make_lobes((), wo)
        lb.set_diffuse(lobes, 0, vec3([1] * 3), vec3(UP), f32(roughness), vec3([1] * 3), wo)
        value, _ = evaluate(lobes, 1, wo, GRID[0])
        np.testing.assert_allclose((value * GRID[1][:, None]).sum(0), 1, atol=GRID_ERROR / 4)


def test_coloured_rough_matt_surfaces_have_the_albedo_of_cycles():
    for roughness, wo in itertools.product((0.3, 1.0), WO):
        lobes, albedos = make_lobes((), wo), []
        for color in ([0] * 3, RED):
            lb.set_diffuse(lobes, 0, vec3([1] * 3), vec3(UP), f32(roughness), vec3(color), wo)
            albedos.append(np.sum(evaluate(lobes, 1, wo, GRID[0])[0] * GRID[1][:, None], axis=0))
        single = albedos[0]  # without colour, nothing is scattered twice
        # What single scattering keeps on average (Fujii; OpenPBR); the rest meets grains again.
        kept = (np.pi + roughness * (2 * np.pi - 5.6) / 3) / (
            np.pi + roughness * (np.pi / 2 - 2 / 3)
        )
        several = np.square(RED) * kept / (1 - np.multiply(RED, 1 - kept))
        expected = single + (1 - single) * several
        np.testing.assert_allclose(albedos[1], expected, atol=GRID_ERROR / 4)


def test_roughness_of_a_matt_surface_starts_at_lambert():
    wo = WO[1]
    lobes = make_lobes((), wo)
    values = []
    for roughness in (0.0, 1.1e-5):
        lb.set_diffuse(lobes, 0, vec3([1] * 3), vec3(UP), f32(roughness), vec3(RED), wo)
        values.append(evaluate(lobes, 1, wo, GRID[0])[0])
    np.testing.assert_allclose(values[1], values[0], atol=1e-5)


def test_delta_lobes_share_by_their_picks():
    wo = WO[1]
    lobes = make_lobes((transparent, mirror(0.0)), wo)
    lb.set_pick(lobes, 1, vec3([0.2] * 3))
    wi, weight, pdf, kind = sample(lobes, 2, wo)
    is_straight = kind == lb.STRAIGHT_RAY
    assert not pdf.any()
    np.testing.assert_allclose(wi[is_straight], -np.tile(wo, (is_straight.sum(), 1)), atol=1e-7)
    # The mean of all weights is the sum of what the two let through and reflect.
    deviation = weight.std(0) / np.sqrt(NUM)
    assert (np.abs(weight.mean(0) - (np.array(RED) + 1)) < 4 * deviation).all()
    assert abs(is_straight.mean() - 0.4 / 0.6) < 4 * 0.5 / np.sqrt(NUM)


def test_directions_on_the_wrong_side_of_the_geometry_end_the_path():
    n, n_geo = unit(0.7, 0, 1), UP
    wo = unit(0.3, 0.1, 1)
    for makers in ((lambert,), (translucent,), (mirror(0.5),), (glass(0.7),)):
        lobes = make_lobes(makers, wo, n=n)
        lb.set_shading_normal(lobes, n)
        wi, weight, _, kind = sample(lobes, 1, wo, n_geo=n_geo)
        lives = weight.any(axis=1)
        # The normal is tilted by 35 degrees, so a part of the hemisphere is lost.
        assert 0.5 < lives.mean() < 0.99
        goes_through = (kind == TRANSMISSION_RAY) | (makers[0] is translucent)
        assert ((wi[:, 2] < 0) == goes_through)[lives].all()


def test_normal_maps_send_no_light_through_the_smooth_surface():
    n = unit(0.8, 0, 1)
    wo = unit(0.5, 0, 1)
    for maker in (lambert, rough_matt, mirror(0.5)):
        lobes = make_lobes((maker,), wo, n=n)
        value, _ = evaluate(lobes, 1, wo, GRID[0])
        is_above, is_in_front = GRID[0][:, 2] > 0, GRID[0] @ np.array(n) > 0
        assert not value[~is_above].any()
        assert value[is_above & is_in_front].any(axis=1).mean() > 0.99
    # Matt lobes fade out towards the horizon of the smooth surface.
    lobes = make_lobes((lambert,), wo, n=n)
    near, far = evaluate(lobes, 1, wo, [towards(89.9), towards(10)])[0][:, 0]
    assert near < 0.05 * far


def test_lights_that_some_rays_do_not_see_shine_on_other_lobes():
    wo, reflected, through = WO[1], towards(35, 200), towards(150, 200)
    cases = (
        (lambert, reflected, DIFFUSE_RAY),
        (translucent, through, DIFFUSE_RAY),
        (mirror(0.3), reflected, GLOSSY_RAY),
        (refraction(0.3), through, TRANSMISSION_RAY),
        (glass(0.3), through, GLOSSY_RAY | TRANSMISSION_RAY),
    )
    for maker, wi, needed in cases:
        lobes = make_lobes((maker,), wo)
        full, pdf = evaluate(lobes, 1, wo, [wi])
        assert full.any()
        for rays in (DIFFUSE_RAY, GLOSSY_RAY, TRANSMISSION_RAY):
            value, same_pdf = evaluate(lobes, 1, wo, [wi], rays)
            assert value.any() == bool(rays & needed) and same_pdf == pdf


def test_what_a_surface_does_is_told():
    wo = WO[0]
    told = {
        (lambert,): (False, False),
        (translucent,): (True, False),
        (lambert, mirror(0.0)): (False, True),
        (glass(0.0),): (False, True),
        (lambert, glass(0.1)): (True, True),
        (glass(0.1, 1.0),): (False, True),
        (transparent,): (False, False),
    }
    for makers, expected in told.items():
        lobes = make_lobes(makers, wo)
        found = lb.transmits(lobes, len(makers)), lb.is_glossy(lobes, len(makers))
        assert tuple(bool(x) for x in found) == expected
    lobes = make_lobes((transparent, lambert, transparent), wo)
    np.testing.assert_allclose(lb.transparency(lobes, 3), 2 * np.array(RED), rtol=1e-6)


def _fuzz_case(rng):
    """(lobes, num, n_geo, wo) of a wild surface."""

    def direction():
        w = rng.normal(size=3) * 10.0 ** rng.uniform(-8, 0, 3)
        return unit(*(w if w.any() else (0, 0, 1)))

    lobes, wo, n_geo = lb.allocate_lobes(), direction(), direction()
    lb.set_shading_normal(lobes, direction())
    num = rng.integers(1, 6)
    for i in range(num):
        n = direction() if rng.random() < 0.7 else vec3(wo)
        weight = vec3(rng.random(3) * (rng.random(3) < 0.8) * 10.0 ** rng.uniform(-6, 2))
        kind = rng.integers(8)
        alpha = min(1.0, 10.0 ** rng.uniform(-6, 0.3))
        ior = rng.choice([1.0, 1 + 10.0 ** rng.uniform(-7, 0.3), 1 / (1 + rng.random() * 2)])
        if kind == 0:
            color = vec3(rng.random(3) * 1.2)
            lb.set_diffuse(lobes, i, weight, n, f32(rng.choice([0, 2e-5, 1])), color, wo)
        elif kind == 1:
            lb.set_translucent(lobes, i, weight, n)
        elif kind == 2:
            lb.set_transparent(lobes, i, weight)
        else:
            transmits = bool(kind in (4, 5, 6))
            lb.set_microfacet(lobes, i, weight, n, f32(alpha), f32(ior), kind != 4, transmits)
            if kind == 5:
                lb.set_fresnel_dielectric(lobes, i)
            elif kind == 6:
                tints = (vec3(rng.random(3) * (rng.random() < 0.8)) for _ in range(2))
                lb.set_fresnel_schlick(lobes, i, vec3(rng.random(3)), *tints)
            elif kind == 7:
                f0 = vec3(rng.random(3))
                lb.set_fresnel_f82(lobes, i, f0, f82_b_from_tint(f0, vec3(rng.random(3))))
    return lobes, num, n_geo, wo


def test_whatever_goes_in_finite_numbers_come_out():
    rng = np.random.default_rng(7)
    for _ in range(fewer(1500, 40)):
        lobes, num, n_geo, wo = _fuzz_case(rng)
        wi, weight, pdf, _ = sample(lobes, num, wo, n_geo, fewer(40, 5), rng.integers(2**31))
        assert np.isfinite(wi).all() and np.isfinite(weight).all() and np.isfinite(pdf).all()
        assert (weight >= 0).all() and (pdf >= 0).all()
        axes = np.concatenate([np.eye(3), -np.eye(3), [wo], [np.negative(wo)], lobes.normal[:num]])
        value, pdf = evaluate(lobes, num, wo, np.concatenate([wi, axes]))
        assert np.isfinite(value).all() and np.isfinite(pdf).all()
        assert (value >= 0).all() and (pdf >= 0).all()


@needs_float32
def test_kernels_return_float32():
    wo, wi, u = WO[1], towards(60, 200), (f32(0.3), f32(0.6))
    makers = MIXTURES["coated glass"]
    lobes = make_lobes(makers, wo)
    value, pdf = lb.eval_lobes(lobes, 3, vec3(UP), wo, wi, ALL_RAYS)
    _, weight, sampled_pdf, _ = lb.sample_lobes(lobes, 3, vec3(UP), wo, f32(0.2), u)
    if JIT_IS_OFF:
        assert {type(x) for x in (*value, pdf, *weight, sampled_pdf)} == {np.float32}
        return
    for function in (lb.eval_lobes, lb.sample_lobes):
        for signature in function.for_python.nopython_signatures:
            assert "float64" not in str(signature.return_type)
