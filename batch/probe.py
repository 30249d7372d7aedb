"""How much noise each way to choose lights makes, computed at points of a scene, not rendered.

At surface points that the camera sees, and at as many after one diffuse bounce, every light of the
scene is integrated: its irradiance f, and the part fV of it that nothing blocks. The variance with
which a sampler estimates the sum of fV then follows without noise of its own: for one light a point
from the probabilities, sum (fV)^2 / p - (sum fV)^2; for several, which depend on each other, over
many places of the one random number that they share. It is divided by the squared sum. Points on
lights and albedo add no variance here, so this judges the choice of lights alone.

Cost is the time of a choice plus, for each light chosen, that of a point on it and a shadow ray.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lighttree_core import Scene, Settings
from lighttree_core.compilation import compile_kernels
from lighttree_core.jit import kernel
from lighttree_core.light_tree.importance import matt_receiver
from lighttree_core.light_tree.options import TreeOptions
from lighttree_core.light_tree.sample import (
    POWER,
    UNIFORM,
    LightSampler,
    allocate_picks,
    build_sampler,
    expected_picks,
    sample_lights,
)
from lighttree_core.lights import NO_LIGHT, LightBounds, bound_lights
from lighttree_core.rays import Tracer
from lighttree_core.vec import load3
from lighttree_core.world import World, build_world

from .cycles_build import build_cycles_tree
from .cycles_style import allocate_shares, choose_cycles_wave, expect_cycles_wave
from .methods import InputError
from .probe_points import contributions, shine_wave, surface_points
from .process import Progress
from .single import export_blend
from .views import AS_SAVED, View

NUM_POINTS = 200  # that the camera sees, and as many after a bounce
NUM_PICKS = (1, 4, 16)
# Places of the random number at which the choices at one point are looked at.
NUM_PLACES = 1024
# Points darker than this share of the mean are left out: their relative variance is of no account.
DARK_SHARE = 0.02
NUM_TIMED, NUM_RUNS = 4096, 9
# Standard errors by which an estimate may miss the exact sum, and share of it lost to rounding.
MOST_ERRORS, MOST_LOST = 5, 1e-4


class Candidate(NamedTuple):
    """A way to choose lights.

    choose: (p, n, u, light, expected) fills the last two, (m, num_picks), for m points; where no
    light is chosen light is NO_LIGHT. expect: (p, n, light, expected) fills the last for some
    lights of one point. An oracle has neither, only a variance.
    """

    name: str
    num_picks: int
    choose: Callable[..., None] | None = None
    expect: Callable[..., None] | None = None

    @property
    def label(self) -> str:
        return self.name if self.num_picks == 1 else f"{self.name}, {self.num_picks} picks"


class Probe(NamedTuple):
    """The outcome.

    rows: one a sampler, as probe.csv has them. labels: of the rows. relative_variance: (rows, k) at
    the k points that are not too dark. visible: share of irradiance that nothing blocks. ray_ns:
    time of a point on a light and a shadow ray to it.
    """

    rows: list[dict]
    labels: list[str]
    relative_variance: np.ndarray
    num_points: int
    num_lights: int
    visible: float
    ray_ns: float


def load_scene(file: Path, progress: Progress, view: View = AS_SAVED) -> Scene:
    """What is seen of a .blend, or an exported scene; checked."""
    with tempfile.TemporaryDirectory() as folder:
        if file.suffix.lower() != ".npz":
            exported = Path(folder, "scene.npz")
            export_blend(file, exported, progress, view)
            file = exported
        scene = Scene.load(file)
    scene.check()
    return scene


def run_probe(
    file: Path,
    num_points: int,
    seed: int,
    tree: Sequence[str],
    threads: int,
    progress: Progress,
    view: View = AS_SAVED,
) -> Probe:
    """Judge all samplers at points of one scene, and LightTree again with other options if given.

    num_points: camera hits, and as many after a bounce. tree: "name=value" texts of `TreeOptions`.
    view: of a .blend.
    """
    options = read_options(tree)
    scene = load_scene(file, progress, view)
    settings = Settings(seed=seed, threads=threads)
    settings.check()
    compile_kernels(progress)
    progress(0.0, "Building the samplers")
    world, tracer = build_world(scene, settings), Tracer(scene.vertices, scene.triangles)
    bounds = bound_lights(world.sampler.lights)
    if not np.any(bounds.flux > 0):
        raise InputError(f"{file}: the scene has no light.")
    p, n = surface_points(scene.camera, world, tracer, num_points, seed)
    if len(p) == 0:
        raise InputError(f"{file}: the camera sees no surface that reflects light.")
    candidates = list(list_candidates(world.sampler, bounds, tree, options, settings.num_threads))
    choose_ns, ray_ns = time_choices(candidates, world, tracer, p, n)

    def judge(i: int) -> tuple[float, float, np.ndarray]:
        f, seen = contributions(world, tracer, p[i], n[i], i)
        places = (np.arange(NUM_PLACES) + np.random.default_rng((seed, i)).random()) / NUM_PLACES
        judged = [judge_point(each, p[i], n[i], f, seen, places) for each in candidates]
        return f.sum(), seen.sum(), np.array(judged)

    results = []
    with ThreadPoolExecutor(settings.num_threads) as pool:
        for result in pool.map(judge, range(len(p))):
            results.append(result)
            progress(len(results) / len(p), f"Point {len(results)} of {len(p)}")
    unblocked, exact, judged = map(np.array, zip(*results, strict=True))
    is_bright = np.abs(exact) > DARK_SHARE * np.abs(exact).mean()
    if not is_bright.any():
        raise InputError(f"{file}: no light reaches what the camera sees.")
    judged = judged[is_bright].transpose(1, 2, 0)
    about = {"scene": file.stem, "points": len(p), "lights": len(bounds.flux), "seed": seed}
    rows = map(partial(summarize, ray_ns=ray_ns), candidates, judged, choose_ns)
    return Probe(
        rows=[row | about for row in rows],
        labels=[each.label for each in candidates],
        relative_variance=judged[:, 0],
        num_points=len(p),
        num_lights=len(bounds.flux),
        visible=exact.sum() / unblocked.sum(),
        ray_ns=ray_ns,
    )


def read_options(tree: Sequence[str]) -> TreeOptions | None:
    """Tree options from "name=value" texts, or None if there are none."""
    try:
        return TreeOptions.parse(list(tree)) if tree else None
    except ValueError as error:
        raise InputError(f"--tree {error}.") from None


def list_candidates(
    tree: LightSampler,
    bounds: LightBounds,
    texts: Sequence[str],
    options: TreeOptions | None,
    threads: int,
) -> Iterator[Candidate]:
    """All that are judged; tree: LightTree as shipped; texts, options: of another tree, if any."""
    trees = {"lighttree": tree}
    if options:
        trees[" ".join(texts)] = build_sampler(
            tree.lights, bounds, options=options, threads=threads
        )
    for name, sampler in trees.items():
        for num in NUM_PICKS:
            yield _candidate(name, sampler, num)
    for name in (POWER, UNIFORM):
        yield _candidate(name, build_sampler(tree.lights, bounds, name), 1)
    cycles = build_cycles_tree(tree.lights, bounds)
    yield Candidate(
        "cycles-style",
        1,
        lambda *wave: choose_cycles_wave(cycles, allocate_shares(cycles), *wave),
        lambda *wave: expect_cycles_wave(cycles, allocate_shares(cycles), *wave),
    )
    yield Candidate("oracle p ~ f", 1)


def _candidate(name: str, sampler: LightSampler, num: int) -> Candidate:
    return Candidate(
        name,
        num,
        lambda *wave: choose_wave(sampler, allocate_picks(sampler, num), num, *wave),
        lambda *wave: expect_wave(sampler, allocate_picks(sampler, num), num, *wave),
    )


@kernel
def choose_wave(sampler, picks, num, p, n, u, light, expected):
    """Choose up to num lights for each of m points; light, expected: (m, num)."""
    for i in range(len(u)):
        receiver = matt_receiver(load3(p, i), load3(n, i))
        count = sample_lights(sampler, receiver, num, u[i], picks)
        for k in range(num):
            light[i, k] = picks.light[k] if k < count else NO_LIGHT
            expected[i, k] = picks.expected[k]


@kernel
def expect_wave(sampler, picks, num, p, n, light, expected):
    """Fill expected with how often each of some lights is to be expected among the picks."""
    for i in range(len(light)):
        expected[i] = expected_picks(sampler, light[i], matt_receiver(p, n), num, picks)


def judge_point(
    candidate: Candidate, p: np.ndarray, n: np.ndarray, f, seen, places: np.ndarray
) -> tuple[float, float, float, float, float]:
    """(relative variance, mean estimate / exact, lights, dead choices, light missed) at one point.

    seen: fV of all lights. places: of the random number.
    """
    exact, lit = seen.sum(), np.flatnonzero(seen)
    if exact == 0:
        return 0.0, 1.0, 0.0, 0.0, 0.0
    if candidate.choose is None:
        variance = np.abs(f).sum() * (seen[lit] ** 2 / np.abs(f[lit])).sum() - exact**2
        return max(0.0, variance) / exact**2, 1.0, 1.0, 0.0, 0.0
    probability = np.zeros(len(lit))
    candidate.expect(tuple(p), tuple(n), lit, probability)
    is_found = probability > 0
    light = np.empty((len(places), candidate.num_picks), np.int32)
    expected = np.empty(light.shape)
    wave = np.tile(p, (len(places), 1)), np.tile(n, (len(places), 1))
    candidate.choose(*wave, places, light, expected)
    is_chosen = light != NO_LIGHT
    estimates = np.divide(seen[light], expected, out=np.zeros(light.shape), where=is_chosen).sum(1)
    variance = np.mean((estimates - exact) ** 2)
    if candidate.num_picks == 1:
        found = seen[lit][is_found]
        variance = max(0.0, (found**2 / probability[is_found]).sum() - found.sum() ** 2)
    return (
        variance / exact**2,
        estimates.mean() / exact,
        is_chosen.sum(1).mean(),
        1 - is_chosen.any(1).mean(),
        np.abs(seen[lit][~is_found]).sum() / np.abs(seen).sum(),
    )


def time_choices(
    candidates: Sequence[Candidate], world: World, tracer: Tracer, p: np.ndarray, n: np.ndarray
) -> tuple[list[float], float]:
    """Nanoseconds of each candidate's choice, and of a point on a light and a shadow ray to it.

    On one thread, points in random order so that caches help no more than they must; the median of
    several runs, in turns so that a disturbance spares none.
    """
    rng = np.random.default_rng(0)
    order = np.resize(rng.permutation(len(p)), NUM_TIMED)
    p, n, u = p[order], n[order], rng.random(NUM_TIMED)

    def choose(candidate: Candidate) -> np.ndarray:
        light = np.empty((NUM_TIMED, candidate.num_picks), np.int32)
        candidate.choose(p, n, u, light, np.empty(light.shape))
        return light[:, 0]

    light = choose(candidates[0])
    p_ray, n_ray, light = (a[light != NO_LIGHT] for a in (p, n, light))
    num_rays = len(light)
    irradiance, to_light = np.empty(num_rays, np.float32), np.empty((num_rays, 3), np.float32)

    def trace() -> None:
        shine_wave(world, 0, p_ray, n_ray, light, np.arange(num_rays), irradiance, to_light)
        tracer.occluded(p_ray, to_light)

    tasks = [partial(choose, each) if each.choose else lambda: None for each in candidates]
    seconds = [[_seconds(task) for task in (*tasks, trace)] for _ in range(1 + NUM_RUNS)]
    # The first run loads what is timed here alone.
    *choosing, tracing = np.median(seconds[1:], axis=0)
    choose_ns = [
        1e9 * s / NUM_TIMED if each.choose else math.nan
        for s, each in zip(choosing, candidates, strict=True)
    ]
    return choose_ns, 1e9 * tracing / max(1, num_rays)


def _seconds(task: Callable[[], object]) -> float:
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def summarize(
    candidate: Candidate, judged: np.ndarray, choose_ns: float, ray_ns: float
) -> dict[str, str | int | float | bool]:
    """One row of the table; judged: (5, k) results of `judge_point`."""
    variance, estimate, num_lights, dead, lost = judged
    cost_ns = choose_ns + num_lights.mean() * ray_ns
    error = math.sqrt(variance.mean() / variance.size / NUM_PLACES)
    miss = abs(estimate.mean() - 1)
    return {
        "sampler": candidate.name,
        "picks": candidate.num_picks,
        "choose_ns": choose_ns,
        "cost_ns": cost_ns,
        "dead_share": dead.mean(),
        "mean_lights": num_lights.mean(),
        "rel_variance_median": np.median(variance),
        "rel_variance_p90": np.percentile(variance, 90),
        "rel_variance_p99": np.percentile(variance, 99),
        "rel_variance_mean": variance.mean(),
        "variance_ns_median": np.median(variance) * cost_ns,
        "variance_ns_mean": variance.mean() * cost_ns,
        "estimate": estimate.mean(),
        "estimate_error": error,
        "lost": lost.mean(),
        "unbiased": bool(miss <= MOST_ERRORS * error + MOST_LOST and lost.mean() <= MOST_LOST),
    }
