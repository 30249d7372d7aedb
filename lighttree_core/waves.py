"""Waves: bundles of paths, and of shadow rays, as arrays side by side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .film import LIGHT_PASSES
from .jit import f32, i32, kernel, table
from .light_tree.importance import Gloss, Receiver
from .light_tree.sample import LightSampler, Picks, allocate_picks
from .lobes import Lobes, allocate_lobes
from .scene import ALL_RAYS
from .vec import add3, load3, mul, store3

# Bits of Wave.flags beside the kind of the ray, one of scene.CAMERA_RAY to TRANSMISSION_RAY.
RAY_KIND, TWO_SIDED, MEETS_LAMPS = ALL_RAYS, 16, 32


@table
class Wave(NamedTuple):
    """Paths at one depth.

    slot: row of the path's radiance. flags: kind of the ray; TWO_SIDED, whether its last vertex
    chose lights on both sides; MEETS_LAMPS, whether the ray looks for lamps. bounce: how often it
    was scattered. passes: how often it went straight through a surface. vertex, n, pdf: where it
    was scattered last, the normal there and the density of its direction; pdf 0 for camera rays and
    directions without a density. wo, gloss: the Gloss there. travelled: from that vertex to
    `origin`, m. matt_share: of the throughput, what matt lobes of the first surface scattered; 0
    unless light passes are wanted.
    """

    slot: i32[::1]
    pixel: i32[::1]
    sample: i32[::1]
    flags: i32[::1]
    bounce: i32[::1]
    passes: i32[::1]
    origin: f32[:, ::1]
    direction: f32[:, ::1]
    vertex: f32[:, ::1]
    n: f32[:, ::1]
    wo: f32[:, ::1]
    throughput: f32[:, ::1]
    matt_share: f32[:, ::1]
    gloss: f32[:, ::1]
    pdf: f32[::1]
    travelled: f32[::1]


@table
class ShadowWave(NamedTuple):
    """Light that arrives unless something lies between origin and origin + to_light.

    passes: through how many transparent surfaces it may go. bounce: how often it was scattered, the
    vertex here included. matt_share: as of a Wave.
    """

    slot: i32[::1]
    passes: i32[::1]
    bounce: i32[::1]
    origin: f32[:, ::1]
    to_light: f32[:, ::1]
    radiance: f32[:, ::1]
    matt_share: f32[:, ::1]


@table
class Samples(NamedTuple):
    """What samples have gathered, each in a row of its own, its slot.

    radiance: (n, 3). transparency: (n, 1) share of the background that a transparent film lets
    through. albedo: (n, 3) of the first surface. The others are empty unless light passes are
    wanted: emission: (n, 3) of what the camera sees; diffuse_direct, diffuse_indirect: light that
    matt lobes of the first surface scatter, after no other bounce and after more; diffuse_color:
    the albedo of these lobes.
    """

    radiance: f32[:, ::1]
    transparency: f32[:, ::1]
    albedo: f32[:, ::1]
    emission: f32[:, ::1]
    diffuse_direct: f32[:, ::1]
    diffuse_indirect: f32[:, ::1]
    diffuse_color: f32[:, ::1]


@table
class Scratch(NamedTuple):
    """What one thread needs while it shades a vertex."""

    picks: Picks
    lobes: Lobes


def allocate_wave(size: int) -> Wave:
    """Room for `size` paths."""
    return Wave(
        *(np.zeros(size, np.int32) for _ in range(6)),
        *(np.zeros((size, 3), np.float32) for _ in range(7)),
        np.zeros((size, 2), np.float32),
        *(np.zeros(size, np.float32) for _ in range(2)),
    )


@kernel
def load_receiver(wave, i):
    """What path i chose lights for at its last vertex."""
    two_sided = (wave.flags[i] & TWO_SIDED) != 0
    gloss = Gloss(load3(wave.wo, i), wave.gloss[i, 0], wave.gloss[i, 1])
    return Receiver(load3(wave.vertex, i), load3(wave.n, i), two_sided, gloss)


@kernel
def store_receiver(wave, i, receiver):
    """Write where path i chose lights last; its flags are to tell on which sides."""
    gloss = receiver.gloss
    store3(wave.vertex, i, receiver.p)
    store3(wave.n, i, receiver.n)
    store3(wave.wo, i, gloss.wo)
    wave.gloss[i, 0], wave.gloss[i, 1] = gloss.alpha_sq, gloss.scale


def allocate_shadow_wave(size: int) -> ShadowWave:
    """Room for `size` shadow rays."""
    return ShadowWave(
        *(np.zeros(size, np.int32) for _ in range(3)),
        *(np.zeros((size, 3), np.float32) for _ in range(4)),
    )


def allocate_samples(size: int, light_passes: bool) -> Samples:
    """Room for `size` samples."""
    rows = size if light_passes else 0
    return Samples(
        radiance=np.zeros((size, 3), np.float32),
        transparency=np.zeros((size, 1), np.float32),
        albedo=np.zeros((size, 3), np.float32),
        **{name: np.zeros((rows, 3), np.float32) for name in LIGHT_PASSES},
    )


def allocate_scratch(sampler: LightSampler, num_picks: int) -> Scratch:
    """Room for so many picked lights, and the lobes of one surface."""
    return Scratch(allocate_picks(sampler, num_picks), allocate_lobes())


@kernel
def has_light_passes(samples):
    """Whether the light of samples is told apart by where it comes from."""
    return len(samples.emission) > 0


@kernel
def add_light(samples, slot, light, bounce, matt_share):
    """Add light, scattered so often on its way to the camera, to a sample.

    matt_share: as of a Wave; of no account before the first bounce.
    """
    add3(samples.radiance, slot, light)
    if has_light_passes(samples):
        if bounce == 0:
            add3(samples.emission, slot, light)
        elif bounce == 1:
            add3(samples.diffuse_direct, slot, mul(light, matt_share))
        else:
            add3(samples.diffuse_indirect, slot, mul(light, matt_share))


@kernel
def add_found(samples, wave, i, light):
    """Add light that the ray of path i found to its sample."""
    light = mul(load3(wave.throughput, i), light)
    add_light(samples, wave.slot[i], light, wave.bounce[i], load3(wave.matt_share, i))
