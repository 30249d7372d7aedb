"""What models of the sky share: the air, the table that they fill, ways through spheres."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

NUM_ROWS, NUM_COLUMNS = 256, 128  # of the table: the whole of elevations, half of azimuths


class Air(NamedTuple):
    """What a Sky Texture says of the atmosphere; densities are relative. altitude: metres."""

    air: float
    aerosol: float
    ozone: float
    altitude: float


def table_places(row_offset: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """(elevations of the table's rows, azimuths from the sun of its columns)."""
    along = (np.arange(NUM_ROWS) + row_offset) / NUM_ROWS * 2 - 1
    azimuths = (np.arange(NUM_COLUMNS) + 0.5) / NUM_COLUMNS * np.pi
    return np.copysign(along**2, along) * np.pi / 2, azimuths


def cos_from_sun(elevations, azimuths, sun_elevation: float) -> np.ndarray:
    """Cosine of the angle between a direction and the sun; azimuths: from the sun."""
    upright = np.sin(elevations) * math.sin(sun_elevation)
    return upright + np.cos(elevations) * math.cos(sun_elevation) * np.cos(azimuths)


def interpolate(table, rows, columns) -> np.ndarray:
    """Values between the entries of a table, and the nearest beyond its borders."""
    parts = []
    for places, num in zip((rows, columns), table.shape, strict=False):
        places = np.clip(places, 0, num - 1)
        low = np.minimum(places.astype(int), num - 2)
        parts.append((low, (places - low)[..., None]))
    (row, s), (column, t) = parts
    below = (1 - t) * table[row, column] + t * table[row, column + 1]
    above = (1 - t) * table[row + 1, column] + t * table[row + 1, column + 1]
    return (1 - s) * below + s * above


def way_out(rise, radius, top: float) -> np.ndarray:
    """How far it is to the sphere of radius `top` from one inside; rise: radius x cosine."""
    return -rise + np.sqrt(np.maximum(0, rise**2 + top**2 - radius**2))


def solid_angle(size: float) -> float:
    """Solid angle of a disc of some angular diameter."""
    return 4 * np.pi * math.sin(size / 4) ** 2
