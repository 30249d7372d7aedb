"""References: long renders of both engines in chunks, averaged, and the weighted mean of the two.

The chunks' scatter gives each pixel's variance, for both engines in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .images import write_exr
from .metrics import read_rgb


def average_chunks(paths: Sequence[Path]) -> tuple[np.ndarray, np.ndarray, dict]:
    """The mean of two or more renders weighted by samples, its variance, and its facts.

    mean, variance (of the mean): (H, W, 3) float64.
    """
    images, headers = zip(*(read_rgb(path) for path in paths), strict=True)
    samples = np.array([header["samples"] for header in headers], np.float64)
    mean = sum(n * image for n, image in zip(samples, images, strict=True)) / samples.sum()
    # A chunk of n samples varies by s^2 / n; this is the unbiased estimate of s^2 / samples.sum().
    scatter = sum(n * (image - mean) ** 2 for n, image in zip(samples, images, strict=True))
    variance = scatter / ((len(paths) - 1) * samples.sum())
    facts = {
        name: sum(header[name] for header in headers)
        for name in ("samples", "seconds_render", "seconds_setup")
    }
    # Not in chunks of earlier versions.
    facts["seconds_compile"] = sum(header.get("seconds_compile", 0.0) for header in headers)
    return mean, variance, facts | {"chunks": len(paths)}


def write_references(folder: Path, header: dict, chunks: dict[str, Sequence[Path]]) -> None:
    """Write a scene's reference-ENGINE.exr, from each engine's chunks, and reference.exr.

    An engine with fewer than two chunks has no reference; without either, there is none at all.
    """
    means, weights = {}, {}
    for engine, paths in chunks.items():
        target = folder / f"reference-{engine}.exr"
        if len(paths) < 2:
            target.unlink(missing_ok=True)
            continue
        means[engine], variance, facts = average_chunks(paths)
        # One weight for the whole image: weights that follow a pixel's own noise are biased.
        weights[engine] = 1 / max(variance.mean(), np.finfo(np.float64).tiny)
        channels = _channels(means[engine]) | _channels(variance, "variance.")
        write_exr(target, channels, header | {"engine": engine} | facts)
    if not means:
        (folder / "reference.exr").unlink(missing_ok=True)
        return
    total = sum(weights.values())
    mean = sum(weights[engine] / total * means[engine] for engine in means)
    weight = {"weight_lighttree": weights.get("lighttree", 0) / total}
    write_exr(folder / "reference.exr", _channels(mean), header | weight)


def _channels(image: np.ndarray, prefix: str = "") -> dict[str, np.ndarray]:
    return {prefix + name: image[..., i].astype(np.float32) for i, name in enumerate("RGB")}
