"""The charts of where methods fail: a field of colours, the border in it, and the theory's line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from maps.grid import Grid, StabilityMap
from maps.stability import nearness, sample
from report.axis import Axis, edges
from report.chart import Chart, Data, Row, Sheet, by, column
from report.panels import PEER, Panels

MOST_NAMED = 14
"""As many whole numbers on an axis are all named."""

Line = list[tuple[float, float]]


def rows_of(data: Data, one: StabilityMap) -> Sheet:
    """Return the cells of one map's grids, and the points of theory's line."""
    rows = [
        {"panel": s["panel"], "case": case, "x": x, "y": y, "z": z}
        for s in data["stability"]["samples"]
        if s["key"] == one.key
        for case, points in (
            ("measured", [(x, y, z) for y, row in zip(s["y"], s["z"], strict=True)
                          for x, z in zip(s["x"], row, strict=True)]),
            ("theory", [(x, y, None) for x, y in zip(s["line_x"], s["line_y"], strict=True)]),
        )
        for x, y, z in points
    ]  # fmt: skip
    heads = {"x": one.x_label, "y": one.y_label, "z": one.z_label}
    return Sheet.of(rows, {"panel": "panel", "case": "case"} | heads)


def chart_of(rows: list[Row], one: StabilityMap) -> Chart:
    """Return the chart of one map."""
    panels, samples = Panels(), []
    for title, mine in by(rows, "panel").items():
        cells = [r for r in mine if r["case"] == "measured"]
        line = [r for r in mine if r["case"] == "theory"]
        found = Grid(
            title or "", list(by(cells, "x")), list(by(cells, "y")),
            [column(row, "z") for row in by(cells, "y").values()],
            column(line, "x"), column(line, "y"),
        )  # fmt: skip
        samples.append(sample(one, found))
        add_panel(panels, one, samples[-1])
    return Chart(
        f"stability_{one.key}", "", one.title,
        f"Colour: {one.z_label}. Black: where it passes {one.level:g}. Dashed: {one.line_label}. "
        f"{one.note}",
        f"{one.finding} {nearness(samples)}", "", panels,
    )  # fmt: skip


def add_panel(panels: Panels, one: StabilityMap, sample: dict[str, Any]) -> None:
    """Add one grid with its lines."""
    x = sample["x"]
    panel = panels.add(
        sample["panel"], axis(one, "x", one.x_label, x), axis(one, "y", one.y_label, sample["y"])
    )
    low, high = one.bounds
    z = [[None if v is None else float(np.clip(v, low, high)) for v in row] for row in sample["z"]]
    panel.heat(x, sample["y"], z, one.z_label, one.bounds)
    lines = {
        "measured border": ([(a, b) for a, b in zip(x, sample["observed"], strict=True) if b], "-"),
        "theory": (list(zip(sample["line_x"], sample["line_y"], strict=True)), "--"),
    }
    for name, (line, dash) in lines.items():
        corners = steps(line, x, "x" in one.log) if one.steps else line
        colour = PEER if name == "theory" else "black"
        along, up = [a for a, _ in corners], [b for _, b in corners]
        panel.points(name, along, up, colour, "", dash, in_front=False)


def axis(one: StabilityMap, name: str, label: str, values: Sequence[float]) -> Axis:
    """Return the axis of one parameter, x or y, from edge to edge of the cells."""
    few = one.steps and len(values) <= MOST_NAMED and all(float(v).is_integer() for v in values)
    ends = edges(values, name in one.log)
    return Axis(
        label, name in one.log, ticks=tuple(values) if few else (), limits=(ends[0], ends[-1])
    )


def steps(line: Line, x: Sequence[float], log: bool) -> Line:
    """Return the line as steps, level across each cell."""
    ends = edges(x, log)
    number = {value: k for k, value in enumerate(x)}
    return [(ends[number[a] + side], b) for a, b in line for side in (0, 1)]
