"""The image while it is rendered: sums per pixel, in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .jit import kernel

LIGHT_PASSES = ("emission", "diffuse_direct", "diffuse_indirect", "diffuse_color")
NO_DEPTH = np.float32(1e10)  # of a pixel that sees the background, as in Cycles


@dataclass
class Film:
    """A rendered image. Rows run from the bottom up, as in Blender.

    Parameters
    ----------
    radiance_sum, radiance_sum_sq : (H, W, 3) float64, over samples
    normal_sum : (H, W, 3) float32, of the first hit
    albedo_sum : (H, W, 3) float64, of the first hit
    depth : (H, W) float32, metres along the viewing axis, of the first sample
    transparency_sum : (H, W) float64, over samples, of 1 - alpha: the share of the background
        that a transparent film lets through and `radiance_sum` leaves out
    light_sums : name of a light pass -> (H, W, 3) float64, over samples; empty unless wanted
    num_samples : per pixel
    dropped_samples : samples over the whole image that were not finite and count as black
    seconds_compile : compiling kernels, or loading them where they are compiled already
    seconds_setup : building lights, light tree and Embree's structure
    seconds_render : tracing alone
    cancelled : whether it ended at the user's wish, before its budget
    """

    radiance_sum: np.ndarray
    radiance_sum_sq: np.ndarray
    normal_sum: np.ndarray
    albedo_sum: np.ndarray
    depth: np.ndarray
    transparency_sum: np.ndarray
    light_sums: dict[str, np.ndarray]
    num_samples: int = 0
    dropped_samples: int = 0
    seconds_compile: float = 0.0
    seconds_setup: float = 0.0
    seconds_render: float = 0.0
    cancelled: bool = False

    @classmethod
    def empty(cls, shape: tuple[int, int], light_passes: bool = False) -> Film:
        """A film of so many rows and columns without samples."""
        return cls(
            radiance_sum=np.zeros((*shape, 3)),
            radiance_sum_sq=np.zeros((*shape, 3)),
            normal_sum=np.zeros((*shape, 3), np.float32),
            albedo_sum=np.zeros((*shape, 3)),
            depth=np.full(shape, NO_DEPTH),
            transparency_sum=np.zeros(shape),
            light_sums={name: np.zeros((*shape, 3)) for name in LIGHT_PASSES * light_passes},
        )

    @property
    def mean(self) -> np.ndarray:
        """(H, W, 3) float32 radiance."""
        return (self.radiance_sum / max(1, self.num_samples)).astype(np.float32)

    @property
    def variance(self) -> np.ndarray:
        """(H, W, 3) float32 variance of `mean`, as if samples were independent: an upper bound.

        Samples of a pixel are stratified, so the mean is better than this says.
        """
        n = self.num_samples
        if n < 2:
            return np.full_like(self.radiance_sum, np.inf, np.float32)
        spread = np.maximum(0, self.radiance_sum_sq - self.radiance_sum**2 / n)
        return (spread / (n * (n - 1))).astype(np.float32)

    @property
    def alpha(self) -> np.ndarray:
        """(H, W) float32, 0 to 1; `mean` is premultiplied by it. 1 where no background is left out.

        Clipped as in Cycles: samples of paths that survived by chance may count for more than 1.
        """
        transparency = self.transparency_sum / max(1, self.num_samples)
        return np.clip(1 - transparency, 0, 1).astype(np.float32)

    @property
    def normal(self) -> np.ndarray:
        """(H, W, 3) float32 mean geometric normal, world space, facing the camera."""
        return self.normal_sum / np.float32(max(1, self.num_samples))

    @property
    def albedo(self) -> np.ndarray:
        """(H, W, 3) float32 mean reflectance, textures included."""
        return (self.albedo_sum / max(1, self.num_samples)).astype(np.float32)

    def light_pass(self, name: str) -> np.ndarray:
        """(H, W, 3) float32, one of LIGHT_PASSES.

        As in Cycles diffuse light is divided by diffuse_color: light that falls on the surface.
        """
        light = self.light_sums[name]
        if name in ("diffuse_direct", "diffuse_indirect"):
            color = self.light_sums["diffuse_color"]
            light = np.divide(light, color, out=np.zeros_like(light), where=color > 0)
        else:
            light = light / max(1, self.num_samples)
        return light.astype(np.float32)


@kernel
def add_samples(radiance, num_pixels, num_samples, radiance_sum, radiance_sum_sq):
    """Add samples, stored sample after sample, to flat rows of sums; number of bad ones.

    In order of the samples, so sums do not depend on how a render is cut into passes.
    """
    num_dropped = 0
    for s in range(num_samples):
        for k in range(num_pixels):
            slot = s * num_pixels + k
            if not np.isfinite(radiance[slot, 0] + radiance[slot, 1] + radiance[slot, 2]):
                num_dropped += 1
                continue
            for c in range(3):
                value = np.float64(radiance[slot, c])
                radiance_sum[k, c] += value
                radiance_sum_sq[k, c] += value * value
    return num_dropped


@kernel
def add_values(values, num_pixels, num_samples, sums):
    """Add (n, k) values of samples, stored sample after sample, to (num_pixels, k) sums.

    In order of the samples, like `add_samples`. What is not finite counts as 0.
    """
    for s in range(num_samples):
        for k in range(num_pixels):
            for c in range(values.shape[1]):
                value = values[s * num_pixels + k, c]
                if np.isfinite(value):
                    sums[k, c] += np.float64(value)
