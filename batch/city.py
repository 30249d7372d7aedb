"""A city at night after rain, with five kinds of light: windows, street lamps, neon signs, car
headlights and traffic lights, under a dim moon and sky.

Each kind of light first lists the places it could have in the plan, then takes as many as its
share of the lights; windows take what is left, so the count is exact. Lights of a kind and colour
share one light datablock, cars and posts one mesh; everything else is one mesh a material. What
there are more than 20,000 of, as in a city of a million lights, is instanced instead of copied.
"""

from __future__ import annotations

from math import radians
from typing import NamedTuple

import bpy
import numpy as np

from .city_plan import ALLEY, BLOCK, FLOOR, KERB, STREET, WALLS, CityPlan
from .shapes import (
    UP,
    Face,
    add_camera,
    box_quads,
    heading,
    looking,
    new_collection,
    new_light,
    new_material,
    new_mesh,
    place,
    place_all,
    set_shader,
)

SHARES = {"lamps": 0.09, "signs": 0.05, "headlights": 0.09, "traffic lights": 0.02}

# Albedo of what is matt.
SURFACES = {
    "paint-white": (0.60, 0.60, 0.56),
    "sidewalk": (0.40, 0.39, 0.37),
    "brick": (0.42, 0.20, 0.13),
    "concrete": (0.50, 0.49, 0.46),
    "plaster": (0.65, 0.57, 0.44),
    "stone": (0.33, 0.35, 0.39),
    "metal-dark": (0.06, 0.06, 0.07),
    "car-red": (0.40, 0.04, 0.03),
    "car-white": (0.60, 0.60, 0.60),
    "car-blue": (0.05, 0.10, 0.30),
}

# Inputs of a Principled BSDF: asphalt below water, a pane before a dark room, and that of a shop,
# which mirrors what two faces of glass do and lets the rest pass straight, so that lights behind it
# can still be sampled.
WET = {"Base Color": (0.09, 0.09, 0.095, 1), "Roughness": 0.4, "IOR": 1.33}
DARK_PANE = {"Base Color": (0.03, 0.035, 0.05, 1), "Roughness": 0.3, "IOR": 1.5}
SHOP_PANE = {"Base Color": (1, 1, 1, 1), "Metallic": 1.0, "Roughness": 0.3, "Alpha": 0.08}
PRINCIPLED = {"asphalt": WET, "glass-dark": DARK_PANE, "glass-shop": SHOP_PANE}


class Glow(NamedTuple):
    """A kind of lit window. radiance: W/(m^2 sr). share: of all lit windows."""

    name: str
    color: tuple[float, float, float]
    radiance: float
    share: float


HOMES = (
    Glow("warm-dim", (1.0, 0.60, 0.26), 0.35, 0.25),
    Glow("warm", (1.0, 0.66, 0.34), 1.0, 0.30),
    Glow("warm-bright", (1.0, 0.74, 0.46), 2.5, 0.12),
    Glow("cool-dim", (0.60, 0.78, 1.0), 0.3, 0.13),
    Glow("cool", (0.80, 0.92, 1.0), 1.0, 0.13),
    Glow("cool-bright", (0.90, 0.97, 1.0), 2.5, 0.07),
)
SHOPS = (
    Glow("shop-warm", (1.0, 0.80, 0.55), 2.5, 0.6),
    Glow("shop-cool", (0.92, 0.98, 1.0), 2.5, 0.4),
)

# Light settings: Blender's names, radians and metres. Spots and points: W; signs: W/m^2.
LAMP = {"spot_size": radians(70), "spot_blend": 0.3, "shadow_soft_size": 0.1}
HEADLIGHT = {"spot_size": radians(25), "spot_blend": 0.3, "shadow_soft_size": 0.08}
SIGN = {"shape": "RECTANGLE", "spread": radians(120)}
LAMP_ENERGY, HEADLIGHT_ENERGY, SIGNAL_ENERGY, SIGN_ENERGY_PER_AREA = 4500, 2000, 25, 40

LAMP_COLORS = {"sodium": (1.0, 0.58, 0.25), "mercury": (0.82, 0.95, 1.0)}
NEON_COLORS = {
    "red": (1.0, 0.05, 0.12),
    "cyan": (0.10, 0.90, 1.0),
    "pink": (1.0, 0.10, 0.80),
    "green": (0.20, 1.0, 0.25),
    "orange": (1.0, 0.45, 0.05),
}
HEADLIGHT_COLOR = (1.0, 0.93, 0.80)
SIGNAL_COLORS = {"red": (1.0, 0.06, 0.03), "amber": (1.0, 0.5, 0.04), "green": (0.08, 1.0, 0.45)}

# Metres. Signs hang between the shop windows and those of the first floor.
SIGN_SIZES, SIGN_HEIGHT = ((2.4, 0.7), (3.6, 0.8), (5.0, 0.9)), 3.75

