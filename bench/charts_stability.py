"""The charts of where methods fail: a field of colours, the border in it, and the theory's line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from chart import PEER, Axis, Chart, Data, Field, Panel, Points, columns, table
from measure_stability import MAPS, nearness
from stability_map import StabilityMap

Line = list[tuple[float, float]]


def chart_of(data: Data, one: StabilityMap) -> Chart:
    """Return the chart of one map."""
    samples = [s for s in data["stability"]["samples"] if s["key"] == one.key]
    rows = table(data, "stability", one.key)
    heads = columns(data, "stability", one.key)
    return Chart(
        f"stability_{one.key}",
        "",
        f"Where methods fail: {one.title}",
        f"Colour: {one.z_label}. Black: where it passes {one.level:g}. Dashed: {one.line_label}. "
        f"{one.note}",
        f"{one.finding} Along the dashed line, {nearness(samples)}",
        "",
        ("stability",),
        tuple(panel(one, s) for s in samples),
        [{key: row[key] for key in heads} for row in rows],
        heads,
    )


def panel(one: StabilityMap, sample: dict[str, Any]) -> Panel:
    """Return one grid with its lines."""
    x, y = (edges(sample[name], name in one.log) for name in ("x", "y"))
    border = [(a, b) for a, b in zip(sample["x"], sample["observed"], strict=True) if b is not None]
    theory = list(zip(sample["line_x"], sample["line_y"], strict=True))
    if one.steps:
        border, theory = steps(border, sample["x"], x), steps(theory, sample["x"], x)
    low, high = one.bounds
    z = [[None if v is None else float(np.clip(v, low, high)) for v in row] for row in sample["z"]]
    ticks = {name: tuple(sample[name]) if counts(sample[name], one) else () for name in ("x", "y")}
    return Panel(
        sample["panel"],
        Axis(one.x_label, "x" in one.log, ticks=ticks["x"], limits=(x[0], x[-1])),
        Axis(one.y_label, "y" in one.log, ticks=ticks["y"], limits=(y[0], y[-1])),
        (
            Points("measured border", *split(border), "black", "", "-", in_front=False),
            Points("theory", *split(theory), PEER, "", "--", in_front=False),
        ),
        field=Field(sample["x"], sample["y"], z, one.z_label, one.bounds),
    )


def counts(values: Sequence[float], one: StabilityMap) -> bool:
    """Whether these are few whole numbers, each to be named."""
    return one.steps and len(values) <= 14 and all(float(v).is_integer() for v in values)


def edges(values: Sequence[float], log: bool) -> list[float]:
    """Return the edges between cells whose middles are given."""
    at = np.log(values) if log else np.asarray(values, dtype=float)
    middle = (at[1:] + at[:-1]) / 2
    found = np.concatenate([[2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]])
    return (np.exp(found) if log else found).tolist()


def steps(line: Line, x: Sequence[float], ends: Sequence[float]) -> Line:
    """Return the line as steps, level across each cell."""
    column = {value: k for k, value in enumerate(x)}
    return [(ends[column[a] + side], b) for a, b in line for side in (0, 1)]


def split(line: Line) -> tuple[list[float], list[float]]:
    """Return x and y of a line."""
    return [a for a, _ in line], [b for _, b in line]


STABILITY: tuple[Callable[[Data], Chart], ...] = tuple(
    partial(chart_of, one=one) for one in MAPS.values()
)
