"""The Sky Texture -> an equirectangular image, as Cycles renders it.

Light of the sky is tabulated by elevation and by azimuth from the sun, with more rows near the
horizon, and looked up from there. The sun's disc is part of the image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from . import multiple_scattering, single_scattering
from .atmosphere import NUM_COLUMNS, NUM_ROWS, Air, cos_from_sun, interpolate

SUPER_SAMPLES = 8  # per side of a texel that the sun's disc may touch
EARTH_RADIUS_KM = 6371.0
RGB_FROM_XYZ = np.array(  # linear Rec.709
    [[3.2409699, -1.5373832, -0.4986108], [-0.9692436, 1.8759675, 0.0415551],
     [0.0556301, -0.2039770, 1.0569715]]
)  # fmt: skip


class _Model(NamedTuple):
    """table: of the sky without its sun; sun: radiance of the disc at an elevation."""

    table: Callable
    sun: Callable


_SINGLE = _Model(single_scattering.build_table, single_scattering.sun_radiance)
MODELS = {
    "NISHITA": _SINGLE,
    "SINGLE_SCATTERING": _SINGLE,
    "MULTIPLE_SCATTERING": _Model(
        multiple_scattering.build_table, multiple_scattering.sun_radiance
    ),
}


def sky_image(node) -> np.ndarray:
    """(H, W, 3) float32, laid out as in `Environment`, of a node whose type is one of MODELS."""
    model = MODELS[node.sky_type]
    aerosol = node.aerosol_density if hasattr(node, "aerosol_density") else node.dust_density
    air = Air(node.air_density, aerosol, node.ozone_density, max(1.0, node.altitude))
    # The sun moves on beyond the zenith.
    elevation = math.asin(math.sin(node.sun_elevation))
    azimuth = node.sun_rotation + (math.pi if math.cos(node.sun_elevation) < 0 else 0.0)
    size = node.sun_size if node.sun_disc else 0.0
    height = 1024 if size > 0 else 512
    rows = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    # Columns from +180 to -180 degrees about Z; the sun turns from +Y towards +X.
    columns = np.pi * (1 - (np.arange(2 * height) + 0.5) / height) - (np.pi / 2 - azimuth)
    xyz = _look_up(model.table(air, elevation), *np.meshgrid(rows, columns, indexing="ij"))
    if size > 0:
        ends = [model.sun(air, elevation + side * size / 2, size) for side in (-1, 1)]
        horizon = -math.acos(EARTH_RADIUS_KM / (EARTH_RADIUS_KM + air.altitude / 1000))
        disc = _Disc(elevation, size, horizon, *(node.sun_intensity * end for end in ends))
        _add_disc(xyz, rows, columns, disc)
    return np.maximum(xyz @ RGB_FROM_XYZ.T, 0).astype(np.float32)


def _look_up(table, elevations, azimuths):
    """(..., 3) of a table, between whose entries values are linear."""
    along = np.copysign(np.sqrt(np.abs(elevations) * 2 / np.pi), elevations)
    turned = np.abs((azimuths + np.pi) % (2 * np.pi) - np.pi)
    rows = (along + 1) / 2 * NUM_ROWS - 0.5
    return interpolate(table, rows, turned / np.pi * NUM_COLUMNS - 0.5)


class _Disc(NamedTuple):
    """The sun: its angles, below which elevation the ground hides it, radiance at both ends."""

    elevation: float
    size: float
    horizon: float
    bottom: np.ndarray
    top: np.ndarray

    def radiance(self, elevations, azimuths):
        """(..., 3); azimuths from the sun. Darker towards the limb, with the coefficient 0.6."""
        cos_away = np.clip(cos_from_sun(elevations, azimuths, self.elevation), -1, 1)
        away_sq = (np.arccos(cos_away) * 2 / self.size) ** 2
        limb = 0.4 + 0.6 * np.sqrt(np.maximum(0, 1 - away_sq))
        is_seen = (away_sq < 1) & (elevations > self.horizon)
        along = ((elevations - self.elevation) / self.size + 0.5)[..., None]
        color = (1 - along) * self.bottom + along * self.top
        return color * (limb * is_seen)[..., None]


def _add_disc(xyz, rows, columns, disc):
    """Add to each texel the mean of the disc over it."""
    texel = rows[1] - rows[0]
    reach = disc.size / 2 + texel
    near = np.flatnonzero(np.abs(rows - disc.elevation) < reach)
    part = (np.arange(SUPER_SAMPLES) + 0.5) / SUPER_SAMPLES - 0.5
    fine = (columns[:, None] + part * texel).ravel()
    for row in near:
        elevations = rows[row] + part * texel
        values = disc.radiance(*np.meshgrid(elevations, fine, indexing="ij"))
        xyz[row] += values.reshape(SUPER_SAMPLES, len(columns), SUPER_SAMPLES, 3).mean(axis=(0, 2))
