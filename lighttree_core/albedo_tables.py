"""Tables of the directional albedo of GGX: how much light a rough surface sends on.

Microfacets that shade each other lose light; closures make up for it by these albedos, and layers
let through what the layer above does not reflect. All are of a single bounce, with the
height-correlated Smith term (Heitz 2014), on the grids of Cycles, so that linear interpolation errs
as it does there. `albedo_tables.npz` holds them. To make it again:

    python -m lighttree_core.albedo_tables

Axes, each from 0 to 1: roughness = sqrt(alpha); mu, cosine of the view; z, with the index of
refraction (1 + z^2) / (1 - z^2). At its ends a grid holds the values of 1e-4 and, of z, 0.99.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .jit import ONE, ZERO, f32, kernel, table

FILE = Path(__file__).with_suffix(".npz")
FINE, COARSE = 32, 16


@table
class AlbedoTables(NamedTuple):
    """float32, C-contiguous, the axis of roughness last.

    reflected: (mu, roughness) of surfaces that reflect all. reflected_mean: (roughness), over all
    views, weighted by their cosine. glass: (2, z, mu, roughness) reflected and let through with
    dielectric Fresnel; 0 of the first axis: into the denser side, 1: out of it. glass_mean: (2, z,
    roughness). dielectric_blend: (z, mu, roughness) how far the Fresnel factor has gone from its
    value at normal incidence to 1, on average. schlick_blend: (mu, roughness) the same of
    Schlick's.
    """

    reflected: f32[:, ::1]
    reflected_mean: f32[::1]
    glass: f32[:, :, :, ::1]
    glass_mean: f32[:, :, ::1]
    dielectric_blend: f32[:, :, ::1]
    schlick_blend: f32[:, ::1]


def load_albedo_tables() -> AlbedoTables:
    """The tables of `albedo_tables.npz`."""
    with np.load(FILE, allow_pickle=False) as file:
        return AlbedoTables(*(file[name] for name in AlbedoTables._fields))


@kernel
def _grid_place(x, size):
    """(lower knot, share of the upper one) of x in 0 to 1 on a grid of so many knots."""
    # What is no number counts as 0: the table must not be read elsewhere.
    x = (min(x, ONE) if x > ZERO else ZERO) * np.float32(size - 1)
    knot = min(int(x), size - 2)
    return knot, x - np.float32(knot)


@kernel
def _lookup_1d(table, x):
    i, t = _grid_place(x, len(table))
    return (ONE - t) * table[i] + t * table[i + 1]


@kernel
def _lookup_2d(table, y, x):
    i, t = _grid_place(y, len(table))
    return (ONE - t) * _lookup_1d(table[i], x) + t * _lookup_1d(table[i + 1], x)


@kernel
def _lookup_3d(table, z, y, x):
    i, t = _grid_place(z, len(table))
    return (ONE - t) * _lookup_2d(table[i], y, x) + t * _lookup_2d(table[i + 1], y, x)


@kernel
def _ior_to_z(ior):
    return np.sqrt(abs((ior - ONE) / (ior + ONE)))


@kernel
def reflected_albedo(tables, roughness, mu):
    """(albedo seen from the cosine mu, its mean over all views) of a surface that reflects all."""
    return (
        _lookup_2d(tables.reflected, mu, roughness),
        _lookup_1d(tables.reflected_mean, roughness),
    )


@kernel
def glass_albedo(tables, roughness, ior, mu):
    """The same of glass, for all it reflects and lets through; ior: relative, seen from mu."""
    side = 1 if ior < ONE else 0
    z = _ior_to_z(ior)
    return (
        _lookup_3d(tables.glass[side], z, mu, roughness),
        _lookup_2d(tables.glass_mean[side], z, roughness),
    )


@kernel
def dielectric_blend(tables, roughness, ior, mu):
    """Share of f90 against f0 in what a dielectric reflects; of ior below 1 that of 1 / ior."""
    return _lookup_3d(tables.dielectric_blend, _ior_to_z(ior), mu, roughness)


@kernel
def schlick_blend(tables, roughness, mu):
    """Share of f90 against f0 in what a surface with Schlick's Fresnel factor reflects."""
    return _lookup_2d(tables.schlick_blend, mu, roughness)


# From here on: how the tables are made, in float64.
LATTICE = (17711, 10946)  # a Fibonacci lattice: number of points, generator
LATTICE_OF_MEANS = (4181, 2584)
NUM_VIEWS_OF_MEANS = 48


def visible_normals(alpha: float, mu: float, lattice: tuple) -> tuple[np.ndarray, np.ndarray]:
    """(cosines to the surface's normal, cosines to the view) of microfacets as a view meets them.

    Dupuy & Benyoub 2023, Sampling Visible GGX Normals with Spherical Caps.
    """
    num, generator = lattice
    u = (np.arange(num) + 0.5) / num
    phi = 2 * np.pi * (np.arange(num) * generator % num) / num
    sin_mu = np.sqrt(max(0.0, 1 - mu * mu))
    view = np.array([alpha * sin_mu, 0, mu])
    view /= np.linalg.norm(view)
    height = (1 - u) * (1 + view[2]) - view[2]
    radius = np.sqrt(np.maximum(0, 1 - height * height))
    x = alpha * (radius * np.cos(phi) + view[0])
    y = alpha * radius * np.sin(phi)
    z = height + view[2]
    inv_length = 1 / np.sqrt(x * x + y * y + z * z)
    return z * inv_length, (sin_mu * x + mu * z) * inv_length


