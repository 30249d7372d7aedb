"""Who has less error at equal time, by how much, and how sure that is.

At equal time, the error ratio of two methods is the ratio of their costs, cost = rel_mse *
seconds_render; costs are averaged over seeds, their ratios geometrically over scenes.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from . import metrics
from .methods import CYCLES, METHODS

Rows = list[dict]
TABLE_COLUMNS = [*metrics.HEADER_COLUMNS[3:], *metrics.ERROR_COLUMNS, "mean_ratio", "peak_mib"]
CONFIDENCE = 0.95


class Spread(NamedTuple):
    """A mean over seeds, and the smallest and largest of them."""

    mean: float
    low: float
    high: float


def group_by(rows: Iterable[dict], column: str) -> dict[str, Rows]:
    groups: dict[str, Rows] = {}
    for row in rows:
        groups.setdefault(row[column], []).append(row)
    return groups


def spread(values: list[float]) -> Spread:
    return Spread(float(np.mean(values)), min(values), max(values))


def cost_by_seed(rows: Rows, error: str = "rel_mse", setup: bool = False) -> dict[int, float]:
    return {
        row["seed"]: row[error] * (row["seconds_render"] + setup * row["seconds_setup"])
        for row in rows
    }


def compare_costs(pairs: list[tuple[Rows, Rows]], error="rel_mse", setup=False) -> Spread:
    """How many times lower the error of the first of each pair is at equal time.

    One pair a scene; the mean is the geometric mean over scenes of the ratio of mean costs,
    low and high are over single seeds.
    """
    scenes = [[cost_by_seed(rows, error, setup) for rows in pair] for pair in pairs]
    mean = geometric_mean(np.mean([*b.values()]) / np.mean([*a.values()]) for a, b in scenes)
    seeds = set.intersection(*(set(costs) for scene in scenes for costs in scene))
    by_seed = [geometric_mean(b[seed] / a[seed] for a, b in scenes) for seed in seeds]
    return Spread(mean, min(by_seed, default=mean), max(by_seed, default=mean))


def confidence_interval(pairs: list[tuple[Rows, Rows]]) -> Spread | None:
    """The mean of `compare_costs` and its 95 % interval over seeds; None if a scene has one seed.

    Student's t on logarithms of costs: each scene and method has the variance of its own seeds,
    and Welch's formula gives their sum its degrees of freedom.
    """
    logs = [np.log([*cost_by_seed(rows).values()]) for pair in pairs for rows in pair]
    if min(len(seeds) for seeds in logs) < 2:
        return None
    dofs = np.array([len(seeds) - 1 for seeds in logs])
    variances = np.array([np.var(seeds, ddof=1) / len(seeds) for seeds in logs])
    mean, half = compare_costs(pairs).mean, 0.0
    if total := variances.sum():
        dof = total**2 / (variances**2 / dofs).sum()
        half = student_t(dof) * math.sqrt(total) / len(pairs)
    return Spread(mean, mean * math.exp(-half), mean * math.exp(half))


def student_t(dof: float) -> float:
    """How many standard errors either side hold 95 % of Student's t.

    With t = sqrt(dof) * tan(angle) its density over angles is a power of the cosine.
    """
    angles = np.linspace(0, math.pi / 2, 100_001)
    mass = np.cumsum(np.cos((angles[1:] + angles[:-1]) / 2) ** (dof - 1))
    return math.sqrt(dof) * math.tan(np.interp(CONFIDENCE, mass / mass[-1], angles[1:]))


def geometric_mean(values: Iterable[float]) -> float:
    return math.exp(np.mean([math.log(value) for value in values]))


def compare_engines(pairs: list[tuple[Rows, Rows]]) -> dict | None:
    """LightTree against Cycles over some scenes: the numbers of the headline."""
    if not pairs:
        return None
    return {
        "ratio": compare_costs(pairs),
        "interval": confidence_interval(pairs),
        "trimmed": compare_costs(pairs, error="rel_mse_trimmed"),
        "with_setup": compare_costs(pairs, setup=True),
        "budgets": sorted({ours[0]["budget"] for ours, _ in pairs}, key=lambda b: (len(b), b)),
        "num_scenes": len(pairs),
        "num_seeds": min(len(rows) for pair in pairs for rows in pair),
    }


def find_rival(scenes: list[dict[str, Rows]]) -> dict | None:
    """The control row of Cycles that comes closest to LightTree, if it beats Cycles as it comes.

    scenes: rows by method; a control row counts if every scene has it.
    """
    if not scenes:
        return None
    controls = set.intersection(*(set(rows) for rows in scenes)) & set(METHODS)
    ratios = {
        method: compare_costs([(rows["lighttree"], rows[method]) for rows in scenes])
        for method in sorted(controls)
        if METHODS[method].engine == CYCLES
    }
    method = min(ratios, key=lambda name: ratios[name].mean)
    return {"method": method, "ratio": ratios[method]} if method != "cycles" else None


def build_table(comparable: dict[str, Rows]) -> list[dict]:
    """One entry a method at the equal budget, most efficient first; every number is a Spread."""
    table = []
    for method, rows in comparable.items():
        entry = {name: spread([row[name] for row in rows]) for name in TABLE_COLUMNS}
        per_seed = spread([metrics.efficiency(r["rel_mse"], r["seconds_render"]) for r in rows])
        # Mean cost, not mean efficiency: a lucky seed must not count for more than an unlucky one.
        mean_cost = np.mean([row["rel_mse"] * row["seconds_render"] for row in rows])
        base = comparable.get("cycles")
        entry |= {
            "method": method,
            "efficiency": per_seed._replace(mean=1 / mean_cost),
            "speed_up": compare_costs([(rows, base)]) if base else None,
        }
        table.append(entry)
    return sorted(table, key=lambda entry: -entry["efficiency"].mean)


def compare_budgets(rows: Rows) -> list[dict]:
    """LightTree against each other method at each budget of a scene, in the order of the rows."""
    compared = []
    for budget, at_budget in group_by(rows, "budget").items():
        by_method = group_by(at_budget, "method")
        ours = by_method.pop("lighttree", None)
        for rival, theirs in by_method.items() if ours else ():
            ratio = compare_costs([(ours, theirs)])
            compared.append({"budget": budget, "rival": rival, "ratio": ratio})
    return compared
