"""A render from scene to film: set-up, passes over the image, threads, time limit, cancel.

The image is cut into tiles of pixels; each thread takes a tile and follows waves of its paths to
their ends. A tile's sums are touched by one thread at a time and its samples are added in order,
so any number of threads gives the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta

import numpy as np

from .camera import build_camera_table
from .compilation import Cancel, Cancelled, Progress, compile_kernels
from .direct_light import PathSettings
from .film import Film, add_samples, add_values
from .met_lamps import add_lamps_met, allocate_lamp_rays, gather_lamp_rays
from .path import add_first_hits, shade_wave, spawn_wave
from .ray_visibility import closest_seen
from .rays import Hits, Tracer
from .scene import CAMERA_RAY, SHADOW_RAY, Camera, Scene
from .settings import Settings
from .shadows import add_unblocked, pass_surfaces
from .waves import (
    MEETS_LAMPS,
    allocate_samples,
    allocate_scratch,
    allocate_shadow_wave,
    allocate_wave,
)
from .world import build_world

WAVE_SIZE = 16384  # paths a thread follows at once; their state stays within a core's cache
TILE_PIXELS = 4096
LONGEST_PASS_S = 1.0  # so progress moves and the picture refines


def render(
    scene: Scene,
    settings: Settings | None = None,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
    on_pass: Callable[[Film], None] | None = None,
) -> Film:
    """Render a scene.

    Parameters
    ----------
    scene : Scene
    settings : Settings, the defaults if None
    progress : called now and then with the share done, 0 to 1, and a message for the user
    cancel : asked several times a second; once it returns true the film so far is returned
    on_pass : called after each pass with the film so far

    Raises
    ------
    SceneError if the scene cannot be rendered, ValueError if a setting makes no sense.
    """
    settings, cancel = settings or Settings(), cancel or (lambda: False)
    try:
        renderer = Renderer(
            scene, settings, progress or (lambda share, message: None), cancel=cancel
        )
    except Cancelled:
        film = Film.empty(scene.camera.shape, settings.light_passes)
        film.cancelled = True
        return film
    return renderer.run(cancel, on_pass or (lambda film: None))


class Renderer:
    """A scene prepared for rendering under some settings; raises errors like `render`.

    tracer: that of another scene with the same triangles, if there is one. cancel: asked while
    kernels are compiled, the first time; Cancelled is raised once it returns true.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings,
        progress: Progress,
        tracer: Tracer | None = None,
        cancel: Cancel = lambda: False,
    ):
        settings.check()
        scene.check()
        self.seconds_compile = compile_kernels(progress, cancel)
        start = time.perf_counter()
        self.settings, self.progress = settings, progress
        progress(0.0, "Building the light tree")
        self.world = build_world(scene, settings)
        self.tracer = tracer or Tracer(scene.vertices, scene.triangles)
        shapes = self.world.lamp_shapes
        self.lamp_tracer = Tracer(shapes.vertices, shapes.triangles)
        self.path_settings = PathSettings(
            settings.seed,
            settings.max_bounces,
            settings.max_passes,
            settings.split_lights,
            settings.roulette_depth,
            settings.mis == "balance",
        )
        seen_by = _rays_that_see_lamps(self.world)
        self.has_lamps_to_meet = seen_by != 0
        self.camera_flags = CAMERA_RAY | (MEETS_LAMPS if seen_by & CAMERA_RAY else 0)
        self.max_passes = settings.max_passes if self.world.is_see_through else 0
        hides_from_light = np.any(self.world.geometry.visible & SHADOW_RAY == 0)
        self.is_shadow_whole = self.max_passes == 0 and not hides_from_light
        self.aim(scene.camera)
        self.seconds_setup = time.perf_counter() - start

    def aim(self, camera: Camera) -> None:
        """Render from another camera from now on."""
        self.camera = camera
        settings = self.settings
        self.camera_table = build_camera_table(camera, settings.filter, settings.filter_width_px)

    def run(
        self, cancel: Cancel, on_pass: Callable[[Film], None], samples: int | None = None
    ) -> Film:
        """Render until the samples or the time are used up, or cancel() returns true.

        samples: instead of those of the settings.
        """
        settings = replace(self.settings, samples=samples or self.settings.samples)
        film = Film.empty(self.camera.shape, settings.light_passes)
        film.seconds_setup, film.seconds_compile = self.seconds_setup, self.seconds_compile
        tiles = _tiles(film, settings.num_threads)
        tracers = [TileTracer(self, cancel) for _ in range(settings.num_threads)]
        pixels = _pixels(self.camera)
        start = time.perf_counter()
        with ThreadPoolExecutor(settings.num_threads) as pool:
            while not film.cancelled:
                num = _pass_samples(settings, film.num_samples, time.perf_counter() - start)
                if num == 0:
                    break
                queue = iter(tiles)
                done = list(
                    pool.map(
                        lambda tracer, queue=queue, num=num: tracer.trace_tiles(
                            pixels, film, queue, num
                        ),
                        tracers,
                    )
                )
                film.cancelled = not all(done)
                if film.cancelled:
                    break
                film.num_samples += num
                film.seconds_render = time.perf_counter() - start
                self._report(film, settings)
                on_pass(film)
        return film

    def _report(self, film: Film, settings: Settings) -> None:
        """Tell progress: the share done, and the time left."""
        share = film.num_samples / settings.samples
        if settings.time_limit_s:
            share = max(share, film.seconds_render / settings.time_limit_s)
        share = min(1.0, share)
        left = film.seconds_render * (1 / share - 1)
        left = timedelta(seconds=round(left))
        self.progress(share, f"Sample {film.num_samples} | {left} left")


