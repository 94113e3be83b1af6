"""The charts of where methods fail: a field of colours, the border in it, and the theory's line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from maps.grid import StabilityMap
from maps.stability import MAPS, nearness
from report.chart import PEER, Axis, Chart, Data, Field, Panel, Points, columns, edges, table

MOST_NAMED = 14
"""As many whole numbers on an axis are all named."""

Line = list[tuple[float, float]]


def chart_of(data: Data, one: StabilityMap) -> Chart:
    """Return the chart of one map."""
    samples = [s for s in data["stability"]["samples"] if s["key"] == one.key]
    rows = table(data, "stability", one.key)
    heads = columns(data, "stability", one.key)
    return Chart(
        f"stability_{one.key}",
        "",
        one.title,
        f"Colour: {one.z_label}. Black: where it passes {one.level:g}. Dashed: {one.line_label}. "
        f"{one.note}",
        f"{one.finding} {nearness(samples)}",
        "",
        ("stability",),
        tuple(panel(one, s) for s in samples),
        [{key: row[key] for key in heads} for row in rows],
        heads,
    )


def panel(one: StabilityMap, sample: dict[str, Any]) -> Panel:
    """Return one grid with its lines."""
    across, up = (axis(one, name, sample[name]) for name in ("x", "y"))
    border = [(a, b) for a, b in zip(sample["x"], sample["observed"], strict=True) if b is not None]
    theory = list(zip(sample["line_x"], sample["line_y"], strict=True))
    if one.steps:
        border, theory = (steps(line, sample["x"], across) for line in (border, theory))
    low, high = one.bounds
    z = [[None if v is None else float(np.clip(v, low, high)) for v in row] for row in sample["z"]]
    return Panel(
        sample["panel"],
        across,
        up,
        (
            Points("measured border", *split(border), "black", "", "-", in_front=False),
            Points("theory", *split(theory), PEER, "", "--", in_front=False),
        ),
        field=Field(sample["x"], sample["y"], z, one.z_label, one.bounds),
    )


def axis(one: StabilityMap, name: str, values: Sequence[float]) -> Axis:
    """Return the axis of one parameter, x or y, from edge to edge of the cells."""
    few = one.steps and len(values) <= MOST_NAMED and all(float(v).is_integer() for v in values)
    label = one.x_label if name == "x" else one.y_label
    plain = Axis(label, name in one.log, ticks=tuple(values) if few else ())
    ends = edges(plain, values)
    return replace(plain, limits=(ends[0], ends[-1]))


def steps(line: Line, x: Sequence[float], across: Axis) -> Line:
    """Return the line as steps, level across each cell."""
    ends = edges(across, x)
    column = {value: k for k, value in enumerate(x)}
    return [(ends[column[a] + side], b) for a, b in line for side in (0, 1)]


def split(line: Line) -> tuple[list[float], list[float]]:
    """Return x and y of a line."""
    return [a for a, _ in line], [b for _, b in line]


STABILITY: tuple[Callable[[Data], Chart], ...] = tuple(
    partial(chart_of, one=one) for one in MAPS.values()
)
