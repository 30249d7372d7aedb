"""Lobes of all kinds for tests, sampled and evaluated for many directions."""

import numpy as np
from core_scenes import fewer

from lighttree_core import lobes as lb
from lighttree_core.fresnel import f82_b_from_tint
from lighttree_core.jit import kernel
from lighttree_core.scene import ALL_RAYS
from lighttree_core.vec import load3, store3

NUM = fewer(20_000, 400)
UP = (0.0, 0.0, 1.0)
RED = (0.8, 0.3, 0.1)


def f32(x):
    return np.float32(x)


def vec3(a):
    return tuple(np.float32(x) for x in a)


def unit(*a):
    a = np.array(a, np.float64)
    return vec3(a / np.linalg.norm(a))


def towards(degrees, azimuth=0.0):
    theta, phi = np.radians(degrees), np.radians(azimuth)
    return vec3([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


@kernel
def _sample_all(lobes, num, n_geo, wo, u, wi, weight, pdf, ray_kind):
    for k in range(len(u)):
        w, value, pdf[k], ray_kind[k] = lb.sample_lobes(
            lobes, num, n_geo, wo, u[k, 0], (u[k, 1], u[k, 2])
        )
        store3(wi, k, w)
        store3(weight, k, value)


@kernel
def _eval_all(lobes, num, n_geo, wo, wi, rays, value, pdf):
    for k in range(len(wi)):
        f, pdf[k] = lb.eval_lobes(lobes, num, n_geo, wo, load3(wi, k), rays)
        store3(value, k, f)


def sample(lobes, num, wo, n_geo=UP, samples=NUM, seed=7):
    """(wi, weight, pdf, kinds of ray) of many samples."""
    u = np.random.default_rng(seed).random((samples, 3), np.float32)
    wi, weight = np.zeros((2, samples, 3), np.float32)
    pdf, ray_kind = np.zeros(samples, np.float32), np.zeros(samples, np.int64)
    _sample_all(lobes, num, vec3(n_geo), wo, u, wi, weight, pdf, ray_kind)
    return wi, weight, pdf, ray_kind


def evaluate(lobes, num, wo, wi, rays=ALL_RAYS):
    """(BSDF x |cos|, pdf) for many directions."""
    wi = np.ascontiguousarray(wi, np.float32)
    value, pdf = np.zeros((len(wi), 3), np.float32), np.zeros(len(wi), np.float32)
    _eval_all(lobes, num, vec3(UP), wo, wi, rays, value, pdf)
    return value, pdf


def sphere(rows, columns):
    """Directions in the middle of cells of the whole sphere, and the solid angles of the cells."""
    # Uniform in the angle to the normal, about which lobes of refracted light are narrow.
    edges = np.linspace(0, np.pi, rows + 1)
    theta, phi = (edges[1:] + edges[:-1]) / 2, (np.arange(columns) + 0.5) / columns * 2 * np.pi
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    s = np.sin(theta)
    wi = np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    return wi, np.repeat(-np.diff(np.cos(edges)) * 2 * np.pi / columns, columns)


GRID = sphere(fewer(400, 60), fewer(200, 40))
GRID_ERROR = fewer(4e-3, 0.05)  # of integrals over the lobes below


# What lobes are made of: each maker writes row i, seen from wo with the normal n.
def lambert(lobes, i, wo, n=UP, weight=RED):
    lb.set_diffuse(lobes, i, vec3(weight), vec3(n), f32(0), vec3(RED), wo)


def rough_matt(lobes, i, wo, n=UP, weight=RED):
    lb.set_diffuse(lobes, i, vec3(weight), vec3(n), f32(0.8), vec3(RED), wo)


def translucent(lobes, i, wo, n=UP, weight=RED):
    lb.set_translucent(lobes, i, vec3(weight), vec3(n))


def transparent(lobes, i, wo, n=UP, weight=RED):
    lb.set_transparent(lobes, i, vec3(weight))


def microfacet(alpha, ior=1.5, reflects=True, transmits=False, fresnel=None):
    def make(lobes, i, wo, n=UP, weight=(1, 1, 1)):
        lb.set_microfacet(
            lobes, i, vec3(weight), vec3(n), f32(alpha), f32(ior), reflects, transmits
        )
        if fresnel is not None:
            fresnel(lobes, i)

    return make


def schlick(lobes, i):
    tint = vec3([0.9, 1, 0.8])
    lb.set_fresnel_schlick(lobes, i, vec3([0.04, 0.06, 0.1]), tint, vec3([1, 0.5, 0.7]))


def f82(lobes, i):
    f0 = vec3(RED)
    lb.set_fresnel_f82(lobes, i, f0, f82_b_from_tint(f0, vec3([0.2, 0.9, 1])))


def mirror(alpha):
    return microfacet(alpha)


def glass(alpha, ior=1.5):
    return microfacet(alpha, ior, True, True, lb.set_fresnel_dielectric)


def refraction(alpha, ior=1.5):
    return microfacet(alpha, ior, False, True)


KINDS = {
    "lambert": lambert,
    "rough matt": rough_matt,
    "translucent": translucent,
    "mirror": mirror(0.3),
    "rough mirror": mirror(1.0),
    "metal": microfacet(0.4, fresnel=f82),
    "coat": microfacet(0.3, fresnel=schlick),
    "glass": glass(0.3),
    "rough glass": glass(1.0),
    "glass from inside": glass(0.4, 1 / 1.5),
    "tinted glass": microfacet(0.5, 1.3, True, True, schlick),
    "refraction": refraction(0.4),
    "refraction from inside": refraction(0.4, 1 / 1.33),
}
MIXTURES = {
    "plastic": (lambert, KINDS["coat"]),
    "coated glass": (KINDS["coat"], KINDS["rough glass"], KINDS["metal"]),
    "leaf": (KINDS["rough matt"], translucent, transparent, mirror(1e-5)),
    "sharp and rough": (mirror(1.5e-5), KINDS["rough mirror"], glass(1e-3), lambert),
}
ALL = {**{name: (make,) for name, make in KINDS.items()}, **MIXTURES}
WO = (towards(0), towards(35, 20), towards(80, 200))


def make_lobes(makers, wo, **options):
    """Lobes of a surface with the normal +Z."""
    lobes = lb.allocate_lobes()
    lb.set_shading_normal(lobes, vec3(UP))
    for i, make in enumerate(makers):
        make(lobes, i, wo, **options)
    return lobes