def _rays_that_see_lamps(world) -> int:
    """Bits of the rays that see any lamp with extent, among those that look for lamps."""
    lights, shapes = world.sampler.lights, world.lamp_shapes
    visible = lights.visible[np.concatenate([shapes.lamp, lights.suns])] & shapes.rays
    return int(np.bitwise_or.reduce(visible, initial=0))


def _pixels(camera: Camera) -> np.ndarray:
    """(k, 2) int32 column and row in the full frame of every rendered pixel, rows from below."""
    x0, y0, x1, y1 = camera.crop_px
    rows, columns = np.mgrid[y0:y1, x0:x1]
    return np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.int32)


def _tiles(film: Film, num_threads: int) -> list[slice]:
    """Runs of pixels, small enough that all threads are busy to the end of a pass."""
    num_pixels = film.depth.size
    size = max(1, min(TILE_PIXELS, -(-num_pixels // (4 * num_threads))))
    return [slice(a, min(a + size, num_pixels)) for a in range(0, num_pixels, size)]


def _pass_samples(settings: Settings, num_done: int, seconds: float) -> int:
    """Samples per pixel of the next pass, 0 if the render is over."""
    num = settings.samples - num_done
    if num_done == 0:
        return min(num, 1)
    seconds_per_sample = seconds / num_done
    num = min(num, max(1, int(LONGEST_PASS_S / seconds_per_sample)))
    if settings.time_limit_s:
        num = min(num, int((settings.time_limit_s - seconds) / seconds_per_sample))
    return max(0, num)


class TileTracer:
    """One thread's waves, and the loop that follows them."""

    def __init__(self, renderer: Renderer, cancel: Cancel = lambda: False):
        self.renderer, self.cancel = renderer, cancel
        settings = renderer.settings
        self.waves = allocate_wave(WAVE_SIZE), allocate_wave(WAVE_SIZE)
        self.shadow = allocate_shadow_wave(WAVE_SIZE * settings.split_lights)
        self.scratch = allocate_scratch(renderer.world.sampler, settings.split_lights)
        self.samples = allocate_samples(WAVE_SIZE, settings.light_passes)
        self.lamp_rays = allocate_lamp_rays(WAVE_SIZE)
        self.max_distance = np.zeros(WAVE_SIZE, np.float32)

    def trace_tiles(self, pixels: np.ndarray, film: Film, queue, num_samples: int) -> bool:
        """Trace a pass over tiles from the queue; false if cancelled."""
        try:
            for tile in queue:
                self.trace(pixels[tile], film, tile, film.num_samples, num_samples)
        except Cancelled:
            return False
        return True

    def trace(self, pixels, film: Film, tile: slice, first_sample: int, num_samples: int) -> None:
        """Add samples to the pixels of one tile."""
        per_wave = max(1, WAVE_SIZE // len(pixels))
        last_sample = first_sample + num_samples
        for sample in range(first_sample, last_sample, per_wave):
            num = min(per_wave, last_sample - sample)
            self._trace_wave(pixels, film, tile, sample, num)
            self._add_to_film(film, tile, len(pixels), num)

    def _add_to_film(self, film: Film, tile: slice, num_pixels: int, num_samples: int) -> None:
        """Add the samples just traced to the sums of a tile."""
        samples = self.samples
        film.dropped_samples += add_samples(
            samples.radiance,
            num_pixels,
            num_samples,
            film.radiance_sum.reshape(-1, 3)[tile],
            film.radiance_sum_sq.reshape(-1, 3)[tile],
        )
        sums = {"albedo": film.albedo_sum, **film.light_sums}
        if self.renderer.world.film_transparent:
            sums["transparency"] = film.transparency_sum
        for name, total in sums.items():
            values = getattr(samples, name)
            rows = total.reshape(-1, values.shape[1])[tile]
            add_values(values, num_pixels, num_samples, rows)

    def _trace_wave(self, pixels, film: Film, tile: slice, sample: int, num_samples: int) -> None:
        """Follow all paths of some samples to their ends; what they gather lies in self.samples."""
        renderer, (wave, next_wave) = self.renderer, self.waves
        world, settings = renderer.world, renderer.path_settings
        num_paths = len(pixels) * num_samples
        spawn_wave(
            wave,
            self.max_distance,
            renderer.camera_table,
            renderer.camera_flags,
            settings.seed,
            pixels,
            sample,
            num_samples,
        )
        for values in self.samples:
            values[:num_paths] = 0
        max_distance = self.max_distance[:num_paths]
        for depth in range(settings.max_bounces + 2 + renderer.max_passes):
            if self.cancel():
                raise Cancelled
            hits = closest_seen(renderer.tracer, world.geometry, wave, num_paths, max_distance)
            if depth == 0:
                self._add_first_hits(film, tile, wave, hits, len(pixels), num_paths, sample == 0)
            if renderer.has_lamps_to_meet:
                self._meet_lamps(wave, hits, num_paths)
            num_shadow, num_next = shade_wave(
                world,
                settings,
                wave,
                hits,
                num_paths,
                depth,
                self.samples,
                next_wave,
                self.shadow,
                self.scratch,
            )
            if num_shadow:
                self._trace_shadows(num_shadow)
            wave, next_wave, num_paths, max_distance = next_wave, wave, num_next, None
            if num_paths == 0:
                break

    def _trace_shadows(self, num: int) -> None:
        """Add the light of all shadow rays that arrives, as far as surfaces let it through."""
        renderer, shadow = self.renderer, self.shadow
        if renderer.is_shadow_whole:
            is_blocked = renderer.tracer.occluded(shadow.origin[:num], shadow.to_light[:num])
            add_unblocked(shadow, num, is_blocked, self.samples)
            return
        # What blocks most rays is opaque: told at once what it is, none is traced twice.
        # Each ray may pass so many surfaces and no more, so this ends.
        while num:
            hits = renderer.tracer.closest_before(shadow.origin[:num], shadow.to_light[:num])
            num = pass_surfaces(renderer.world, shadow, hits, num, self.scratch.lobes, self.samples)

    def _meet_lamps(self, wave, hits: Hits, num_paths: int) -> None:
        """Add what paths see of lamps on their way to what they hit; lamps hide nothing."""
        renderer, rays = self.renderer, self.lamp_rays
        world, settings, picks = renderer.world, renderer.path_settings, self.scratch.picks
        num = gather_lamp_rays(world, settings, wave, hits, num_paths, rays, self.samples, picks)
        while num:
            met = renderer.lamp_tracer.closest(
                rays.origin[:num], rays.direction[:num], rays.reach[:num]
            )
            num = add_lamps_met(world, settings, wave, rays, met, num, self.samples, picks)

    def _add_first_hits(
        self, film: Film, tile: slice, wave, hits: Hits, num_pixels: int, num_paths: int, is_first
    ) -> None:
        depth = film.depth.reshape(-1)[tile]
        add_first_hits(
            self.renderer.world.geometry,
            self.renderer.camera_table,
            wave,
            hits,
            num_pixels,
            num_paths,
            film.normal_sum.reshape(-1, 3)[tile],
            depth if is_first else depth[:0],
        )
