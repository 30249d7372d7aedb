"""A sky whose light is scattered more than once: Cycles' Multiple Scattering.

After F. Garcia Linan 2024, https://fgarlin.com/posts/2024-12-06-spectral_sky, with four wavelengths
and a fit of what is scattered more than once; steps are integrated as by Hillaire 2015, Physically
Based Sky, Atmosphere and Cloud Rendering in Frostbite. Lengths are in kilometres, radiance is in
CIE XYZ.
"""

from __future__ import annotations

import math

import numpy as np

from .atmosphere import Air, cos_from_sun, interpolate, solid_angle, table_places, way_out

# At 630, 560, 490 and 430 nm.
RADIUS, THICKNESS = 6371.0, 100.0
NUM_STEPS = 64
NUM_HEIGHTS, NUM_ANGLES = 64, 256  # of the table of transmittance
SUN_IRRADIANCE = np.array((1.679, 1.828, 1.986, 1.307))
MOLECULAR_SCATTERING = np.array((6.605e-3, 1.067e-2, 1.842e-2, 3.156e-2))  # 1/km
OZONE_CROSS_SECTION = np.array((3.472e-25, 3.914e-25, 1.349e-25, 1.103e-26))
AEROSOL_ABSORPTION = np.array((2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23))
AEROSOL_SCATTERING = np.array((1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22))
AEROSOL_G, GROUND_ALBEDO = 0.8, 0.3
SCATTERED_AGAIN = 0.02 * np.array((0.217, 0.347, 0.594, 1.0))
XYZ_FROM_FOUR = np.array(
    [[53.386918, 22.981338, 0.0], [43.904844, 71.347796, 0.10250687],
     [1.6137278, 18.42296, 31.742921], [20.762669, 2.3614213, 110.4801]]
)  # fmt: skip


def _coefficients(air: Air, height):
    """(molecules scatter, droplets scatter, all of extinction), 1/km, (..., 4); height: km."""
    height = np.maximum(height, 1e-4)[..., None]
    molecules = MOLECULAR_SCATTERING * np.exp(-0.07771971 * height**1.16364243) * air.air
    log = np.log(height)
    ozone = 3.78547397e20 * np.exp(-((log - 3.22261) ** 2) * 5.55555555 - log) * 334.5 * air.ozone
    droplets = (1.3681e20 * np.exp(-height / 0.73) + 2e6) * air.aerosol
    lost = molecules + ozone * OZONE_CROSS_SECTION
    lost = lost + droplets * (AEROSOL_ABSORPTION + AEROSOL_SCATTERING)
    return molecules, droplets * AEROSOL_SCATTERING, lost


def _transmittance(air: Air, radius, cos_sun):
    """(..., 4) of the way from some radius to the top, km."""
    step = way_out(radius * cos_sun, radius, RADIUS + THICKNESS) / NUM_STEPS
    depth = 0.0
    for i in range(NUM_STEPS):
        way = (i + 0.5) * step
        at_step = np.sqrt(radius**2 + 2 * way * radius * cos_sun + way**2)
        depth = depth + step[..., None] * _coefficients(air, at_step - RADIUS)[2]
    return np.exp(-depth)


def build_table(air: Air, sun_elevation: float) -> np.ndarray:
    """Light that is scattered once or more often, and what the ground throws back."""
    elevations, azimuths = table_places()
    rise, start = np.sin(elevations)[:, None], _start(air)
    mu = cos_from_sun(elevations[:, None], azimuths, sun_elevation)
    below = (start * rise) ** 2 - start**2 + RADIUS**2
    to_ground = -start * rise - np.sqrt(np.maximum(below, 0))
    to_top = way_out(start * rise, start, RADIUS + THICKNESS)
    step = np.where((below >= 0) & (rise < 0), to_ground, to_top) / NUM_STEPS
    molecular = 3 / (16 * np.pi) * (1 + mu**2)[..., None]
    droplet = (1 - AEROSOL_G**2) / (4 * np.pi)
    droplet = droplet / ((1 + AEROSOL_G**2 - 2 * AEROSOL_G * mu) ** 1.5)[..., None]
    to_sun = _SunTable(air)
    spectrum, left = 0.0, 1.0
    for i in range(NUM_STEPS):
        way = (i + 0.5) * step
        radius = np.sqrt(start**2 + 2 * way * start * rise + way**2)
        cos_sun = (start * math.sin(sun_elevation) + way * mu) / radius
        molecules, droplets, lost = _coefficients(air, radius - RADIUS)
        direct, again = to_sun.at(radius, cos_sun), to_sun.scattered(radius, cos_sun)
        source = molecules * (molecular * direct + again) + droplets * (droplet * direct + again)
        through = np.exp(-step[..., None] * lost)
        spectrum = spectrum + left * source * (1 - through) / np.maximum(lost, 1e-7)
        left = left * through
    return (spectrum * SUN_IRRADIANCE) @ XYZ_FROM_FOUR


def _start(air: Air):
    """Radius at which the viewer is."""
    return RADIUS + min(air.altitude, 99999.0) / 1000


class _SunTable:
    """Transmittance to the sun by height and by the sun's angle."""

    def __init__(self, air: Air):
        radius = RADIUS + THICKNESS * np.linspace(0, 1, NUM_HEIGHTS)[:, None]
        self.table = _transmittance(air, radius, np.linspace(-1, 1, NUM_ANGLES))

    def at(self, radius, cos_sun):
        """(..., 4) of places at some radius and angles of the sun there."""
        rows = (radius - RADIUS) / THICKNESS * (NUM_HEIGHTS - 1)
        return interpolate(self.table, rows, (cos_sun + 1) / 2 * (NUM_ANGLES - 1))

    def scattered(self, radius, cos_sun):
        """(..., 4) light from all sides, of that of the sun: from the ground, and from the air."""
        ones = np.ones_like(radius)
        away = 2 * np.pi * (1 - np.sqrt(np.maximum(0, 1 - (RADIUS / radius) ** 2)))
        upwards = self.at(RADIUS * ones, ones) / self.at(radius, ones)
        share = away * GROUND_ALBEDO / np.pi * cos_sun / (4 * np.pi)
        ground = share[..., None] * self.at(RADIUS * ones, cos_sun) * upwards
        return ground + SCATTERED_AGAIN / (1 + 5 * np.exp(-17.92 * cos_sun))[..., None]


def sun_radiance(air: Air, elevation: float, size: float) -> np.ndarray:
    """(3,) radiance of the disc at an elevation."""
    left = _transmittance(air, np.array(_start(air)), math.sin(elevation))
    return (SUN_IRRADIANCE * left / solid_angle(size)) @ XYZ_FROM_FOUR
