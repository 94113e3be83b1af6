"""Charts as pictures, for docs/results.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import NullLocator

from report.chart import (
    FIELD,
    FRONT,
    Axis,
    Chart,
    Panel,
    Points,
    Rule,
    edges,
    pareto_front,
    ticks_of,
    values,
)

PANEL_IN = (4.6, 3.6)
"""Width and height of a panel [inch]."""

ROW = 3
"""Most panels beside each other; four make two rows."""

DPI = 100

HALO = [withStroke(linewidth=2.5, foreground="white")]
"""Keeps text legible on lines and points."""

COLOURS = LinearSegmentedColormap.from_list("field", FIELD)

STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "lines.markersize": 6,
}


def save_picture(chart: Chart, path: Path) -> None:
    """Draw a chart into a PNG file."""
    mpl.use("agg")
    count = len(chart.panels)
    wide = count if count <= ROW else 2 if count == 4 else ROW
    high = -(-count // wide)
    with mpl.rc_context(STYLE):
        size = (max(1.5, wide) * PANEL_IN[0], high * PANEL_IN[1] + 0.5)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(high, wide, squeeze=False).ravel()
        for axes, panel in zip(grid, chart.panels, strict=False):
            draw_panel(figure, axes, panel)
        for axes in grid[count:]:
            axes.set_axis_off()
        add_legend(figure, grid[:count], wide)
        figure.savefig(path, dpi=DPI)


def draw_panel(figure: Figure, axes: Axes, panel: Panel) -> None:
    """Draw one panel."""
    set_axis(axes, "x", panel.x)
    set_axis(axes, "y", panel.y)
    axes.set_title(panel.title)
    axes.margins(0.1)
    if panel.field is not None:
        field = panel.field
        z = np.array([[np.nan if v is None else v for v in row] for row in field.z])
        low, high = field.limits or (None, None)
        sides = edges(panel.x, field.x), edges(panel.y, field.y)
        mesh = axes.pcolormesh(*sides, z, cmap=COLOURS, vmin=low, vmax=high)
        axes.grid(False)
        figure.colorbar(mesh, ax=axes, label=field.label)
    left = np.zeros(len(panel.y.names))
    for points in panel.points:
        if points.bars:
            place = [panel.y.names.index(name) for name in points.y]
            drawn = axes.barh(
                place, points.x, 0.6, left[place], color=points.colour, label=points.name
            )
            axes.bar_label(drawn, points.labels or [""] * len(place), padding=3, fontsize=8.5)
            left[place] += np.array(points.x, float)
        else:
            draw_points(axes, panel, points)
    set_ticks(axes, "x", panel.x, ticks_of(panel.x, values(panel, "x")))
    set_ticks(axes, "y", panel.y, ticks_of(panel.y, values(panel, "y")))
    draw_front(axes, panel)
    for rule in panel.rules:
        draw_rule(axes, rule)
    for mark in panel.marks:
        axes.plot(mark.x, mark.y, "o", ms=15, mfc="none", mec="black", mew=1.3)
        across = axes.transAxes.inverted().transform(axes.transData.transform((mark.x, mark.y)))[0]
        axes.annotate(
            mark.text, (mark.x, mark.y), (0, 11), textcoords="offset points", fontsize=9,
            ha="left" if across < 0.12 else "right" if across > 0.88 else "center", va="bottom",
            path_effects=HALO,
        )  # fmt: skip


def draw_rule(axes: Axes, rule: Rule) -> None:
    """Draw a line across, and what it says; nothing where it lies outside of what is shown."""
    upright = rule.x is not None
    place = rule.x if upright else rule.y
    low, high = sorted(axes.get_xlim() if upright else axes.get_ylim())
    if place is None or not low <= place <= high:
        return
    line = axes.axvline if upright else axes.axhline
    line(place, color=rule.colour, lw=1, ls="--")
    x, y, turn, across = 0.99, place, 0, axes.get_yaxis_transform()
    if upright:
        x, y, turn, across = place, 0.02, 90, axes.get_xaxis_transform()
    axes.text(
        x, y, rule.text, color=rule.colour, fontsize=8.5, transform=across, rotation=turn,
        ha="right", va="bottom", path_effects=HALO,
    )  # fmt: skip


def draw_points(axes: Axes, panel: Panel, points: Points) -> None:
    """Draw points and their line; hollow ones have a white middle."""
    x, y = (
        [np.nan if v is None else axis.names.index(v) if axis.names else v for v in values]
        for axis, values in ((panel.x, points.x), (panel.y, points.y))
    )
    axes.plot(
        x, y, marker=points.marker or None, ls=points.line or "none", color=points.colour,
        label=points.name, lw=1.5, mfc=points.colour,
    )  # fmt: skip
    hollow = np.array(points.hollow or [False] * len(x))
    if hollow.any():
        axes.plot(
            np.array(x)[hollow], np.array(y)[hollow], points.marker, ls="none", mfc="white",
            color=points.colour,
        )  # fmt: skip
    for at_x, at_y, text in zip(x, y, points.labels, strict=False):
        if text:
            axes.annotate(
                text, (at_x, at_y), (6, 3), textcoords="offset points", fontsize=8.5,
                color=points.colour, path_effects=HALO,
            )  # fmt: skip


def draw_front(axes: Axes, panel: Panel) -> None:
    """Draw the Pareto front, out to the panel's edges."""
    corners = pareto_front(panel)
    if not corners:
        return
    (first, last), (x, y) = (corners[0], corners[-1]), panel.better.split()
    limits = axes.get_xlim(), axes.get_ylim()
    start = (first[0], limits[1][y == "less"])
    end = (limits[0][x == "less"], last[1])
    axes.plot(*zip(start, *corners, end, strict=True), color="black", lw=0.9, label=FRONT, zorder=1)
    axes.set(xlim=limits[0], ylim=limits[1])


def set_axis(axes: Axes, which: str, axis: Axis) -> None:
    """Set scale, label and limits of an axis."""
    settings: dict[str, Any] = {f"{which}label": axis.label}
    if axis.log:
        settings[f"{which}scale"] = "log"
    if axis.limits:
        settings[f"{which}lim"] = axis.limits
    axes.set(**settings)


def set_ticks(axes: Axes, which: str, axis: Axis, ticks: list[float]) -> None:
    """Set the divisions of an axis on which everything is drawn."""
    mine = axes.xaxis if which == "x" else axes.yaxis
    if axis.names:
        mine.set_ticks(range(len(axis.names)), axis.names)
        mine.grid(False)
    elif ticks:
        limits = axes.get_xlim() if which == "x" else axes.get_ylim()
        mine.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        mine.set_minor_locator(NullLocator())
        axes.set(**{f"{which}lim": limits})


def add_legend(figure: Figure, grid: Any, wide: int) -> None:
    """Name every kind of points once, above panels of which so many are beside each other."""
    named: dict[str, Any] = {}
    for axes in grid:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    if len(named) > 1 or FRONT in named:
        figure.legend(
            list(named.values()), list(named), loc="outside upper center", fontsize=9,
            ncols=min(len(named), 2 * wide),
        )  # fmt: skip
