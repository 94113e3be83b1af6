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


def rows_of(data: Data, stability_map: StabilityMap) -> Sheet:
    """Return the cells of one map's grids, and the points of the borders by theory."""
    heads = {
        "panel": "panel", "case": "case", "x": stability_map.x_label,
        "y": stability_map.y_label, "z": stability_map.z_label,
    }  # fmt: skip
    map_rows = [r for r in data["stability"]["samples"] if r["map"] == stability_map.key]
    return Sheet.of([{key: r[key] for key in heads} for r in map_rows], heads)


def texts_of(stability_map: StabilityMap) -> dict[str, str]:
    """Return the texts of one map's chart."""
    reading = f"Colours: {stability_map.z_label}; border at {stability_map.level:g}. "
    reading += f"Border by theory: {stability_map.line_label}. {stability_map.note}"
    return {"title": stability_map.title, "reading": reading}


def chart_of(rows: list[Row], stability_map: StabilityMap) -> Drawn:
    """Return the chart of one map."""
    panels = Panels()
    grids = [Grid.of(panel_rows) for panel_rows in group_rows(rows, "panel").values()]
    for grid in grids:
        add_panel(panels, stability_map, grid)
    return Drawn(panels, f"{stability_map.finding} {border_sentence(stability_map, grids)}")


def add_panel(panels: Panels, stability_map: StabilityMap, grid: Grid) -> None:
    """Add a panel for one grid, with the measured and the predicted border."""
    x = axis(stability_map, "x", stability_map.x_label, grid.x)
    y = axis(stability_map, "y", stability_map.y_label, grid.y)
    panel = panels.add(grid.title, x, y)
    panel.heat(
        grid.x,
        grid.y,
        np.clip(np.array(grid.z, float), *stability_map.bounds),
        stability_map.z_label,
        stability_map.bounds,
    )
    observed, _ = borders(stability_map, grid)
    lines = {
        Style("measured border", "black", "", "-"): (grid.x, observed),
        Style("theory", BASELINE, "", "--"): (grid.line_x, grid.line_y),
    }
    for style, places in lines.items():
        line = [{"x": a, "y": b} for a, b in zip(*places, strict=True) if np.isfinite(b)]
        corners = step_line(line, grid.x, "x" in stability_map.log) if stability_map.steps else line
        panel.points(corners, "x", "y", style)


def axis(stability_map: StabilityMap, name: str, label: str, values: Sequence[float]) -> Axis:
    """Return the axis of one parameter, x or y, from edge to edge of the cells."""
    few = (
        stability_map.steps
        and len(values) <= MAX_NAMED
        and all(float(v).is_integer() for v in values)
    )
    ends = cell_edges(values, name in stability_map.log)
    return Axis(
        label,
        name in stability_map.log,
        ticks=tuple(values) if few else (),
        limits=(ends[0], ends[-1]),
    )


def step_line(line: list[Row], x: Sequence[float], log: bool) -> list[Row]:
    """Return a line as steps, constant within each cell."""
    ends = cell_edges(x, log)
    return [r | {"x": ends[x.index(r["x"]) + side]} for r in line for side in (0, 1)]