def _smith_lambda(alpha, cos):
    return (np.sqrt(1 + alpha**2 * np.maximum(0, 1 / np.maximum(cos * cos, 1e-30) - 1)) - 1) / 2


def _unshaded(alpha, mu, cos):
    """Share of what visible microfacets send to the cosine that no other microfacet catches."""
    out = 1 + _smith_lambda(alpha, mu)
    return out / (out + _smith_lambda(alpha, cos))


def _fresnel(cos, ior):
    """(reflected share of unpolarized light, cosine of refraction) at a dielectric."""
    cos_t = np.sqrt(np.maximum(0, 1 - (1 - cos * cos) / ior**2))
    r_s = (cos - ior * cos_t) / (cos + ior * cos_t)
    r_p = (cos_t - ior * cos) / (cos_t + ior * cos)
    return (r_s**2 + r_p**2) / 2, cos_t


def _glass(alpha, mu, ior, cos_nh, cos_hi):
    """Share of light that glass of one roughness reflects or lets through."""
    if _is_air(ior):
        return 1.0
    fresnel, cos_t = _fresnel(cos_hi, ior)
    cos_reflected = 2 * cos_hi * cos_nh - mu
    cos_refracted = (cos_hi / ior - cos_t) * cos_nh - mu / ior
    # Light on its way out may be refracted back to the inner side. Cycles' tables count it, though
    # its closures, like ours, drop it: seen from inside, rough glass is a little too dark in both.
    return np.mean(
        fresnel * _unshaded(alpha, mu, cos_reflected) * (cos_reflected > 0)
        + (1 - fresnel) * _unshaded(alpha, mu, cos_refracted)
    )


def _is_air(ior):
    """Whether light goes straight on, past all microfacets."""
    return abs(ior - 1) < 1e-4


def _grid(size: int, last: float = 1.0) -> np.ndarray:
    return np.clip(np.arange(size) / (size - 1), 1e-4, last)


def _iors() -> np.ndarray:
    z_sq = _grid(COARSE, 0.99) ** 2
    return (1 + z_sq) / (1 - z_sq)


def make_albedo_tables() -> AlbedoTables:
    """Integrate all tables anew; about ten seconds."""
    shape = (COARSE, COARSE)
    tables = AlbedoTables(
        reflected=np.zeros((FINE, FINE)),
        reflected_mean=np.zeros(FINE),
        glass=np.zeros((2, COARSE, *shape)),
        glass_mean=np.zeros((2, COARSE, COARSE)),
        dielectric_blend=np.zeros((COARSE, *shape)),
        schlick_blend=np.zeros(shape),
    )
    for column, roughness in enumerate(_grid(FINE)):
        for row, mu in enumerate(_grid(FINE)):
            tables.reflected[row, column] = _reflected(roughness**2, mu, LATTICE)
        for mu, weight in _views():
            albedo = _reflected(roughness**2, mu, LATTICE_OF_MEANS)
            tables.reflected_mean[column] += weight * albedo
    for column, roughness in enumerate(_grid(COARSE)):
        for row, mu in enumerate(_grid(COARSE)):
            _fill_view(tables, row, column, roughness**2, mu)
        for mu, weight in _views():
            normals = visible_normals(roughness**2, mu, LATTICE_OF_MEANS)
            for z, ior in enumerate(_iors()):
                for side, relative in enumerate((ior, 1 / ior)):
                    albedo = _glass(roughness**2, mu, relative, *normals)
                    tables.glass_mean[side, z, column] += weight * albedo
    return AlbedoTables(*(np.clip(table, 0, 1).astype(np.float32) for table in tables))


def _views():
    """Cosines of views and the weights of a mean over them."""
    nodes, weights = np.polynomial.legendre.leggauss(NUM_VIEWS_OF_MEANS)
    mu = (nodes + 1) / 2
    return zip(mu, weights * mu, strict=True)


def _reflected(alpha, mu, lattice):
    cos_nh, cos_hi = visible_normals(alpha, mu, lattice)
    cos = 2 * cos_hi * cos_nh - mu
    return np.mean(_unshaded(alpha, mu, cos) * (cos > 0))


def _fill_view(tables, row, column, alpha, mu):
    """Fill one view of one roughness of the coarse tables."""
    cos_nh, cos_hi = visible_normals(alpha, mu, LATTICE)
    is_valid = 2 * cos_hi * cos_nh > mu
    for z, ior in enumerate(_iors()):
        for side, relative in enumerate((ior, 1 / ior)):
            tables.glass[side, z, row, column] = _glass(alpha, mu, relative, cos_nh, cos_hi)
        if _is_air(ior):
            continue
        f0 = ((ior - 1) / (ior + 1)) ** 2
        blend = np.clip((_fresnel(cos_hi, ior)[0] - f0) / (1 - f0), 0, 1)
        tables.dielectric_blend[z, row, column] = np.mean(blend * is_valid)
    tables.schlick_blend[row, column] = np.mean((1 - cos_hi) ** 5 * is_valid)


if __name__ == "__main__":
    np.savez_compressed(FILE, **make_albedo_tables()._asdict())
