"""Waves: bundles of paths, and of shadow rays, as arrays side by side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .jit import kernel
from .light_tree.importance import Gloss, Receiver
from .light_tree.sample import LightSampler, Picks, allocate_picks
from .lobes import Lobes, allocate_lobes
from .vec import load3, store3

# Bits of Wave.flags beside the kind of the ray, one of scene.CAMERA_RAY to TRANSMISSION_RAY.
RAY_KIND, TWO_SIDED, MEETS_LAMPS = 15, 16, 32


class Wave(NamedTuple):
    """Paths at one depth.

    slot: row of the path's radiance. flags: kind of the ray; TWO_SIDED, whether its last vertex
    chose lights on both sides; MEETS_LAMPS, whether the ray looks for lamps. bounce: how often it
    was scattered. passes: how often it went straight through a surface. vertex, n, pdf: where it
    was scattered last, the normal there and the density of its direction; pdf 0 for camera rays and
    directions without a density. wo, gloss: the Gloss there. travelled: from that vertex to
    `origin`, m.
    """

    slot: np.ndarray
    pixel: np.ndarray
    sample: np.ndarray
    flags: np.ndarray
    bounce: np.ndarray
    passes: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    vertex: np.ndarray
    n: np.ndarray
    wo: np.ndarray
    throughput: np.ndarray
    gloss: np.ndarray
    pdf: np.ndarray
    travelled: np.ndarray


class ShadowWave(NamedTuple):
    """Light that arrives unless something lies between origin and origin + to_light.

    passes: through how many transparent surfaces it may go.
    """

    slot: np.ndarray
    passes: np.ndarray
    origin: np.ndarray
    to_light: np.ndarray
    radiance: np.ndarray


class Scratch(NamedTuple):
    """What one thread needs while it shades a vertex."""

    picks: Picks
    lobes: Lobes


def allocate_wave(size: int) -> Wave:
    """Room for `size` paths."""
    return Wave(
        *(np.zeros(size, np.int32) for _ in range(6)),
        *(np.zeros((size, 3), np.float32) for _ in range(6)),
        np.zeros((size, 2), np.float32),
        *(np.zeros(size, np.float32) for _ in range(2)),
    )


@kernel
def load_gloss(feature, wave, i):
    """The Gloss at path i's last vertex, None where the scene has none."""
    if feature is None:
        return None
    return Gloss(load3(wave.wo, i), wave.gloss[i, 0], wave.gloss[i, 1])


@kernel
def load_receiver(feature, wave, i):
    """What path i chose lights for at its last vertex; feature: gloss."""
    two_sided = (wave.flags[i] & TWO_SIDED) != 0
    gloss = load_gloss(feature, wave, i)
    return Receiver(load3(wave.vertex, i), load3(wave.n, i), two_sided, gloss)


@kernel
def store_receiver(wave, i, receiver):
    """Write where path i chose lights last; its flags are to tell on which sides."""
    store3(wave.vertex, i, receiver.p)
    store3(wave.n, i, receiver.n)
    store_gloss(receiver.gloss, wave, i)


@kernel
def store_gloss(gloss, wave, i):
    """Write a Gloss, if the scene has any."""
    if gloss is not None:
        store3(wave.wo, i, gloss.wo)
        wave.gloss[i, 0], wave.gloss[i, 1] = gloss.alpha_sq, gloss.scale


def allocate_shadow_wave(size: int) -> ShadowWave:
    """Room for `size` shadow rays."""
    return ShadowWave(
        *(np.zeros(size, np.int32) for _ in range(2)),
        *(np.zeros((size, 3), np.float32) for _ in range(3)),
    )


def allocate_scratch(sampler: LightSampler, num_picks: int) -> Scratch:
    """Room for so many picked lights, and the lobes of one surface."""
    return Scratch(allocate_picks(sampler, num_picks), allocate_lobes())
