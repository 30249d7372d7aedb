"""A sky whose light is scattered once: Cycles' Single Scattering, up to 4.5 Nishita.

After Nishita et al. 1993, Display of the Earth Taking into Account Atmospheric Scattering, with 21
wavelengths and ozone. Lengths are in metres, radiance is in CIE XYZ.
"""

from __future__ import annotations

import math

import numpy as np

from .atmosphere import Air, cos_from_sun, solid_angle, table_places, way_out

RADIUS, TOP_RADIUS = 6360e3, 6420e3
NUM_STEPS = 32
WAVELENGTHS = np.arange(380.0, 781.0, 20.0)  # nm
RAYLEIGH = 5.42482e-5 * (380 / WAVELENGTHS) ** 4  # 1/m at the ground
MIE, MIE_EXTINCTION, MIE_G = 2e-5, 1.11 * 2e-5, 0.76
OZONE = 1e-9 * np.array(  # 1/m where it is densest
    [3.25127, 5.85395, 19.7719, 73.0957, 200.846, 403.840, 635.513, 967.070, 1547.97, 2090.39,
     2461.28, 2735.51, 2151.26, 1590.52, 1123.56, 735.276, 464.501, 330.961, 225.126, 148.791,
     168.286]
)  # fmt: skip
# The sun as a black body, W/(m^2 nm), by Planck's law; the solid angle is that of its disc.
SUN_SPECTRUM = (
    6.79016e-5 * 1.1910430e20 / WAVELENGTHS**5 / np.expm1(1.4387769e7 / (WAVELENGTHS * 5778))
)
# The colour matching functions of the CIE 1931 standard observer, times the step of wavelengths.
XYZ_FROM_SPECTRUM = 20.0 * np.array(
    [[0.001368, 0.000039, 0.006450], [0.01431, 0.000396, 0.06785], [0.13438, 0.0040, 0.6456],
     [0.34828, 0.0230, 1.74706], [0.2908, 0.0600, 1.6692], [0.09564, 0.13902, 0.81295],
     [0.0049, 0.3230, 0.2720], [0.06327, 0.7100, 0.07825], [0.2904, 0.9540, 0.0203],
     [0.5945, 0.9950, 0.0039], [0.9163, 0.8700, 0.00165], [1.0622, 0.6310, 0.0008],
     [0.85445, 0.3810, 0.00019], [0.4479, 0.1750, 0.00002], [0.1649, 0.0610, 0.0],
     [0.04677, 0.0170, 0.0], [0.011359, 0.004102, 0.0], [0.002899, 0.001047, 0.0],
     [0.00069, 0.000249, 0.0], [0.000166, 0.00006, 0.0], [0.0000415, 0.000015, 0.0]]
)  # fmt: skip


def build_table(air: Air, sun_elevation: float) -> np.ndarray:
    """Light that is scattered once; below the horizon what is there fades away."""
    # Cycles' table of 256 x 512 is half an entry off; up to 4.5 it was not below the horizon.
    elevations, azimuths = table_places(row_offset=0.0)
    is_sky = elevations >= 0
    xyz = _radiance(air, sun_elevation, elevations[is_sky, None], azimuths + np.pi / 512)
    fade = np.maximum(0, 1 + 2.5 * np.sin(elevations[~is_sky])) ** 3
    return np.concatenate([fade[:, None, None] * xyz[:1], xyz])


def _radiance(air: Air, sun_elevation: float, elevations, azimuths):
    """(rows, columns, 3); elevations: (rows, 1)."""
    mu, start = cos_from_sun(elevations, azimuths, sun_elevation), _start(air)
    step = way_out(start * np.sin(elevations), start, TOP_RADIUS) / NUM_STEPS
    molecules = 3 / (16 * np.pi) * (1 + mu**2)
    droplets = 3 * (1 - MIE_G**2) * (1 + mu**2) / (8 * np.pi * (2 + MIE_G**2))
    droplets = droplets / (1 + MIE_G**2 - 2 * MIE_G * mu) ** 1.5
    coefficients = np.array((RAYLEIGH, np.full_like(RAYLEIGH, MIE_EXTINCTION), OZONE))
    spectrum, depth = 0.0, 0.0
    for i in range(NUM_STEPS):
        way = (i + 0.5) * step
        radius = np.sqrt(start**2 + 2 * way * start * np.sin(elevations) + way**2)
        rise = start * math.sin(sun_elevation) + way * mu  # radius x cosine of the sun's angle
        density = _density(air, radius)
        depth = depth + step[..., None] * density
        is_dark = (sun_elevation < 0) & (rise**2 >= radius**2 - RADIUS**2)
        total = depth + _depth_to_sun(air, radius, rise)
        share = (molecules * density[..., 0])[..., None] * RAYLEIGH
        share = share + (droplets * density[..., 1])[..., None] * MIE
        lit = np.where(is_dark, 0.0, step)[..., None]
        spectrum = spectrum + lit * share * np.exp(-total @ coefficients)
    return (spectrum * SUN_SPECTRUM) @ XYZ_FROM_SPECTRUM


def _start(air: Air):
    """Radius at which the viewer is."""
    return RADIUS + min(air.altitude, 59999.0)


def _density(air: Air, radius):
    """(..., 3) molecules, droplets and ozone, over what they are at the ground or at most."""
    height = radius - RADIUS
    ozone = np.maximum(0, 1 - np.abs(height - 25000) / 15000)
    layers = np.stack([np.exp(-height / 8000), np.exp(-height / 1200), ozone], axis=-1)
    return layers * (air.air, air.aerosol, air.ozone)


def _depth_to_sun(air: Air, radius, rise):
    """(..., 3) densities integrated up to the top, by Gauss and Laguerre's rule."""
    length = way_out(rise, radius, TOP_RADIUS)
    nodes, weights = np.polynomial.laguerre.laggauss(8)
    depth = 0.0
    for node, weight in zip(nodes / 25, weights * np.exp(nodes) / 25, strict=True):
        way = node * length
        at_node = np.sqrt(radius**2 + 2 * way * rise + way**2)
        depth = depth + weight * _density(air, at_node)
    return depth * length[..., None]


def sun_radiance(air: Air, elevation: float, size: float) -> np.ndarray:
    """(3,) radiance of the disc at an elevation; it is not dimmed by ozone."""
    start = np.array(_start(air))
    depth = _depth_to_sun(air, start, start * math.sin(max(elevation, 0.0)))
    left = np.exp(-depth[0] * RAYLEIGH - depth[1] * MIE_EXTINCTION)
    return (SUN_SPECTRUM * left / solid_angle(size)) @ XYZ_FROM_SPECTRUM
