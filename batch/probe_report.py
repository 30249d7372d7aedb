"""What a probe found: a table to print, probe.csv, and the plot probe.png."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter, StrMethodFormatter
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from .images import replacing
from .metrics import write_rows
from .plots import STYLES
from .probe import DARK_SHARE, Probe

COLORS = {name.removeprefix("lighttree-"): color for name, (color, _) in STYLES.items()}
COLORS |= {"cycles-style": COLORS["cycles"], "oracle p ~ f": "#333333"}
OPTIONS_COLOR = "#cc79a7"
LINE_STYLES = {1: "-", 4: "--", 16: ":"}
# The plot begins where so many percent of all values lie below.
LEFT_PERCENT = 1

COLUMNS = {  # headers of the printed table, and the columns of probe.csv that they show
    "picks": "picks",
    "dead %": "dead_share",
    "lights": "mean_lights",
    "choice ns": "choose_ns",
    "variance\nmedian": "rel_variance_median",
    "\n90 %": "rel_variance_p90",
    "\n99 %": "rel_variance_p99",
    "\nmean": "rel_variance_mean",
    "x cost us\nmedian": "variance_ns_median",
    " \nmean": "variance_ns_mean",
}
FACTORS = {"dead_share": 100, "variance_ns_median": 1e-3, "variance_ns_mean": 1e-3}


def build_table(probe: Probe) -> Table:
    """The table to print."""
    numbers = (Column(header, justify="right") for header in COLUMNS)
    table = Table(
        Column("\nsampler", min_width=14),
        *numbers,
        Column("mean is\nexact"),
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
        caption=_caption(probe),
        caption_justify="left",
    )
    for row in probe.rows:
        cells = (_cell(row[name] * FACTORS.get(name, 1)) for name in COLUMNS.values())
        table.add_row(row["sampler"], *cells, _verdict(row))
    return table


def _caption(probe: Probe) -> str:
    num_kept = probe.relative_variance.shape[1]
    return (
        f"{probe.num_lights:,} lights; {probe.visible:.0%} of their irradiance is visible.\n"
        f"Variance relative to the squared sum, at {num_kept} of {probe.num_points} points; the "
        f"others are darker than {DARK_SHARE:.0%} of the mean. An oracle p ~ fV has variance 0.\n"
        f"Cost: the choice, and {probe.ray_ns:.0f} ns for a point on each light and a shadow ray."
    )


def _cell(value: float) -> str:
    if value != value:  # NaN: unknown
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _verdict(row: dict) -> str:
    if row["unbiased"]:
        return "yes"
    return f"NO: {row['estimate']:.3f} ± {row['estimate_error']:.3f}, lost {row['lost']:.2%}"


def write_files(probe: Probe, folder: Path) -> None:
    """Write probe.csv and probe.png."""
    write_rows(folder / "probe.csv", probe.rows[0], probe.rows)
    write_plot(probe, folder / "probe.png")


def write_plot(probe: Probe, path: Path) -> None:
    """Write probe.png: how relative variance, and that times cost, are distributed over points."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    cost_us = np.array([[row["cost_ns"] / 1000] for row in probe.rows])
    _draw_distributions(left, probe, probe.relative_variance)
    _draw_distributions(right, probe, probe.relative_variance * cost_us)
    left.set(xlabel="relative variance of one estimate", ylabel="share of points below")
    right.set(xlabel="relative variance x cost (µs)")
    left.yaxis.set_major_formatter(PercentFormatter(1))
    num_kept, scene = probe.relative_variance.shape[1], probe.rows[0]["scene"]
    figure.suptitle(f"{scene}: {probe.num_lights:,} lights, {num_kept} points", fontsize=11)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    with replacing(path) as temp:
        figure.savefig(temp, format="png", dpi=150)


def _draw_distributions(axes: Axes, probe: Probe, values: np.ndarray) -> None:
    """One step curve a sampler, over points from the least to the most noisy."""
    shares = np.arange(1, values.shape[1] + 1) / values.shape[1]
    for row, label, series in zip(probe.rows, probe.labels, np.sort(values), strict=True):
        axes.step(
            series,
            shares,
            where="post",
            label=label,
            color=COLORS.get(row["sampler"], OPTIONS_COLOR),
            linestyle=LINE_STYLES[row["picks"]],
            linewidth=1.6,
        )
    shown = values[np.isfinite(values) & (values > 0)]
    if shown.size:
        axes.set(xscale="log", xlim=(np.percentile(shown, LEFT_PERCENT), 1.2 * shown.max()))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    axes.set(ylim=(0, 1), yticks=(0, 0.1, 0.25, 0.5, 0.75, 0.9, 1))
    axes.grid(color="#e4e4e4", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
