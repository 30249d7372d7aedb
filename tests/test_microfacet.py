"""Microfacets obey the laws of optics, down to mirrors and clear glass."""

import itertools

import numpy as np
import pytest
from core_scenes import fewer
from lobe_cases import (
    GRID,
    KINDS,
    NUM,
    RED,
    WO,
    evaluate,
    f32,
    glass,
    make_lobes,
    microfacet,
    mirror,
    refraction,
    sample,
    towards,
    vec3,
)

from lighttree_core import lobes as lb
from lighttree_core.fresnel import f0_from_ior, f82_b_from_tint, fresnel_dielectric, fresnel_f82
from lighttree_core.scene import GLOSSY_RAY, TRANSMISSION_RAY


def test_the_weight_of_a_mirror_is_smiths_ratio_and_never_above_one():
    for alpha, wo in itertools.product((1.5e-5, 1e-3, 0.1, 1.0), WO):
        _, weight, pdf, _ = sample(make_lobes((mirror(alpha),), wo), 1, wo)
        assert weight.max() <= 1 + 1e-5
        assert (weight[pdf > 0] > 0).all()


@pytest.mark.parametrize("alpha", [1.5e-5, 1e-4, 1e-3, 0.03])
@pytest.mark.parametrize("maker", [mirror, glass, refraction])
def test_sharp_lobes_have_their_density_too(maker, alpha):
    # Where p is sampled, the mean of q / p is the share of q that is not lost; q is narrower.
    for wo in (towards(10), towards(60, 40)):
        broad, narrow = make_lobes((maker(alpha * 1.3),), wo), make_lobes((maker(alpha),), wo)
        wi, _, pdf, _ = sample(broad, 1, wo)
        wi, pdf = wi[pdf > 0], pdf[pdf > 0]
        _, other = evaluate(narrow, 1, wo, wi)
        ratio = np.concatenate([other / pdf, np.zeros(NUM - len(pdf))])
        # Half-vectors are off by the rounding of wi and wo, 6e-8, or 0.4 % of the smallest alpha.
        tolerance = 4 * ratio.std() / np.sqrt(NUM) + 2e-3
        assert abs(ratio.mean() - 1) < tolerance


@pytest.mark.parametrize("name", ["lambert", "mirror", "metal", "coat", "glass", "rough mirror"])
def test_reflection_is_the_same_both_ways(name):
    for a, b in itertools.product(
        (towards(5), towards(50, 30), towards(85)), (towards(20, 150), towards(75, 220))
    ):
        there, back = (
            evaluate(make_lobes((KINDS[name],), wo), 1, wo, [wi])[0][0]
            for wo, wi in ((a, b), (b, a))
        )
        np.testing.assert_allclose(there * a[2], back * b[2], rtol=2e-4)


def test_refraction_is_the_same_both_ways_but_for_the_squared_ior():
    for ior, alpha in ((1.5, 0.3), (1.1, 0.2), (2.5, 1.0)):
        above, below = towards(30, 10), towards(165, 200)
        into = evaluate(make_lobes((glass(alpha, ior),), above), 1, above, [below])[0][0]
        flipped = make_lobes((glass(alpha, 1 / ior),), below, n=(0, 0, -1))
        lb.set_shading_normal(flipped, vec3([0, 0, -1]))
        out = evaluate(flipped, 1, below, [above])[0][0]
        assert into[0] > 0
        # Values are x cosine of the second direction; radiance is not scaled by the ior squared.
        np.testing.assert_allclose(into / -below[2], out / above[2] * ior**2, rtol=2e-4)


def test_no_microfacet_refracts_at_less_than_its_angle():
    # Light bends by at most 90 degrees less the critical angle, 48.2 degrees for an ior of 1.5.
    wo = towards(0)
    wi = [towards(180 - degrees) for degrees in (0, 40, 48, 49, 60, 89)]
    value, _ = evaluate(make_lobes((glass(1.0),), wo), 1, wo, wi)
    assert (value[:3] > 0).all() and (value[3:] == 0).all()


def test_fresnel_has_known_values():
    for ior in (1 / 3, 0.9, 1.0001, 1.5, 3.0):
        reflected, cos_t = fresnel_dielectric(f32(1), f32(ior))
        assert reflected == pytest.approx(((ior - 1) / (ior + 1)) ** 2, rel=2e-3)
        assert f0_from_ior(f32(ior)) == pytest.approx(reflected, rel=2e-3)
        assert cos_t == pytest.approx(1, rel=1e-6)
        # Under Brewster's angle light polarized in the plane of incidence is not reflected.
        brewster = np.cos(np.arctan(ior))
        reflected, _ = fresnel_dielectric(f32(brewster), f32(ior))
        assert reflected == pytest.approx(((ior**2 - 1) / (ior**2 + 1)) ** 2 / 2, rel=2e-3)
        assert fresnel_dielectric(f32(1e-6), f32(ior))[0] == pytest.approx(1, abs=3e-4)
    sin_critical = 1 / 1.5
    for sin_theta, is_total in ((sin_critical - 1e-3, False), (sin_critical + 1e-3, True)):
        reflected, cos_t = fresnel_dielectric(f32(np.sqrt(1 - sin_theta**2)), f32(1 / 1.5))
        assert bool(reflected == 1 and cos_t == 0) is is_total


