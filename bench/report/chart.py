"""What a chart is, whoever draws it: panels of points, lines and fields over two axes.

`plot` draws it as a picture, `interactive` as a figure to point at and to zoom.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, floor, log10
from typing import Any

from plate_core import PlateError

OURS, PEER, SECOND, THIRD, FAINT, LIMIT = (
    "#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#767676", "#b02a37",
)  # fmt: skip
"""Colours: our default, the peers, our second and third, notes, limits."""

FIELD = ("#ffffd9", "#7fcdbb", "#2c7fb8")
"""Colours of a field from low to high: black and coloured lines are seen on all of them."""

FRONT = "Pareto front"

FEW_DECADES, MOST_DECADES = 2, 6
"""Log axes with fewer decades have numbers between; with more not every one has a number."""

Row = dict[str, Any]
Data = Mapping[str, Mapping[str, Any]]
"""Measurements by name, as in their JSON files."""


@dataclass(frozen=True)
class Axis:
    """One axis: its label with the unit, and how it is divided.

    Attributes
    ----------
    names : tuple of str
        Kinds instead of numbers: the axis of a bar chart, from below.
    ticks : tuple of float
        Where there is a number; anywhere if empty.
    limits : (low, high), optional
    """

    label: str
    log: bool = False
    names: tuple[str, ...] = ()
    ticks: tuple[float, ...] = ()
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Points:
    """Points of one kind, joined by a line or not.

    Attributes
    ----------
    x, y : sequences of the same length
        Numbers, or names of the axis. None: no point there.
    marker : str
        `o`, `s`, `D`, `^`, `v`, `x`; empty: a line only.
    line : str
        `-`, `--`, `:`; empty: points only.
    hollow : tuple of bool
        Points that do not count (parts missed, speed not kept): no front touches them.
    notes : tuple of str
        What is told of each point when it is pointed at.
    labels : tuple of str
        What is written beside each point.
    in_front : bool
        Whether the points take part in the Pareto front.
    bars : bool
        Bars from the left, stacked on those of the panel's earlier points.
    """

    name: str
    x: Sequence[Any]
    y: Sequence[Any]
    colour: str = OURS
    marker: str = "o"
    line: str = ""
    hollow: tuple[bool, ...] = ()
    notes: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    in_front: bool = True
    bars: bool = False


@dataclass(frozen=True)
class Field:
    """Values over a grid, drawn as colours.

    Attributes
    ----------
    x, y : (n,), (m,)
        Middles of the cells.
    z : (m, n)
        None where there is no value.
    limits : (low, high), optional
        Of the colours.
    """

    x: Sequence[float]
    y: Sequence[float]
    z: Sequence[Sequence[float | None]]
    label: str
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Rule:
    """A straight line across the panel, at one `x` or at one `y`, with a word on it."""

    text: str
    x: float | None = None
    y: float | None = None
    colour: str = FAINT


@dataclass(frozen=True)
class Mark:
    """A ring round our default."""

    x: float
    y: float
    text: str = "our default"


@dataclass(frozen=True)
class Panel:
    """One pair of axes and what is in it.

    Attributes
    ----------
    better : str
        Where the Pareto front is: `less less`, `more less`, ... for x and y; empty: there is none.
    """

    title: str
    x: Axis
    y: Axis
    points: tuple[Points, ...] = ()
    rules: tuple[Rule, ...] = ()
    marks: tuple[Mark, ...] = ()
    better: str = ""
    field: Field | None = None


@dataclass(frozen=True)
class Chart:
    """Panels that answer one question, the rows behind them, and what they say.

    Attributes
    ----------
    key : str
        Name of files and of the place in the page.
    letter : str
        Of the list of charts; may be empty.
    title, reading : str
        The question; how to read the panels.
    finding : str
        What comes out, with figures.
    default : str
        What we take and why; empty where nothing is to be chosen.
    sources : tuple of str
        Measurements it is drawn from.
    rows : list of dict
        With the same keys, for the table and the CSV file.
    columns : mapping of str to str
        Key of a row -> heading with its unit.
    """

    key: str
    letter: str
    title: str
    reading: str
    finding: str
    default: str
    sources: tuple[str, ...]
    panels: tuple[Panel, ...]
    rows: list[Row]
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def headings(self) -> dict[str, str]:
        """Key of each column and its heading."""
        return {key: self.columns.get(key, key.replace("_", " ")) for key in self.rows[0]}


def table(data: Data, name: str, key: str) -> list[Row]:
    """Return the rows of one table of a measurement.

    Raises
    ------
    PlateError
        If it is not there: the measurement is of older code.
    """
    return list(_table(data, name, key)["rows"])


def columns(data: Data, name: str, key: str) -> dict[str, str]:
    """Return the headings of one table of a measurement."""
    return dict(_table(data, name, key)["columns"])


def _table(data: Data, name: str, key: str) -> Mapping[str, Any]:
    found = [t for t in data[name]["tables"] if t["key"] == key] if name in data else []
    if not found:
        raise PlateError(f"measurement {name} has no table {key!r}: it has to be made again")
    return dict(found[0])


def pareto_front(panel: Panel) -> list[tuple[float, float]]:
    """Return the corners of the Pareto front as a staircase; empty where the panel has none.

    Beyond the staircase no point is better in both.
    """
    if not panel.better:
        return []
    more_x, more_y = (word == "more" for word in panel.better.split())
    places = [
        (-x if more_x else x, -y if more_y else y)
        for points in panel.points
        if points.in_front
        for k, (x, y) in enumerate(zip(points.x, points.y, strict=True))
        if x is not None and y is not None and not (points.hollow and points.hollow[k])
    ]
    corners: list[tuple[float, float]] = []
    for x, y in sorted(set(places)):
        if not corners:
            corners.append((x, y))
        elif y < corners[-1][1]:
            corners += [(x, corners[-1][1]), (x, y)]
    return [(-x if more_x else x, -y if more_y else y) for x, y in corners]


def values(panel: Panel, which: str) -> list[float]:
    """Return all numbers of a panel along one axis."""
    found = [value for points in panel.points for value in getattr(points, which)]
    found += [value for rule in panel.rules if (value := getattr(rule, which)) is not None]
    return [value for value in found if isinstance(value, int | float)]


def edges(axis: Axis, middles: Sequence[float]) -> list[float]:
    """Return the edges between cells of a field whose middles are given, two at least."""
    at = [log10(value) if axis.log else value for value in middles]
    inner = [(a + b) / 2 for a, b in pairwise(at)]
    found = [2 * at[0] - inner[0], *inner, 2 * at[-1] - inner[-1]]
    return [10**value if axis.log else value for value in found]


def ticks_of(axis: Axis, values: list[float]) -> list[float]:
    """Return where an axis with these numbers on it has ticks; empty: where the drawer likes.

    On a log axis: 1, 2, 5 in each decade, or the decades alone.
    """
    if axis.ticks or not axis.log:
        return list(axis.ticks)
    positive = [value for value in values if value > 0]
    if not positive:
        return []
    low, high = floor(log10(min(positive))), ceil(log10(max(positive)))
    steps = (1, 2, 5) if high - low <= FEW_DECADES else (1,)
    every = max(1, (high - low) // MOST_DECADES)
    return [step * 10.0**power for power in range(low - 1, high + 2, every) for step in steps]
