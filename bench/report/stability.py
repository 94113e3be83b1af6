"""Charts of the stability maps: a field of colours, the measured border, and the border by
theory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maps.grid import Grid, StabilityMap
from maps.stability import border_sentence, borders
from report.axis import Axis, cell_edges
from report.chart import Data, Drawn, Sheet
from report.panels import BASELINE, Panels, Row, Style, group_rows

MAX_NAMED = 14
"""Maximum number of integer values on an axis for which each value has a label."""


def rows_of(data: Data, one: StabilityMap) -> Sheet:
    """Return the cells of one map's grids, and the points of the borders by theory."""
    heads = {
        "panel": "panel", "case": "case", "x": one.x_label, "y": one.y_label, "z": one.z_label,
    }  # fmt: skip
    mine = [r for r in data["stability"]["samples"] if r["map"] == one.key]
    return Sheet.of([{key: r[key] for key in heads} for r in mine], heads)


def texts_of(one: StabilityMap) -> dict[str, str]:
    """Return the texts of one map's chart."""
    reading = f"Colours: {one.z_label}; border at {one.level:g}. "
    reading += f"Border by theory: {one.line_label}. {one.note}"
    return {"title": one.title, "reading": reading}


def chart_of(rows: list[Row], one: StabilityMap) -> Drawn:
    """Return the chart of one map."""
    panels, grids = Panels(), [Grid.of(mine) for mine in group_rows(rows, "panel").values()]
    for grid in grids:
        add_panel(panels, one, grid)
    return Drawn(panels, f"{one.finding} {border_sentence(one, grids)}")


def add_panel(panels: Panels, one: StabilityMap, grid: Grid) -> None:
    """Add a panel for one grid, with the measured and the predicted border."""
    x, y = axis(one, "x", one.x_label, grid.x), axis(one, "y", one.y_label, grid.y)
    panel = panels.add(grid.title, x, y)
    panel.heat(
        grid.x, grid.y, np.clip(np.array(grid.z, float), *one.bounds), one.z_label, one.bounds
    )
    observed, _ = borders(one, grid)
    lines = {
        Style("measured border", "black", "", "-"): (grid.x, observed),
        Style("theory", BASELINE, "", "--"): (grid.line_x, grid.line_y),
    }
    for style, places in lines.items():
        line = [{"x": a, "y": b} for a, b in zip(*places, strict=True) if np.isfinite(b)]
        corners = step_line(line, grid.x, "x" in one.log) if one.steps else line
        panel.points(corners, "x", "y", style)


def axis(one: StabilityMap, name: str, label: str, values: Sequence[float]) -> Axis:
    """Return the axis of one parameter, x or y, from edge to edge of the cells."""
    few = one.steps and len(values) <= MAX_NAMED and all(float(v).is_integer() for v in values)
    ends = cell_edges(values, name in one.log)
    return Axis(
        label, name in one.log, ticks=tuple(values) if few else (), limits=(ends[0], ends[-1])
    )


def step_line(line: list[Row], x: Sequence[float], log: bool) -> list[Row]:
    """Return a line as steps, constant within each cell."""
    ends = cell_edges(x, log)
    return [r | {"x": ends[x.index(r["x"]) + side]} for r in line for side in (0, 1)]
