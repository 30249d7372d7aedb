"""The report's pictures and plots as data URIs: JPEG for images, SVG for plots, RGBE for HDR."""

import base64
import io

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from .metrics import luminance

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
ERROR_COLORS, FLIP_COLORS, TILE_COLORS = "viridis", "magma", "RdBu_r"
MAX_Z = 6  # standard errors
MIN_ERROR, MAX_ERROR = 0.01, 3.0  # the ends of the error maps' colours, on a log scale
THUMBNAIL_PX = 640


def data_uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def pick_exposure_ev(rgb: np.ndarray) -> float:
    """Stops, in halves, that show nine of ten pixels below clipping (and no black image)."""
    bright = np.percentile(luminance(rgb), 90)
    return float(np.clip(np.round(2 * np.log2(0.7 / max(bright, 1e-12))) / 2, -20, 20))


def draw_image(rgb: np.ndarray, exposure_ev: float) -> str:
    """sRGB JPEG of linear Rec. 709, clipped at white."""
    linear = np.clip(rgb * 2.0**exposure_ev, 0, 1)
    return draw_pixels(
        np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    )


def draw_error_map(relative_error: np.ndarray) -> str:
    low, high = np.log10([MIN_ERROR, MAX_ERROR])
    log_error = np.log10(np.maximum(relative_error, 1e-9))
    return draw_pixels(apply_colors(log_error, ERROR_COLORS, low, high))


def draw_flip_map(flip: np.ndarray) -> str:
    return draw_pixels(apply_colors(flip, FLIP_COLORS, 0, 1))


def draw_tile_map(tile_z: np.ndarray) -> str:
    return draw_pixels(apply_colors(tile_z, TILE_COLORS, -MAX_Z, MAX_Z), "png")


def apply_colors(values: np.ndarray, colors: str, low: float, high: float) -> np.ndarray:
    """(H, W, 3) sRGB of an (H, W) map; values outside low to high get the end colours."""
    return colormaps[colors]((values - low) / (high - low))[..., :3]


def draw_pixels(srgb: np.ndarray, kind: str = "jpeg") -> str:
    """Picture of (H, W, 3) in 0 to 1; a wide one keeps every n-th pixel, for a mean hides noise."""
    step = -(-srgb.shape[1] // THUMBNAIL_PX)
    file, pixels = io.BytesIO(), np.round(255 * srgb[::step, ::step]).astype(np.uint8)
    options = {"quality": 90, "subsampling": 0} if kind == "jpeg" else {}
    imsave(file, pixels, format=kind, pil_kwargs=options)
    return data_uri(file.getvalue(), f"image/{kind}")


def gradient(colors: str) -> str:
    """A colour map as a CSS background, for legends."""
    stops = (to_hex(color) for color in colormaps[colors](np.linspace(0, 1, 9)))
    return f"linear-gradient(90deg, {', '.join(stops)})"


def encode_rgbe(rgb: np.ndarray) -> str:
    """Radiance's shared exponent, 4 bytes a pixel and 0.4 % exact, as the flip book reads it."""
    _, exponent = np.frexp(np.maximum(rgb.max(axis=2), 1e-30))
    mantissa = np.clip(np.round(np.ldexp(rgb, 8 - exponent[..., None])), 0, 255)
    rgbe = np.concatenate([mantissa, exponent[..., None] + 128], axis=2).astype(np.uint8)
    return data_uri(rgbe.tobytes(), "application/octet-stream")


def draw_plot(by_method: dict[str, list[dict]], x: str, x_label: str, unit: str) -> dict:
    """rel_mse against a column, log-log: lines through the means over seeds, bands over seeds.

    Returns the SVG and its alt text.
    """
    figure = Figure(figsize=(5.6, 4.4), layout="constrained")
    axes = figure.subplots()
    axes.set(xscale="log", yscale="log", xlabel=f"{x_label} ({unit})", ylabel="relative MSE")
    told, products = [], []
    for method, rows in by_method.items():
        color, marker = STYLES.get(method, OTHER_STYLE)
        xs, means, lows, highs = summarize_curve(rows, x)
        axes.fill_between(xs, lows, highs, color=color, alpha=0.2, linewidth=0)
        axes.plot(xs, means, color=color, marker=marker, markersize=5, label=method)
        products.extend(xs * means)
        told.append(f"{method} {means[0]:.2g} at {xs[0]:.3g}, {means[-1]:.2g} at {xs[-1]:.3g}")
    # The guide shows how Monte Carlo error falls, at the middle of the data: only its slope counts.
    ends = np.array(axes.get_xlim())
    guide = np.exp(np.mean(np.log(products))) / ends
    axes.plot(
        ends, guide, color="#999999", linestyle="--", linewidth=1, label=f"slope of 1/{x_label}"
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(color="#e4e4e4", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    file = io.BytesIO()
    with rc_context({"svg.hashsalt": "lighttree"}):  # equal data, equal file
        figure.savefig(file, format="svg", metadata={"Date": None})
    alt = f"Relative MSE against {x_label}, both logarithmic: {'; '.join(told)}."
    return {"uri": data_uri(file.getvalue(), "image/svg+xml"), "alt": alt}


def summarize_curve(rows: list[dict], x: str) -> np.ndarray:
    """x, then mean, lowest and highest rel_mse over the seeds of each budget, sorted by x."""
    groups: dict[str, list[dict]] = {}
    for row in rows:
        groups.setdefault(row["budget"], []).append(row)
    points = []
    for group in groups.values():
        errors = [row["rel_mse"] for row in group]
        points.append((np.mean([r[x] for r in group]), np.mean(errors), min(errors), max(errors)))
    return np.transpose(sorted(points))
