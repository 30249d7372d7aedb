"""A synthetic result folder: unbiased noise of known variance on a painted street at night."""

import json

import numpy as np

from lighttree_batch.images import write_exr

# The relative variance of a pixel is NOISE / (seconds * speed).
NOISE = 8.0
SPEED = {"lighttree": 20, "lighttree-power": 2, "cycles": 4, "cycles-no-tree": 1}
REFERENCE_NOISE = 2e-4
BUDGETS, SEEDS, SCENE = (1, 2, 4, 8), 2, "city-small-street"


def paint_street(width=64, height=48):
    """(H, W, 3) radiance from 0.004 to 30: sky, houses with lit windows, lamps, a wet road."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[0:height, 0:width] / height
    image = np.array([0.004, 0.006, 0.012]) * (1.2 - y[..., None])
    for left in np.arange(-0.1, width / height, 0.19):
        roof = rng.uniform(0.1, 0.5)
        image[(x > left) & (x < left + 0.16) & (y > roof)] = rng.uniform(0.01, 0.04, 3)
        for row in np.arange(roof + 0.03, 0.66, 0.06):
            for column in left + np.array([0.02, 0.06, 0.1]):
                if rng.random() < 0.45:
                    pane = (abs(x - column) < 0.013) & (abs(y - row) < 0.017)
                    image[pane] = rng.uniform(0.4, 2.5) * np.array([1, 0.72, 0.38])
    road = y[:, 0] >= 0.72
    image[road] = 0.25 * image[~road][::-1][: road.sum()] + 0.012
    for lamp in np.arange(0.15, width / height, 0.4):
        dist_sq = (x - lamp) ** 2 + (y - 0.45) ** 2
        image += (0.0009 / (dist_sq + 3e-5))[..., None] * np.array([1, 0.8, 0.5])
    return image.astype(np.float32)


def add_noise(image, relative_variance, rng):
    """Spiky noise, never negative, of mean 0 and the same factor for a pixel's three channels."""
    factor = rng.gamma(1 / relative_variance, relative_variance, image.shape[:2])
    return image * factor[..., None].astype(np.float32)


def write_image(path, rgb, header, variance=None):
    channels = dict(zip("RGB", np.moveaxis(rgb, 2, 0), strict=True))
    if variance is not None:
        channels |= {f"variance.{c}": variance[..., i] for i, c in enumerate("RGB")}
    write_exr(path, channels, header)


def write_references(folder, truth, rng, cycles_factor=1.0):
    images = []
    for engine, factor in (("lighttree", 1.0), ("cycles", cycles_factor)):
        images.append(add_noise(truth * np.float32(factor), REFERENCE_NOISE, rng))
        variance = REFERENCE_NOISE * np.square(truth)
        header = {"samples": 4096, "seconds_render": 150.0}
        write_image(folder / f"reference-{engine}.exr", images[-1], header, variance)
    write_image(folder / "reference.exr", np.mean(images, axis=0), {"weight_lighttree": 0.5})


def write_result_folder(
    folder, size=(64, 48), speed=SPEED, scenes=(SCENE,), kind="seconds", budgets=BUDGETS
):
    """What `lighttree compare` leaves behind: run.json, references and renders.

    A scene's file is its name up to the last dash, its camera what follows.
    """
    rng, truth = np.random.default_rng(7), paint_street(*size)
    run = {
        "format": 1,
        "command": "lighttree compare city-small.blend --out results --seconds 1,2,4,8",
        "started": "2026-01-15T21:04:05",
        "versions": {"lighttree": "0.1.0", "blender": "5.2.3", "python": "3.13.5"},
        "machine": {"cpu": "Example CPU", "cores": 2, "memory_gib": 15.6, "platform": "Linux"},
        "threads": 2,
        "resolution": list(size),
        "bounces": 4,
        "budget_kind": kind,
        "budgets": list(budgets),
        "methods": list(speed),
        "seeds": SEEDS,
        "reference_seconds": 300,
        "scenes": [
            {
                "name": scene,
                "file": f"{scene.rpartition('-')[0]}.blend",
                "camera": scene.rpartition("-")[2],
                "lights": {"mesh triangle": 800, "spot": 90, "point": 110},
                "triangles": 41234,
                "not_modelled": ["Sign.003: IES texture not supported; rendered as a point light."],
                "failed": [],
            }
            for scene in scenes
        ],
    }
    for scene in scenes:
        (folder / scene).mkdir(parents=True)
        write_references(folder / scene, truth, rng)
        for method in speed:
            for budget in budgets:
                for seed in range(1, SEEDS + 1):
                    header = {
                        "scene": scene,
                        "method": method,
                        "seed": seed,
                        "budget": {kind: budget},
                        "samples": 8 * budget,
                        "seconds_render": budget * rng.uniform(0.97, 1.05),
                        "seconds_setup": 0.4 if "cycles" in method else 0.9,
                        "seconds_compile": 0.0 if "cycles" in method else 0.5,
                        "peak_mib": 512.0,
                        "threads": 2,
                        "resolution": list(size),
                        "bounces": 4,
                        "dropped_samples": 0,
                        "settings": {"max_bounces": 4, "seed": seed},
                    }
                    image = add_noise(truth, NOISE / (budget * speed[method]), rng)
                    unit = "s" if kind == "seconds" else "spp"
                    name = f"{method}-{budget}{unit}-seed{seed}.exr"
                    write_image(folder / scene / name, image, header)
    (folder / "run.json").write_text(json.dumps(run), encoding="utf-8")
    return folder


def write_probe(folder, *more_rows):
    """The table of a probe, of one row and more."""
    columns = "sampler,picks,choose_ns,rel_variance_median,variance_ns_median,variance_ns_mean"
    rows = [f"{columns},unbiased,points", "lighttree,4,566,0.119,200818,502627,True,400"]
    (folder / "probe.csv").write_text("\n".join([*rows, *more_rows]))
