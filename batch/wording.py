"""How the report says numbers: three digits, and ratios in words that cannot be misread."""

import math

from markupsafe import Markup

from .equal_time import Spread


def format_number(value: float | None, decimals: int | None = None) -> str | Markup:
    """Three digits, 0.0435, 17.3, 1,240 or 1.20 x 10^-5; counts whole; a dash if unknown."""
    if value is None or not math.isfinite(value):
        return Markup("&ndash;")
    if isinstance(value, int):
        decimals = 0
    if decimals is None and 1 < abs(value) < 1e6:
        decimals = max(0, 2 - int(math.log10(abs(value))))
    if decimals is not None:
        return f"{value:,.{decimals}f}"
    if value == 0 or 1e-3 <= abs(value) <= 1:
        return f"{value:#.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return Markup("{}&nbsp;&times;&nbsp;10<sup>{}</sup>").format(mantissa, int(exponent))


def format_budget(label: str) -> str:
    """'8 s' for '8s', '64 samples per pixel' for '64spp'."""
    number, unit = label.rstrip("sp"), label.lstrip("0123456789.")
    return f"{number} {'s' if unit == 's' else 'samples per pixel'}"


def format_comparative(ratio: float) -> str:
    """'3.10 times lower' for 3.1, '2.00 times higher' for 0.5."""
    if not math.isfinite(ratio):
        return "unknown"
    return f"{format_number(max(ratio, 1 / ratio))} times {'lower' if ratio >= 1 else 'higher'}"


def format_comparative_range(ratio: Spread) -> str:
    """'2.00 to 4.00 times lower'; both words where the seeds do not agree on who is ahead."""
    if (ratio.low >= 1) != (ratio.high >= 1):
        return f"{format_comparative(ratio.low)} to {format_comparative(ratio.high)}"
    nearer, farther = sorted(ratio[1:], key=lambda r: max(r, 1 / r))
    return f"{format_number(max(nearer, 1 / nearer))} to {format_comparative(farther)}"
