"""Tables in Markdown, and the form of numbers in pages and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

__all__ = ["format_gain", "format_interval", "format_short", "format_span", "make_table"]


def make_table(header: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown, without a line break at its end."""
    head = "".join(f" {cell} |" if cell else " |" for cell in map(str, header))
    return "\n".join([f"|{head}", f"|{'---|' * len(header)}",
                      *(f"| {' | '.join(map(str, row))} |" for row in rows)])


def format_interval(found: Any, form: str = "") -> str:
    """Mean with its interval: `+0.12 (+0.02 to +0.21)`.

    Args:
        found: has `mean`, `low` and `high`.
        form: of each number, as for `format`; by default two significant digits.
    """
    return f"{_format(found.mean, form)} ({format_span(found, form)})"


def format_gain(found: Any) -> str:
    """A `Difference` with its interval, bold where it is significant."""
    text = format_interval(found, "+.2f")
    return f"**{text}**" if found.sign else text


def format_span(found: Any, form: str = "") -> str:
    """Interval alone: `+0.02 to +0.21`; see `format_interval`."""
    return f"{_format(found.low, form)} to {_format(found.high, form)}"


def _format(value: float, form: str) -> str:
    return format(value, form) if form else format_short(value)


def format_short(value: float) -> str:
    """Two significant digits, and all digits before the decimal point: 0.52, 3.4, 26, 1,340."""
    if not math.isfinite(value):
        return "-"
    rounded = float(f"{value:.2g}") if value < 1_000 else float(f"{value:.3g}")
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"
