"""Grids of the stability maps: measured success or error for values of two parameters, and the
border that theory predicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Numbers = Sequence[float] | np.ndarray
Row = dict[str, Any]


@dataclass(frozen=True)
class Grid:
    """One measured map.

    Attributes
    ----------
    title : str
        Title that distinguishes the grids of one chart. Empty if the chart has only one grid.
    x, y : list
        Values of the two parameters.
    z : list of list
        Success or error: a row for each y, a column for each x.
    line_x, line_y : list
        Points of the border that theory predicts.
    """

    title: str
    x: list[float]
    y: list[float]
    z: list[list[float]]
    line_x: list[float] = field(default_factory=list)
    line_y: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Grid:
        """Return the grid of its `rows`."""
        cells = [r for r in rows if r["case"] == "measured"]
        line = [r for r in rows if r["case"] == "theory"]
        x, y = (list(dict.fromkeys(r[key] for r in cells)) for key in "xy")
        z = np.reshape([r["z"] for r in cells], (len(y), len(x))).tolist()
        return cls(rows[0]["panel"] or "", x, y, z, *([r[key] for r in line] for key in "xy"))

    @property
    def rows(self) -> list[Row]:
        """Rows for all cells and all points of the border by theory, with the keys `panel`, `case`,
        `x`, `y`, `z`."""
        cells = [(x, y, z) for y, row in zip(self.y, self.z, strict=True)
                 for x, z in zip(self.x, row, strict=True)]  # fmt: skip
        line = [(x, y, None) for x, y in zip(self.line_x, self.line_y, strict=True)]
        return [
            {"panel": self.title, "case": case, "x": x, "y": y, "z": z}
            for case, places in (("measured", cells), ("theory", line))
            for x, y, z in places
        ]


def grid(
    x: Numbers, y: Numbers, z: list[list[float]], line_x: Numbers, line_y: Numbers, title: str = ""
) -> Grid:
    """Return a grid, with arrays converted to lists of numbers."""
    plain = (np.asarray(numbers, float).tolist() for numbers in (x, y, z, line_x, line_y))
    return Grid(title, *plain)


@dataclass(frozen=True)
class StabilityMap:
    """Definition of a stability map, and of its chart.

    Attributes
    ----------
    key : str
        Key of the map's table and chart.
    title : str
    x_label, y_label, z_label, line_label : str
        Labels with units.
    level : float
        Value of z at the border.
    measure : function of bool
        Function that measures all grids. If its argument is True, the measurement is quick.
    bounds : (float, float)
        Ends of the colour scale.
    log : str
        Axes with a logarithmic scale: "", "x", "y" or "xy".
    steps : bool
        Whether x is a whole number, so that lines are drawn as steps.
    finding : str
        Conclusion.
    note : str
        Description of the measurement.
    """

    key: str
    title: str
    x_label: str
    y_label: str
    z_label: str
    line_label: str
    level: float
    measure: Callable[[bool], list[Grid]]
    bounds: tuple[float, float]
    log: str = ""
    steps: bool = False
    finding: str = ""
    note: str = ""


def crossing(position: Sequence[float], value: Sequence[float], level: float) -> float:
    """Return the position at which a curve first crosses a level, by linear interpolation. NaN if
    the curve does not cross the level."""
    above = np.asarray(value, float) >= level
    crossings = np.flatnonzero(above[1:] != above[:-1])
    if not len(crossings):
        return float("nan")
    k = crossings[0]
    fraction = (level - value[k]) / (value[k + 1] - value[k])
    return float(position[k] + fraction * (position[k + 1] - position[k]))
