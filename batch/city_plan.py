"""Where things stand in the city: a grid of streets, blocks between them, buildings on the blocks.

Numbers only; `city` builds what is planned here. Metres; x points east, y north, z up, and the
middle of the city is the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress
from math import ceil, sqrt

import numpy as np

from .shapes import EAST, NORTH, Face, sides

# A block is square, its sidewalks included; there are streets between the blocks and around them.
BLOCK, STREET, SIDEWALK, KERB = 48.0, 12.0, 3.0, 0.15
PITCH = BLOCK + STREET
ALLEY = 3.2
GROUND_FLOOR, FLOOR, PARAPET = 4.5, 3.2, 0.8
ROOF_EDGE = 1.2  # this much of a roof stays free along its edges
WALLS = ("brick", "concrete", "plaster", "stone")

# Street lamps decide: a block has places for twelve, and nine lights in a hundred are lamps.
LIGHTS_PER_BLOCK = 120

MIN_FLOORS, MAX_FLOORS, LANDMARK_FLOORS = 2, 16, 17


@dataclass
class Building:
    """wall: its material. boxes: body, tower if set back, then what stands on the roof.

    roof: the box whose top is the roof. facades: faces with rows of windows. shops: the ground
    floor's faces on a street.
    """

    wall: str
    boxes: list[np.ndarray]
    roof: np.ndarray
    facades: list[Face]
    shops: list[Face]


@dataclass
class Block:
    """edges: its four kerbs, as faces. alley_x: the middle of the gap that runs through it."""

    edges: list[Face]
    alley_x: float
    buildings: list[Building]


class CityPlan:
    """A city for so many lights.

    block_x, block_y, street_x, street_y: where the middles of blocks and streets are, ascending.
    blocks: as [column][row], columns counting east and rows north. landmark: the highest building,
    on the north-eastern corner of the first block; the rest of the city lies before it.
    """

    def __init__(self, num_lights: int, rng: np.random.Generator):
        # Rounded up, there are places enough; two each way, a street and a block to look at.
        num_blocks = num_lights / LIGHTS_PER_BLOCK
        columns = max(2, ceil(sqrt(num_blocks)))
        rows = max(2, ceil(num_blocks / columns))
        self.block_x = (np.arange(columns) - (columns - 1) / 2) * PITCH
        self.block_y = (np.arange(rows) - (rows - 1) / 2) * PITCH
        self.street_x = (np.arange(columns + 1) - columns / 2) * PITCH
        self.street_y = (np.arange(rows + 1) - rows / 2) * PITCH
        self.blocks = [[_plan_block(x, y, rng) for y in self.block_y] for x in self.block_x]

        site = self.blocks[0][0]
        low, high = site.buildings[-1].boxes[0][:, :2]
        on_street, on_alley = _surroundings(column=1, is_first=False, is_last=True)
        self.landmark = _plan_building(low, high, on_street, on_alley, LANDMARK_FLOORS, rng)
        site.buildings[-1] = self.landmark

    @property
    def all_blocks(self) -> list[Block]:
        """The blocks, column by column."""
        return [block for column in self.blocks for block in column]

    @property
    def buildings(self) -> list[Building]:
        """The buildings of all blocks."""
        return [building for block in self.all_blocks for building in block.buildings]

    def stretches(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Middle (3,) and unit direction (3,) of each piece of street between two crossings."""
        northward = [(np.array([x, y, 0]), NORTH) for x in self.street_x for y in self.block_y]
        eastward = [(np.array([x, y, 0]), EAST) for x in self.block_x for y in self.street_y]
        return northward + eastward


def _plan_block(x: float, y: float, rng: np.random.Generator) -> Block:
    """Two columns of adjoining buildings with an alley between them, around (x, y)."""
    # Off the middle, the alley does not line up with that of the next block.
    alley_x = x + rng.uniform(-4, 4)
    half = BLOCK / 2 - SIDEWALK
    columns = ((x - half, alley_x - ALLEY / 2), (alley_x + ALLEY / 2, x + half))
    buildings = []
    for column, (west, east) in enumerate(columns):
        num_lots = int(rng.integers(2, 4))
        walls = y + np.linspace(-half, half, num_lots + 1)
        walls[1:-1] += rng.uniform(-1, 1, num_lots - 1)
        for lot in range(num_lots):
            on_street, on_alley = _surroundings(column, lot == 0, lot == num_lots - 1)
            num_floors = int(rng.beta(1, 2.6) * (MAX_FLOORS - MIN_FLOORS + 1)) + MIN_FLOORS
            low, high = (west, walls[lot]), (east, walls[lot + 1])
            buildings.append(_plan_building(low, high, on_street, on_alley, num_floors, rng))
    half = BLOCK / 2
    return Block(sides((x - half, y - half, 0), (x + half, y + half, KERB)), alley_x, buildings)


def _surroundings(column: int, is_first: bool, is_last: bool):
    """Which sides (south, east, north, west) of a lot are on a street, and which on the alley.

    What is on neither is a wall shared with a neighbour.
    """
    on_street = (is_first, column == 1, is_last, column == 0)
    on_alley = (False, column == 0, False, column == 1)
    return on_street, on_alley


def _plan_building(
    low, high, on_street, on_alley, num_floors: int, rng: np.random.Generator
) -> Building:
    """A building on the lot from `low` to `high`, (x, y) each; high ones often with a tower."""
    has_tower = 8 <= num_floors <= MAX_FLOORS and rng.random() < 0.6
    base_floors = int(rng.integers(2, num_floors // 2 + 1)) if has_tower else num_floors

    top = GROUND_FLOOR + base_floors * FLOOR
    boxes = [np.array([(*low, 0), (*high, top + PARAPET)])]
    has_windows = np.logical_or(on_street, on_alley)
    shops = list(compress(sides((*low, 0), (*high, GROUND_FLOOR)), on_street))
    facades = list(compress(sides((*low, GROUND_FLOOR), (*high, top)), has_windows))

    if has_tower:
        inset = rng.uniform(2, 3)
        low, high = np.array(low) + inset, np.array(high) - inset
        foot = top + PARAPET
        top = foot + (num_floors - base_floors) * FLOOR
        boxes.append(np.array([(*low, foot), (*high, top + PARAPET)]))
        facades += sides((*low, foot), (*high, top))

    roof = boxes[-1]
    for _ in range(rng.integers(1, 4)):
        size = rng.uniform((2, 2, 1.5), (3.5, 3.5, 3.5))
        room = (roof[1] - roof[0] - size)[:2] - 2 * ROOF_EDGE
        corner = np.array([*(roof[0, :2] + ROOF_EDGE + room * rng.random(2)), roof[1, 2]])
        boxes.append(np.array([corner, corner + size]))
    return Building(str(rng.choice(WALLS)), boxes, roof, facades, shops)