# Boxes of what is instanced, facing east. The light hangs free, below or in front of the last one.
LAMP_POST = (
    ((-0.08, -0.08, 0), (0.08, 0.08, 8.0)),
    ((0.08, -0.05, 7.9), (1.5, 0.05, 8.0)),
    ((1.4, -0.15, 7.8), (2.0, 0.15, 8.0)),
)
SIGNAL_POST = (
    ((-0.06, -0.06, 0), (0.06, 0.06, 3.6)),
    ((0.06, -0.04, 3.3), (0.5, 0.04, 3.4)),
    ((0.5, -0.15, 2.7), (0.75, 0.15, 3.6)),
)
CAR = (
    ((-2.2, -0.9, 0.3), (2.2, 0.9, 0.85)),
    ((-1.7, -0.8, 0.85), (0.9, 0.8, 1.45)),
    *(((x, y, 0), (x + 0.6, y + 0.2, 0.6)) for x in (-1.7, 1.1) for y in (-0.92, 0.72)),
)


def build_city(num_lights: int, rng: np.random.Generator) -> None:
    """Fill the open file with a city of `num_lights` lights, moon and sky not counted."""
    city = CityPlan(num_lights, rng)
    num = {kind: round(share * num_lights) for kind, share in SHARES.items()}
    num["headlights"] -= num["headlights"] % 2
    num_windows = num_lights - sum(num.values())

    surfaces = {
        name: new_material(name, "ShaderNodeBsdfDiffuse", Color=(*albedo, 1))
        for name, albedo in SURFACES.items()
    } | {
        name: new_material(name, "ShaderNodeBsdfPrincipled", **inputs)
        for name, inputs in PRINCIPLED.items()
    }
    _add_streets(city, surfaces)
    _add_buildings(city, surfaces, rng)
    _add_windows(city, num_windows, surfaces, rng)
    # In the order of their names, see `place_all`.
    _add_cars(city, num["headlights"] // 2, surfaces, rng)
    _add_lamps(city, num["lamps"], surfaces, rng)
    _add_signs(city, num["signs"], surfaces, rng)
    _add_traffic_lights(city, num["traffic lights"], surfaces, rng)
    _add_sky()
    _add_cameras(city)


def _add_streets(city: CityPlan, surfaces: dict) -> None:
    """Asphalt under everything, a slab for each block, and dashes between the lanes."""
    x, y = city.street_x[-1] + BLOCK, city.street_y[-1] + BLOCK
    asphalt = np.array([[(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]])
    slabs = [
        (south.corner, north.corner + KERB * UP)
        for south, _, north, _ in (block.edges for block in city.all_blocks)
    ]
    dashes = []
    for middle, along in city.stretches():
        left = 0.08 * np.cross(UP, along)
        for start in np.arange(-BLOCK / 2, BLOCK / 2, 6):
            a = middle + start * along + 0.01 * UP
            b = a + 3 * along
            dashes.append((a - left, b - left, b + left, a + left))
    streets = new_collection("streets")
    for name, quads, surface in (
        ("asphalt", asphalt, "asphalt"),
        ("sidewalks", box_quads(slabs), "sidewalk"),
        ("lane dashes", np.array(dashes), "paint-white"),
    ):
        place(streets, name, new_mesh(name, quads, surfaces[surface]))


def _add_buildings(city: CityPlan, surfaces: dict, rng: np.random.Generator) -> None:
    """The buildings, one mesh for each material of walls, and bins along the alleys."""
    buildings = new_collection("buildings")
    for wall in WALLS:
        boxes = [box for house in city.buildings if house.wall == wall for box in house.boxes]
        quads = box_quads(np.reshape(boxes, (-1, 2, 3)))
        place(buildings, wall, new_mesh(wall, quads, surfaces[wall]))

    bins = []
    for block in city.all_blocks:
        south = block.edges[0].corner[1]
        for start in range(4, 40, 11):
            left = block.alley_x - 0.4 + rng.choice((-1, 1)) * (ALLEY / 2 - 0.4)
            low = np.array([left, south + start, KERB])
            bins.append((low, low + np.array([0.8, rng.uniform(1, 2), rng.uniform(0.9, 1.4)])))
    place(buildings, "bins", new_mesh("bins", box_quads(bins), surfaces["metal-dark"]))


def _add_windows(city: CityPlan, num_lit: int, surfaces: dict, rng: np.random.Generator) -> None:
    """Windows on all facades, dark ones in one mesh and `num_lit` lit ones in another.

    Those of shops are behind panes.
    """
    homes, shops, panes, rates = [], [], [], []
    for house in city.buildings:
        awake = 0.15 + rng.exponential()
        width = rng.uniform(1.8, 3.0)
        bay = width + rng.uniform(0.8, 1.6)
        for face in house.facades:
            homes.append(_window_quads(face, bay, (width, 1.8), 0.9))
            rates.append(np.full(len(homes[-1]), awake))
        for face in house.shops:
            shops.append(_window_quads(face, 4.0, (3.0, 2.3), 0.6))
            panes.append(_window_quads(face, 4.0, (3.0, 2.3), 0.6, out=0.08))
            rates.append(np.full(len(shops[-1]), 5.0))
    num_homes = sum(map(len, homes))
    quads = np.concatenate(homes + shops)
    rates = np.concatenate(rates)

    # Alarm clocks of these rates: the first to ring are a weighted draw without replacement.
    rings_first = np.argsort(rng.exponential(size=len(quads)) / rates)
    lit, dark = rings_first[:num_lit], rings_first[num_lit:]
    home_glow = rng.choice(len(HOMES), num_lit, p=[glow.share for glow in HOMES])
    shop_glow = rng.choice(len(SHOPS), num_lit, p=[glow.share for glow in SHOPS])
    glow_id = np.where(lit < num_homes, home_glow, len(HOMES) + shop_glow)

    glows = []
    for name, color, radiance, _share in HOMES + SHOPS:
        glow = new_material(name, "ShaderNodeEmission", Color=(*color, 1), Strength=radiance)
        # The back shines on a wall 3 cm away: no light worth sampling.
        glow.cycles.emission_sampling = "FRONT"
        glows.append(glow)
    windows = new_collection("windows")
    place(windows, "windows lit", new_mesh("windows lit", quads[lit], *glows, material_ids=glow_id))
    place(windows, "windows dark", new_mesh("windows dark", quads[dark], surfaces["glass-dark"]))
    shop_panes = np.concatenate(panes)
    place(windows, "shop panes", new_mesh("shop panes", shop_panes, surfaces["glass-shop"]))


def _window_quads(
    face: Face, bay: float, size: tuple[float, float], sill: float, out: float = 0.03
) -> np.ndarray:
    """One window (width, height) per floor and bay of a face, `out` before it: (n, 4, 3)."""
    num_bays = int((face.width - 1) // bay)
    right = face.width / 2 + (np.arange(num_bays) - num_bays / 2) * bay + (bay - size[0]) / 2
    up = np.arange(max(1, round(face.height / FLOOR))) * FLOOR + sill
    return face.quads(np.tile(right, len(up)), np.repeat(up, len(right)), *size, out)


def _add_cars(city: CityPlan, num_cars: int, surfaces: dict, rng: np.random.Generator) -> None:
    """Cars on the right of the road, two headlights each just in front of the body."""
    cars = new_collection("cars")
    paints = [
        new_mesh(name, box_quads(CAR), surfaces[name])
        for name in ("car-red", "car-white", "car-blue", "metal-dark")
    ]
    headlight = new_light("headlight", "SPOT", HEADLIGHT_COLOR, HEADLIGHT_ENERGY, **HEADLIGHT)
    places = [
        (middle + start * ahead, ahead)
        for middle, along in city.stretches()
        for ahead in (along, -along)
        for start in (-18, -6, 6, 18)
    ]
    bodies, headlights = [], []
    for middle, ahead in _draw(places, num_cars, rng):
        right = np.cross(ahead, UP)
        car = middle + STREET / 4 * right + rng.uniform(-3, 3) * ahead
        bodies.append((paints[rng.integers(len(paints))], car, heading(ahead)))
        for across in (-0.6, 0.6):
            position = car + 2.3 * ahead + across * right + 0.65 * UP
            headlights.append((headlight, position, looking(ahead - 0.05 * UP)))
    place_all(cars, "car", bodies)
    place_all(cars, "headlight", headlights)


def _add_lamps(city: CityPlan, num_lamps: int, surfaces: dict, rng: np.random.Generator) -> None:
    """Street lamps along the kerbs, shining straight down from an arm over the street."""
    lamps = new_collection("lamps")
    post = new_mesh("lamp post", box_quads(LAMP_POST), surfaces["metal-dark"])
    bulbs = [
        new_light(f"lamp-{name}", "SPOT", color, LAMP_ENERGY, **LAMP)
        for name, color in LAMP_COLORS.items()
    ]
    places = []
    for block in city.all_blocks:
        bulb = bulbs[rng.integers(len(bulbs))]
        for kerb in block.edges:
            places += [(kerb, right, bulb) for right in (8, 24, 40)]
    posts, lit = [], []
    for kerb, right, bulb in _draw(places, num_lamps, rng):
        posts.append((post, kerb.at(right, KERB, -0.5), heading(kerb.normal)))
        lit.append((bulb, kerb.at(right, KERB + 7.6, 1.2), looking(-UP)))
    place_all(lamps, "lamp post", posts)
    place_all(lamps, "lamp", lit)


def _add_signs(city: CityPlan, num_signs: int, surfaces: dict, rng: np.random.Generator) -> None:
    """Neon signs between the shops and the first floor, each in front of a dark board."""
    signs = new_collection("signs")
    panels = []
    for name, color in NEON_COLORS.items():
        for width, height in SIGN_SIZES:
            energy = SIGN_ENERGY_PER_AREA * width * height
            size = {"size": width, "size_y": height}
            panels.append(new_light(f"sign-{name}-{width}", "AREA", color, energy, **SIGN, **size))
    # Shopping streets run north, so that signs are many where there are any.
    shops = (face for house in city.buildings for face in house.shops if face.normal[0] != 0)
    places = []
    for face in shops:
        num = int(face.width // 7)
        places += [(face, (i + 0.5) / num * face.width) for i in range(num)]

    lit, boards, frames = [], [], []
    for face, right in _draw(places, num_signs, rng):
        panel = panels[rng.integers(len(panels))]
        lit.append((panel, face.at(right, SIGN_HEIGHT, 0.25), looking(face.normal)))
        across = right + np.array([-1, 1]) * (panel.size / 2 + 0.1)
        up = SIGN_HEIGHT + np.array([-1, 1]) * (panel.size_y / 2 + 0.1)
        boards.append(face.box(across, up, (0, 0.2)))
        # A rim to catch the colour: cameras do not see the light itself.
        frames += [face.box(across, (edge - 0.05, edge + 0.05), (0.2, 0.5)) for edge in up]
        frames += [face.box((edge - 0.05, edge + 0.05), up, (0.2, 0.5)) for edge in across]
    place_all(signs, "sign", lit)
    place(signs, "boards", new_mesh("boards", box_quads(boards), surfaces["metal-dark"]))
    place(signs, "frames", new_mesh("frames", box_quads(frames), surfaces["paint-white"]))


def _add_traffic_lights(city: CityPlan, num_lights: int, surfaces: dict, rng) -> None:
    """Posts at the corners of the blocks, each with the one signal that is lit."""
    collection = new_collection("traffic lights")
    post = new_mesh("traffic light", box_quads(SIGNAL_POST), surfaces["metal-dark"])
    signals = [
        new_light(f"signal-{name}", "POINT", color, SIGNAL_ENERGY, shadow_soft_size=0.1)
        for name, color in SIGNAL_COLORS.items()
    ]
    corners = [kerb for block in city.all_blocks for kerb in block.edges]
    posts, lit = [], []
    for kerb in _draw(corners, num_lights, rng):
        posts.append((post, kerb.at(0.6, KERB, -0.6), heading(kerb.normal)))
        signal = signals[rng.choice(len(signals), p=(0.45, 0.1, 0.45))]
        lit.append((signal, kerb.at(0.6, KERB + 3.1, 0.4)))
    place_all(collection, "signal post", posts)
    place_all(collection, "signal", lit)


def _draw(places: list, num: int, rng: np.random.Generator) -> list:
    """`num` of the places, each at most once."""
    return [places[i] for i in rng.choice(len(places), num, replace=False)]


def _add_sky() -> None:
    """A moon half a degree wide and a sky, enough to tell roofs from the night."""
    moon = new_light("moon", "SUN", (0.6, 0.72, 1.0), 0.02, angle=radians(0.5))
    place(bpy.context.scene.collection, "moon", moon, (0, 0, 100), looking((0.5, 0.6, -1)))
    world = bpy.data.worlds.new("night")
    night = {"Color": (0.45, 0.6, 1.0, 1), "Strength": 0.005}
    set_shader(world, "ShaderNodeOutputWorld", "ShaderNodeBackground", night)
    bpy.context.scene.world = world


def _add_cameras(city: CityPlan) -> None:
    """`street` between two lanes, `roof` over a corner of the highest roof, `alley` in an alley.

    None can be inside anything: nothing stands between the lanes or in the middle of an alley,
    nothing rises above the highest roof, and what is on that roof keeps away from its edges.
    """
    column, row = len(city.block_x) // 2, (len(city.block_y) - 1) // 2
    street = np.array([city.street_x[column] - 0.6, city.street_y[0] + 8, 2.1])
    add_camera("street", street, (0.02, 1, 0.08), 24)

    corner = city.landmark.roof[1]
    add_camera("roof", corner + 1.7 * UP, (0.36, 1, -0.55), 24)

    alley = np.array([city.blocks[column][row].alley_x, city.block_y[row] - 16, 1.7])
    add_camera("alley", alley, (0, 1, 0.12), 22)
    bpy.context.scene.camera = bpy.data.objects["street"]
