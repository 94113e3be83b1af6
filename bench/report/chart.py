"""What a chart is: panels in one plotly figure, the rows behind it, and what they say.

The same figure is drawn in the page, to point at and to zoom, and written as a picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, floor, isfinite, log10
from typing import Any

import numpy as np
import pandas as pd
from plotly import graph_objects as go
from plotly.subplots import make_subplots

from plate_core import PlateError

OURS, PEER, SECOND, THIRD, FAINT, LIMIT = (
    "#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#767676", "#b02a37",
)  # fmt: skip
"""Colours: our default, the peers, our second and third, notes, limits."""

INK, GRID = "#222222", "#e4e4e4"

FIELD = ("#ffffd9", "#7fcdbb", "#2c7fb8")
"""Colours of a field from low to high: black and coloured lines are seen on all of them."""

SYMBOLS = {
    "o": "circle", "s": "square", "D": "diamond", "^": "triangle-up", "v": "triangle-down",
    "x": "x-thin",
}  # fmt: skip
DASHES = {"-": "solid", "--": "dash", ":": "dot"}

FRONT, DEFAULT = "Pareto front", "our default"

ACROSS = 3
"""Most panels beside each other; four make two rows."""

PANEL_PX, KEY_PX, BAR_PX = (440, 330), 40, 26
"""Width and height of a panel, height of the key, and of one line of a bar chart."""

LABEL_PX, NAMES_PX = 85, 170
"""Between panels: room for numbers and the axis' label, and for names of bars."""

FEW_DECADES = 3
"""Log axes with no more decades have ticks at 1, 2 and 5."""

Row = dict[str, Any]
Data = Mapping[str, Mapping[str, Any]]
"""Measurements by name, as in their JSON files."""