def test_metals_have_their_values_at_0_82_and_90_degrees():
    f0, tint = np.array(RED), np.array([0.2, 0.9, 1])
    b = f82_b_from_tint(vec3(f0), vec3(tint))
    np.testing.assert_allclose(fresnel_f82(f32(1), vec3(f0), b), f0, rtol=1e-6)
    np.testing.assert_allclose(fresnel_f82(f32(0), vec3(f0), b), 1, rtol=1e-6)
    at_82 = (f0 + (1 - f0) * (6 / 7) ** 5) * tint
    np.testing.assert_allclose(fresnel_f82(f32(1 / 7), vec3(f0), b), at_82, rtol=1e-5)


def test_tints_colour_what_is_reflected_and_what_passes():
    wo, f0, red, green = towards(0), np.array([0.04, 0.3, 0.9]), (1, 0.5, 0.2), (0.1, 0.8, 0.3)

    def tinted(lobes, i):
        lb.set_fresnel_schlick(lobes, i, vec3(f0), vec3(red), vec3(green))

    lobes = make_lobes((microfacet(0.0, 1.5, True, True, tinted),), wo)
    _, weight, _, kind = sample(lobes, 1, wo, samples=200)
    reflected, passed = f0 * red, (1 - f0) * green
    # Either is chosen in proportion to its mean, which the weight of a sample is divided by.
    total = (reflected + passed).mean()
    for ray_kind, expected in ((GLOSSY_RAY, reflected), (TRANSMISSION_RAY, passed)):
        found = weight[kind == ray_kind]
        assert len(found) > 0
        np.testing.assert_allclose(found, [expected / expected.mean() * total] * len(found), 1e-5)


def test_schlick_with_the_f0_of_glass_is_glass():
    def plain(lobes, i):
        white = vec3([1] * 3)
        f0 = f0_from_ior(f32(1.5))
        lb.set_fresnel_schlick(lobes, i, (f32(f0),) * 3, white, white)

    wo, wi = WO[1], GRID[0][:: fewer(50, 1)]
    values = [
        evaluate(make_lobes((microfacet(0.5, 1.5, True, True, fresnel),), wo), 1, wo, wi)[0]
        for fresnel in (plain, lb.set_fresnel_dielectric)
    ]
    # The real curve dips below f0 before Brewster's angle, by 0.0002 of 1.
    np.testing.assert_allclose(*values, rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("ior", [1.5, 1 / 1.5, 1.00005, 2.4])
def test_clear_glass_obeys_snell(ior):
    ior = f32(ior)
    for degrees in (0, 20, 40, 70, 89):
        wo = towards(degrees, 30)
        lobes = make_lobes((glass(0.0, ior),), wo)
        wi, weight, pdf, kind = sample(lobes, 1, wo, samples=64)
        assert (pdf == 0).all() and not evaluate(lobes, 1, wo, wi)[0].any()
        np.testing.assert_allclose(weight, 1, rtol=1e-5)
        reflected, sin_t = kind == GLOSSY_RAY, np.sin(np.radians(degrees)) / ior
        assert wi[reflected] @ wo == pytest.approx(2 * wo[2] ** 2 - 1, abs=1e-6)
        if sin_t > 1:
            assert reflected.all()
            continue
        expected = [-wo[0] / ior, -wo[1] / ior, -np.sqrt(1 - sin_t**2)]
        np.testing.assert_allclose(wi[~reflected], [expected] * (~reflected).sum(), atol=2e-6)


def test_an_ior_of_one_goes_straight_on_through_rough_glass():
    wo = WO[1]
    wi, weight, pdf, kind = sample(make_lobes((glass(0.5, 1.0),), wo), 1, wo, samples=64)
    assert (kind == TRANSMISSION_RAY).all() and (pdf == 0).all()
    np.testing.assert_allclose(weight, 1, rtol=1e-6)
    np.testing.assert_allclose(wi, -np.tile(wo, (64, 1)), atol=1e-6)


@pytest.mark.parametrize("maker", [mirror, glass, refraction])
def test_alpha_goes_to_its_limit_smoothly(maker):
    for wo in (towards(20, 10), towards(75, 100)):
        sharp, smooth = (
            sample(make_lobes((maker(alpha),), wo), 1, wo, samples=fewer(2000, 200))
            for alpha in (1.5e-5, 1.4e-5)
        )
        assert sharp[2].any() and not smooth[2].any()
        assert (sharp[3] == smooth[3]).mean() > 0.99
        is_same = sharp[3] == smooth[3]
        # 1 of 1000 microfacets is tilted by more than 32 alpha.
        away = np.linalg.norm(sharp[0] - smooth[0], axis=1)[is_same]
        assert np.quantile(away, 0.99) < 1e-3
        np.testing.assert_allclose(sharp[1][is_same].mean(0), smooth[1][is_same].mean(0), rtol=1e-3)
