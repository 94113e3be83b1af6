"""Axes of charts: limits, and positions of the numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, floor, log10
from typing import Any

import numpy as np

GRID = "#e4e4e4"

PAD = 0.08
"""Margin beyond the outermost points [length of the axis]."""

MIN_TICKS, MAX_TICKS = 3, 8
"""Minimum and maximum number of ticks of a logarithmic axis. At least two ticks are needed, because
a single number does not show the scale."""

STEPS = ((1,), (1, 3), (1, 2, 5), (1, 1.5, 2, 3, 5, 7))
"""Choices of ticks within a decade [10^k], from few to many."""


@dataclass(frozen=True)
class Axis:
    """One axis: label with unit, limits and ticks.

    Attributes
    ----------
    label : str
        Label with the unit.
    log : bool
        Whether the axis is logarithmic.
    names : tuple of str
        Names instead of numbers, from bottom to top.
    ticks : tuple of float
        Positions of numbers. If it is empty, the positions are chosen automatically.
    limits : (low, high), optional
        Ends of the axis. Default: chosen automatically.
    minimum : float, optional
        Minimum number. Smaller values are only rounding errors, and are drawn at this minimum.
    """

    label: str
    log: bool = False
    names: tuple[str, ...] = ()
    ticks: tuple[float, ...] = ()
    limits: tuple[float, float] | None = None
    minimum: float | None = None

    def drawn(self, value: Any) -> Any:
        """Return the position of a number, or of a name of the axis. None if it is not drawn."""
        return value if None in (value, self.minimum) else max(value, self.minimum)

    def place(self, value: float) -> float:
        """Return the coordinate of an end of the axis in plotly. On a logarithmic axis, this is the
        exponent of 10."""
        return log10(value) if self.log else value

    def ends(self, values: Sequence[float]) -> tuple[float, float]:
        """Return the coordinates of both ends of the axis, if it shows these numbers."""
        if self.limits:
            return self.place(self.limits[0]), self.place(self.limits[1])
        positions = [self.place(value) for value in values if not self.log or value > 0] or [0.0]
        low, high = min(positions), max(positions)
        pad = max(PAD * (high - low), 0.04 if self.log else 0.02 * abs(high)) or 1.0
        return low - pad, high + pad

    def settings(self, values: Sequence[float]) -> dict[str, Any]:
        """Return plotly's settings of the axis, if it shows these numbers."""
        found: dict[str, Any] = {
            "title": {"text": self.label, "standoff": 6, "font": {"size": 14}},
            "gridcolor": GRID, "zeroline": False, "tickangle": 0,
            "ticks": "outside", "tickcolor": GRID, "linecolor": "#888888", "showline": True,
            "automargin": True,
        }  # fmt: skip
        if self.names:
            return found | {
                "type": "category", "categoryorder": "array", "categoryarray": list(self.names),
                "showgrid": False,
            }  # fmt: skip
        ends = self.ends(values)
        found["range"] = list(ends)
        ticks: Sequence[float] = self.ticks
        if self.log:
            found["type"] = "log"
            ticks = ticks or log_ticks(*ends)
        if ticks:
            found |= {"tickmode": "array", "tickvals": list(ticks), "ticktext": tick_texts(ticks)}
        return found


def log_ticks(low: float, high: float) -> list[float]:
    """Return the ticks of a logarithmic axis from 10^low to 10^high."""
    decades = range(floor(low), ceil(high) + 1)
    every = ceil((high - low) / MAX_TICKS)
    for steps in STEPS:
        found = [
            step * 10.0**k for k in decades if k % every == 0 for step in steps
            if low <= log10(step) + k <= high
        ]  # fmt: skip
        if len(found) > MIN_TICKS:
            return found
    # the range is so small that a logarithmic axis is nearly linear, so use linear ticks
    first, last = 10**low, 10**high
    power = 10.0 ** floor(log10((last - first) / MIN_TICKS))
    step = max(k * power for k in (1, 2, 5) if k * power <= (last - first) / MIN_TICKS)
    return [step * k for k in range(ceil(first / step), floor(last / step) + 1)]


def tick_texts(ticks: Iterable[float]) -> list[str]:
    """Return the texts for numbers on an axis. Very large and very small numbers become powers of
    ten."""
    ticks = list(ticks)
    if all(tick == 0 or 9e-5 < abs(tick) < 2e5 for tick in ticks):
        return [f"{tick:g}" for tick in ticks]
    powers = [floor(log10(tick) + 1e-9) for tick in ticks]
    steps = [round(tick / 10.0**power, 3) for tick, power in zip(ticks, powers, strict=True)]
    return [
        f"{'' if step == 1 else f'{step:g}·'}10<sup>{power}</sup>"
        for step, power in zip(steps, powers, strict=True)
    ]


def cell_edges(middles: Sequence[float], log: bool) -> list[float]:
    """Return the edges of neighbouring cells, computed from their centres. At least two cells are
    needed."""
    positions = np.log10(middles) if log else np.asarray(middles, float)
    inner = [(a + b) / 2 for a, b in pairwise(positions)]
    found = np.array([2 * positions[0] - inner[0], *inner, 2 * positions[-1] - inner[-1]])
    return (10**found if log else found).tolist()