@dataclass(frozen=True)
class Chart:
    """A figure that answers one question, the rows behind it, and what they say.

    Attributes
    ----------
    key : str
        Name of files and of the place in the page.
    letter : str
        Of the list of charts; may be empty.
    title, reading : str
        The question; how to read the figure.
    finding : str
        What comes out, with numbers.
    default : str
        What we take and why; empty where nothing is to be chosen.
    sources : tuple of str
        Measurements it is drawn from.
    panels : Panels
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
    panels: Panels
    rows: list[Row]
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def full_title(self) -> str:
        """The title with its letter."""
        return f"({self.letter}) {self.title}" if self.letter else self.title

    @property
    def frame(self) -> pd.DataFrame:
        """The rows, under their headings."""
        heads = {key: self.columns.get(key, key.replace("_", " ")) for key in self.rows[0]}
        return pd.DataFrame(self.rows).rename(columns=heads)


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


class Panels:
    """Panels of one figure with one key, each added by `add` and then drawn into.

    Attributes
    ----------
    titles : list of str
    figure : go.Figure
        Made by `draw`.
    """

    def __init__(self) -> None:
        self.list: list[Panel] = []

    def add(self, title: str, x: Axis, y: Axis, better: str = "") -> Panel:
        """Add a panel and return it.

        Parameters
        ----------
        better : str
            Where the Pareto front is: `less less`, `more less`, ... for x and y; empty: nowhere.
        """
        self.list.append(Panel(title, x, y, better))
        return self.list[-1]

    @property
    def across(self) -> int:
        """How many are beside each other."""
        count = len(self.list)
        return count if count <= ACROSS else 2 if count == 4 else ACROSS

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the figure [px]."""
        lines = max(len(panel.y.names) for panel in self.list)
        down = -(-len(self.list) // self.across)
        high = max(PANEL_PX[1], 110 + BAR_PX * lines)
        return max(2, self.across) * PANEL_PX[0], down * high + self._key_px

    @property
    def _named(self) -> bool:
        """Whether an axis has names instead of numbers."""
        return any(panel.y.names for panel in self.list)

    @property
    def _key_px(self) -> int:
        names = dict.fromkeys(t.name for panel in self.list for t in panel.traces if t.name)
        letters = sum(len(name) + 8 for name in names)
        return KEY_PX + 20 * int(letters * 7 / (max(2, self.across) * PANEL_PX[0]))

    def draw(self) -> go.Figure:
        """Return the figure."""
        across, down = self.across, -(-len(self.list) // self.across)
        wide, high = self.size_px
        figure = make_subplots(
            down, across, subplot_titles=[panel.title for panel in self.list],
            horizontal_spacing=(NAMES_PX if self._named else LABEL_PX) / wide,
            vertical_spacing=95 / high,
        )  # fmt: skip
        figure.update_annotations(font_size=14)
        named: set[str] = set()
        for number, panel in enumerate(self.list):
            row, column = number // across + 1, number % across + 1
            for trace in [*panel.traces, *panel.front()]:
                if trace.name:
                    trace.legendgroup, trace.showlegend = trace.name, trace.name not in named
                    named.add(trace.name)
                figure.add_trace(trace, row, column)
            panel.draw_rules(figure, "" if not number else str(number + 1))
            figure.update_xaxes(panel.x.settings(panel.places("x")), row=row, col=column)
            figure.update_yaxes(panel.y.settings(panel.places("y")), row=row, col=column)
        figure.update_layout(
            template="none", height=high, barmode="stack", hovermode="closest",
            font={"family": "sans-serif", "size": 12, "color": INK},
            margin={"l": 65, "r": 20, "t": 25 + self._key_px, "b": 55},
            legend={"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
            showlegend=len(named) > 1 or FRONT in named,
            coloraxis={"colorscale": list(FIELD), "colorbar": {"thickness": 14}},
            hoverlabel={"align": "left"},
        )  # fmt: skip
        for low, most in [panel.field for panel in self.list if panel.field is not None]:
            figure.update_layout(coloraxis={"cmin": low, "cmax": most})
        return figure


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

    def place(self, value: float) -> float:
        """Return where plotly puts words and ends of ranges: at the exponent, on a log axis."""
        return log10(value) if self.log else value

    def settings(self, values: Sequence[float]) -> dict[str, Any]:
        """Return plotly's settings of the axis with these numbers on it."""
        found: dict[str, Any] = {
            "title": {"text": self.label, "standoff": 6, "font": {"size": 12}},
            "gridcolor": GRID, "zeroline": False,
            "ticks": "outside", "tickcolor": GRID, "linecolor": "#888888", "showline": True,
            "automargin": True,
        }  # fmt: skip
        if self.names:
            return found | {
                "type": "category", "categoryorder": "array", "categoryarray": list(self.names),
                "showgrid": False,
            }  # fmt: skip
        ticks = list(self.ticks)
        if self.log:
            found |= {"type": "log"}
            powers = [log10(value) for value in values if value > 0] or [0.0]
            low, high = floor(min(powers)), ceil(max(powers))
            if max(powers) - min(powers) > FEW_DECADES:
                found |= {"dtick": max(1, round((high - low) / 6)), "exponentformat": "power"}
            elif not ticks:
                every = range(low - 1, high + 1)
                ticks = [step * 10.0**power for power in every for step in (1, 2, 5)]
        if ticks:
            found |= {"tickmode": "array", "tickvals": ticks}
            found |= {"ticktext": [f"{tick:g}" for tick in ticks]}
        if self.limits:
            found["range"] = [self.place(end) for end in self.limits]
        return found


class Panel:
    """One pair of axes and what is in it."""

    def __init__(self, title: str, x: Axis, y: Axis, better: str) -> None:
        self.title, self.x, self.y, self.better = title, x, y, better
        self.traces: list[Any] = []
        self.field: tuple[float | None, float | None] | None = None
        self._counted: list[tuple[float, float]] = []
        self._rules: list[tuple[str, float | None, float | None, str]] = []

    def points(
        self, name: str, x: Sequence[Any], y: Sequence[Any], colour: str = OURS, marker: str = "o",
        line: str = "", *, hollow: Sequence[bool] = (), notes: Sequence[str] = (),
        labels: Sequence[str] = (), in_front: bool = True,
    ) -> None:  # fmt: skip
        """Draw points of one kind, joined by a line or not.

        Parameters
        ----------
        x, y : sequences of the same length
            Numbers, or names of the axis. None: no point there.
        marker : str
            A key of `SYMBOLS`; empty: a line only.
        line : str
            A key of `DASHES`; empty: points only.
        hollow : sequence of bool
            Points that do not count (parts missed, speed not kept): no front touches them.
        notes, labels : sequences of str
            What the page shows of each point under the pointer; what is written beside it.
        in_front : bool
            Whether the points take part in the Pareto front.
        """
        empty = list(hollow) or [False] * len(x)
        there = (("lines", line), ("markers", marker), ("text", any(labels)))
        self.traces.append(
            go.Scatter(
                x=list(x), y=list(y), name=name, mode="+".join(word for word, on in there if on),
                line={"color": colour, "width": 2, "dash": DASHES.get(line, "solid")},
                marker={
                    "symbol": SYMBOLS.get(marker, "circle"), "size": 8,
                    "color": ["white" if one else colour for one in empty],
                    "line": {"color": colour, "width": 2 if marker == "x" or any(empty) else 1},
                },
                text=list(labels) or None, textposition="middle right", cliponaxis=False,
                textfont={"color": colour, "size": 11},
                customdata=list(notes) or [""] * len(x),
                hovertemplate=f"<b>{name}</b><br>%{{customdata}}<br>x: %{{x}}<br>y: %{{y}}"
                "<extra></extra>",
            )
        )  # fmt: skip
        if in_front:
            pairs = zip(x, y, empty, strict=True)
            self._counted += [(a, b) for a, b, out in pairs if None not in (a, b) and not out]

    def bars(
        self, name: str, length: Sequence[float], names: Sequence[str], colour: str = OURS,
        labels: Sequence[str] = (),
    ) -> None:  # fmt: skip
        """Draw bars from the left, stacked on those that are there."""
        self.traces.append(
            go.Bar(
                x=list(length), y=list(names), name=name, orientation="h", cliponaxis=False,
                marker={"color": colour}, text=list(labels) or None, textposition="outside",
                hovertemplate=f"<b>{name}</b><br>%{{y}}: %{{x}}<extra></extra>",
            )
        )  # fmt: skip

    def heat(
        self, x: Sequence[float], y: Sequence[float], z: Sequence[Sequence[float | None]],
        label: str, limits: tuple[float | None, float | None] = (None, None),
    ) -> None:  # fmt: skip
        """Draw values z (m, n) over a grid as colours; x (n,) and y (m,) are cells' middles."""
        self.field = limits
        self.traces.append(
            go.Heatmap(
                x=edges(x, self.x.log), y=edges(y, self.y.log), z=[list(row) for row in z],
                coloraxis="coloraxis", customdata=[[[a, b] for a in x] for b in y],
                hovertemplate=f"{self.x.label}: %{{customdata[0]:.4g}}<br>{self.y.label}: "
                f"%{{customdata[1]:.4g}}<br>{label}: %{{z:.3g}}<extra></extra>",
            )
        )  # fmt: skip

    def mark(self, x: float, y: float) -> None:
        """Draw a ring round our default."""
        self.traces.append(
            go.Scatter(
                x=[x], y=[y], name=DEFAULT, mode="markers", hoverinfo="skip",
                marker={"symbol": "circle-open", "size": 17, "color": INK, "line": {"width": 2}},
            )
        )  # fmt: skip

    def rule(
        self, text: str, x: float | None = None, y: float | None = None, colour: str = FAINT
    ) -> None:
        """Draw a straight line across, at one x or one y, with a word on it."""
        self._rules.append((text, x, y, colour))

    def draw_rules(self, figure: go.Figure, number: str) -> None:
        """Draw all such lines into the figure's pair of axes with a number."""
        for text, x, y, colour in self._rules:
            line = {"color": colour, "width": 1.2, "dash": "dash"}
            word: dict[str, Any] = {
                "text": text, "showarrow": False, "font": {"color": colour, "size": 11},
                "yanchor": "bottom", "xanchor": "right",
            }  # fmt: skip
            if x is not None:
                across = {"xref": f"x{number}", "yref": f"y{number} domain"}
                figure.add_shape(type="line", x0=x, x1=x, y0=0, y1=1, line=line, **across)
                word |= {"x": self.x.place(x), "y": 0.02, "textangle": -90, **across}
            elif y is not None:
                across = {"xref": f"x{number} domain", "yref": f"y{number}"}
                figure.add_shape(type="line", y0=y, y1=y, x0=0, x1=1, line=line, **across)
                word |= {"y": self.y.place(y), "x": 1, **across}
            figure.add_annotation(**word)

    def front(self) -> list[go.Scatter]:
        """Return the Pareto front, if the panel has one."""
        corners = pareto_front(self._counted, self.better)
        if not corners:
            return []
        x, y = zip(*corners, strict=True)
        line = {"color": "black", "width": 1.2}
        return [go.Scatter(x=x, y=y, name=FRONT, mode="lines", line=line, hoverinfo="skip")]

    def places(self, which: str) -> list[float]:
        """Return all numbers along one axis."""
        found = [value for trace in self.traces for value in trace[which]]
        return [v for v in found if isinstance(v, int | float) and isfinite(v)]


def pareto_front(places: Sequence[tuple[float, float]], better: str) -> list[tuple[float, float]]:
    """Return the corners of the Pareto front as a staircase; empty if nothing is better.

    Beyond the staircase no point is better in both.
    """
    if not better:
        return []
    signs = [-1 if word == "more" else 1 for word in better.split()]
    corners: list[tuple[float, float]] = []
    for x, y in sorted({(signs[0] * x, signs[1] * y) for x, y in places}):
        if not corners:
            corners.append((x, y))
        elif y < corners[-1][1]:
            corners += [(x, corners[-1][1]), (x, y)]
    return [(signs[0] * x, signs[1] * y) for x, y in corners]


def edges(middles: Sequence[float], log: bool) -> list[float]:
    """Return the edges between cells of a field whose middles are given, two at least."""
    at = np.log10(middles) if log else np.asarray(middles, float)
    inner = [(a + b) / 2 for a, b in pairwise(at)]
    found = np.array([2 * at[0] - inner[0], *inner, 2 * at[-1] - inner[-1]])
    return (10**found if log else found).tolist()


def by(rows: Sequence[Row], *keys: str) -> dict[Any, list[Row]]:
    """Return groups of rows with the same value, or values, in the order in which they come."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        values = tuple(row[key] for key in keys)
        found.setdefault(values[0] if len(keys) == 1 else values, []).append(row)
    return found


def column(rows: Sequence[Row], key: str, least: float | None = None) -> list[Any]:
    """Return the values of a column; numbers below `least` are drawn there."""
    values = [row[key] for row in rows]
    return values if least is None else [max(value, least) for value in values]


def parts(count: Any) -> str:
    """Return a number of parts in words."""
    return f"{count} part{'s' * (count > 1)}"
