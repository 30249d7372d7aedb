"""Where the lines, points and bars of the report's plots lie; templates/parts.html draws them."""

import math
from collections.abc import Iterable

import numpy as np

from .equal_time import Rows, group_by

STYLES = {  # a method's colour and marker, the same in every plot
    "lighttree": ("#0072b2", "o"),
    "lighttree-single": ("#56b4e9", "s"),
    "lighttree-thesis": ("#5d4fb3", "<"),
    "lighttree-power": ("#009e73", "^"),
    "lighttree-uniform": ("#7a6fac", "v"),
    "cycles": ("#d55e00", "D"),
    "cycles-no-tree": ("#b58900", "P"),
    "cycles-no-lamp-mis": ("#8c510a", "p"),
    "cycles-guiding": ("#cc79a7", "X"),
}
OTHER_STYLE = ("#333333", "*")
MARKERS = {  # matplotlib's names for them, as SVG paths about the origin
    "o": "M-5,0a5,5 0 1,0 10,0a5,5 0 1,0 -10,0z",
    "s": "M-4.5,-4.5h9v9h-9z",
    "<": "M5,-5.5v11L-5.5,0z",
    "^": "M-5.5,5h11L0,-5.5z",
    "v": "M-5.5,-5h11L0,5.5z",
    "D": "M0,-6L6,0L0,6L-6,0z",
    "P": "M-2,-5.5h4v3.5h3.5v4h-3.5v3.5h-4v-3.5h-3.5v-4h3.5z",
    "p": "M0,-6L5.7,-1.9L3.5,4.9L-3.5,4.9L-5.7,-1.9z",
    "X": "M-5,-2.5L-2.5,-5L0,-2.5L2.5,-5L5,-2.5L2.5,0L5,2.5L2.5,5L0,2.5L-2.5,5L-5,2.5L-2.5,0z",
    "*": "M0,-6L1.5,-2L5.7,-1.9L2.4,0.8L3.5,4.9L0,2.5L-3.5,4.9L-2.4,0.8L-5.7,-1.9L-1.5,-2z",
}
WIDTH, HEIGHT = 480, 360
LEFT, RIGHT, TOP, BOTTOM = 68, 14, 12, 52
MAX_TICKS = 8


def summarize(rows: Rows) -> list[dict]:
    """One point a budget: means over seeds, and the smallest and largest rel_mse; by seconds."""
    points = []
    for budget, seeds in group_by(rows, "budget").items():
        errors = [row["rel_mse"] for row in seeds]
        point = {name: np.mean([r[name] for r in seeds]) for name in ("seconds_render", "samples")}
        point |= {"budget": budget, "num_seeds": len(seeds), "rel_mse": np.mean(errors)}
        points.append(point | {"low": min(errors), "high": max(errors)})
    return sorted(points, key=lambda point: point["seconds_render"])


def plot_errors(curves: dict[str, list[dict]], x: str) -> dict | None:
    """rel_mse against a column, log-log, in pixels; None where no point has that column.

    curves: points of `summarize` by method.
    """
    curves = {method: [p for p in points if p[x] > 0] for method, points in curves.items()}
    points = [point for points in curves.values() for point in points]
    if not points:
        return None
    xs, ys = [p[x] for p in points], [p[end] for p in points for end in ("low", "high")]
    x_ends, y_ends = padded_ends(xs), padded_ends(ys)
    place_x = log_scale(x_ends, LEFT, WIDTH - RIGHT)
    place_y = log_scale(y_ends, HEIGHT - BOTTOM, TOP)
    # The guide shows how Monte Carlo error falls, at the middle of the data: only its slope counts.
    product = math.exp(np.mean([math.log(p[x] * p["rel_mse"]) for p in points]))
    guide_ends = max(x_ends[0], product / y_ends[1]), min(x_ends[1], product / y_ends[0])
    return {
        "x_ticks": [(place_x(tick), f"{tick:g}") for tick in pick_ticks(*x_ends)],
        "y_ticks": [(place_y(tick), f"{tick:g}") for tick in pick_ticks(*y_ends)],
        "guide": join((place_x(end), place_y(product / end)) for end in guide_ends),
        "curves": {
            method: {
                "line": join((place_x(p[x]), place_y(p["rel_mse"])) for p in points),
                "band": join(
                    [(place_x(p[x]), place_y(p["low"])) for p in points]
                    + [(place_x(p[x]), place_y(p["high"])) for p in points[::-1]]
                ),
                "points": [(place_x(p[x]), place_y(p["rel_mse"]), p) for p in points],
            }
            for method, points in curves.items()
        },
        "told": [
            f"{method} {points[0]['rel_mse']:.2g} at {points[0][x]:.3g}, "
            f"{points[-1]['rel_mse']:.2g} at {points[-1][x]:.3g}"
            for method, points in curves.items()
            if points
        ],
    }


def place_percentiles(table: list[dict]) -> dict:
    """Where p50, p90 and p99 of each method lie on a shared log axis, in percent of its width."""
    errors = [entry[name].mean for entry in table for name in ("p50", "p99")]
    ends = padded_ends([error for error in errors if error > 0] or [1.0])
    place = log_scale(ends, 0, 100)
    return {
        "ticks": [(place(tick), f"{100 * tick:g}") for tick in pick_ticks(*ends, most=5)],
        "bars": {
            entry["method"]: [place(entry[name].mean) for name in ("p50", "p90", "p99")]
            for entry in table
        },
    }


def padded_ends(values: Iterable[float]) -> tuple[float, float]:
    """The smallest and largest, a fifteenth of their distance (at least 8 %) further out."""
    low, high = min(values), max(values)
    pad = max((high / low) ** (1 / 15), 1.08)
    return low / pad, high * pad


def log_scale(ends: tuple[float, float], first: float, last: float):
    """A function that places a value between two ends on a logarithmic axis."""
    low, high = (math.log(end) for end in ends)

    def place(value: float) -> float:
        share = (math.log(value) - low) / (high - low) if value > 0 else 0.0
        return round(first + share * (last - first), 1)

    return place


def pick_ticks(low: float, high: float, most: int = MAX_TICKS) -> list[float]:
    """Round numbers from low to high, as many as `most` allows, but at least two."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1, 1.5, 2, 3, 4, 5, 7), (1, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [step * 10.0**decade for decade in decades for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) <= most:
            break
    else:
        ticks = ticks[:: -(-len(ticks) // most)]
    return ticks if len(ticks) > 1 else [float(f"{end:.2g}") for end in (low, high)]


def join(points: Iterable[tuple[float, float]]) -> str:
    """Points as SVG writes them."""
    return " ".join(f"{x:g},{y:g}" for x, y in points)
