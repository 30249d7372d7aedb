"""Lamps that rays meet on their way: each adds its light, and hides nothing.

The rays go through the shapes of `lamp_shapes.py`, from one to the next, up to what they hit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .direct_light import met_weight
from .jit import FAR, ZERO, f32, i32, kernel, table
from .lamp_shapes import NUM_FACES, behind_shape, counts, intersect_lamp
from .light_points import is_in_sun, light_radiance
from .vec import load3, scale, store3
from .waves import MEETS_LAMPS, RAY_KIND, add_found


@table
class LampRays(NamedTuple):
    """Rays that still look for lamps.

    path: (n,) int32 row of the wave. origin, direction: (n, 3), from behind the shape met last.
    reach: (n,) how far the shapes may lie from there. end: (n,) how far the ray goes in all.
    """

    path: i32[::1]
    origin: f32[:, ::1]
    direction: f32[:, ::1]
    reach: f32[::1]
    end: f32[::1]


def allocate_lamp_rays(size: int) -> LampRays:
    """Room for `size` rays."""
    return LampRays(
        np.zeros(size, np.int32),
        np.zeros((size, 3), np.float32),
        np.zeros((size, 3), np.float32),
        np.zeros(size, np.float32),
        np.zeros(size, np.float32),
    )


@kernel
def gather_lamp_rays(world, settings, wave, hits, num_paths, rays, samples, picks):
    """List the paths of a wave that look for lamps, and add the suns they see; how many."""
    num, lights = 0, world.sampler.lights
    for i in range(num_paths):
        if wave.flags[i] & MEETS_LAMPS == 0:
            continue
        end, direction = hits.distance[i], load3(wave.direction, i)
        if hits.triangle[i] < 0:
            end = FAR
            for light in lights.suns:
                if is_in_sun(lights, light, direction):
                    add_met(world, settings, wave, i, light, FAR, samples, picks)
        rays.path[num], rays.end[num] = i, end
        rays.reach[num] = end + world.lamp_shapes.slack
        store3(rays.origin, num, load3(wave.origin, i))
        store3(rays.direction, num, direction)
        num += 1
    return num


@kernel
def add_met(world, settings, wave, i, light, distance, samples, picks):
    """Add the light of a lamp that path i meets at some distance, if rays of its kind see it."""
    lights, direction = world.sampler.lights, load3(wave.direction, i)
    if lights.visible[light] & wave.flags[i] & RAY_KIND == 0:
        return
    weight = met_weight(world, settings, wave, i, light, distance, picks)
    if weight > ZERO:
        arriving = scale(light_radiance(lights, light, direction, distance), weight)
        add_found(samples, wave, i, arriving)


@kernel
def add_lamps_met(world, settings, wave, rays, met, num_rays, samples, picks):
    """Add the lamps whose shapes were met, and move the rays that go on to the front: how many."""
    num, shapes, lights = 0, world.lamp_shapes, world.sampler.lights
    for k in range(num_rays):
        triangle, i = met.triangle[k], rays.path[k]
        if triangle < 0:
            continue
        origin, direction = load3(wave.origin, i), load3(wave.direction, i)
        if counts(shapes, triangle, origin, direction):
            light, vertex = shapes.lamp[triangle // NUM_FACES], load3(wave.vertex, i)
            # A disk faces the vertex, wherever the ray went straight through since.
            distance = intersect_lamp(lights, light, vertex, direction) - wave.travelled[i]
            if ZERO < distance < rays.end[k]:
                add_met(world, settings, wave, i, light, distance, samples, picks)
        reach = rays.reach[k] - met.distance[k]
        if reach > ZERO:
            behind = behind_shape(shapes, triangle, met.u[k], met.v[k], direction)
            rays.path[num], rays.reach[num], rays.end[num] = i, reach, rays.end[k]
            store3(rays.origin, num, behind)
            store3(rays.direction, num, direction)
            num += 1
    return num
