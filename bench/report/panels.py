"""Panels of one plotly figure: the same in the page, to point at and to zoom, and as a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, NamedTuple

from plotly import graph_objects as go
from plotly.subplots import make_subplots

from report.axis import Axis, edges

Row = dict[str, Any]

OURS, PEER, SECOND, THIRD, FAINT, LIMIT = (
    "#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#767676", "#b02a37",
)  # fmt: skip
"""Colours: our default, the peers, our second and third, notes, limits."""

INK = "#222222"

FIELD = ("#ffffd9", "#7fcdbb", "#2c7fb8")
"""Colours of a field from low to high: black and coloured lines are seen on all of them."""

SYMBOLS = {
    "o": "circle", "s": "square", "D": "diamond", "^": "triangle-up", "v": "triangle-down",
    "x": "x-thin",
}  # fmt: skip
DASHES = {"-": "solid", "--": "dash", ":": "dot"}

FRONT, DEFAULT = "Pareto front", "our default"

ACROSS = 2
"""Most panels beside each other: pictures are shown about 700 px wide."""

PANEL_PX, BAR_PX = (440, 350), 26
"""Width and height of a panel, and height of one line of a bar chart."""

LABEL_PX, TITLE_PX, LINE_PX = 95, 36, 28
"""For an axis' numbers and its label; for a panel's title; for a line of the key."""

WORDS_PX = 13
"""Size of words; others are one larger."""

LETTER = 0.6
"""Width of a letter [its size]."""


class Look(NamedTuple):
    """How points of one kind are told from others.

    Attributes
    ----------
    name : str
        In the key.
    colour : str
    marker : str
        A key of `SYMBOLS`; empty: a line only.
    line : str
        A key of `DASHES`; empty: points only.
    """

    name: str
    colour: str = OURS
    marker: str = "o"
    line: str = ""


def by(rows: Sequence[Row], *keys: str) -> dict[Any, list[Row]]:
    """Return groups of rows with the same value, or values, in the order in which they come."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        values = tuple(row[key] for key in keys)
        found.setdefault(values[0] if len(keys) == 1 else values, []).append(row)
    return found


def nowhere(_: Row) -> bool:
    """Hold of no row."""
    return False


class Panels:
    """Panels of one figure with one key, each added by `add` and then drawn into.

    Attributes
    ----------
    list : list of Panel
        In the order in which they stand, row by row.
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
        return min(len(self.list), ACROSS)

    @property
    def down(self) -> int:
        """How many are below each other."""
        return -(-len(self.list) // self.across)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the figure [px]."""
        lines = max(len(panel.y.names) for panel in self.list)
        high = max(PANEL_PX[1], LABEL_PX + TITLE_PX + BAR_PX * lines)
        return ACROSS * PANEL_PX[0], self.down * high + self._key_px

    @property
    def _names_px(self) -> int:
        """Width of what stands left of a panel."""
        names = [name for panel in self.list for name in panel.y.names]
        return max([LABEL_PX, *(round(LETTER * 14 * len(name)) + 20 for name in names)])

    @property
    def _key_px(self) -> int:
        """Height of the key."""
        names = dict.fromkeys(name for panel in self.list for name in panel.names)
        lines, x = 1, 0.0
        for name in names:
            wide = 50 + LETTER * WORDS_PX * len(name)
            lines, x = (lines, x + wide) if x + wide < 790 else (lines + 1, wide)
        return LINE_PX * lines if len(names) > 1 else 0

    def draw(self) -> go.Figure:
        """Return the figure."""
        across, down, (wide, high) = self.across, self.down, self.size_px
        margin = {"l": 70, "r": 20, "t": TITLE_PX + self._key_px, "b": 60}
        area = wide - margin["l"] - margin["r"], high - margin["t"] - margin["b"]
        between = self._names_px, margin["b"] + TITLE_PX
        figure = make_subplots(
            down, across, subplot_titles=[panel.title for panel in self.list],
            horizontal_spacing=between[0] / area[0],
            vertical_spacing=between[1] / area[1],
        )  # fmt: skip
        figure.update_annotations(font_size=15)
        named: set[str] = set()
        for number, panel in enumerate(self.list):
            row, column = number // across + 1, number % across + 1
            for trace in panel.all:
                if trace.name:
                    trace.legendgroup, trace.showlegend = trace.name, trace.name not in named
                    named.add(trace.name)
                figure.add_trace(trace, row, column)
            for rule in panel.rules:
                panel_of = {"row": row, "col": column, "showlegend": rule.name not in named}
                line = {"color": rule.colour, "width": 1.2, "dash": "dash"}
                draw = figure.add_hline if rule.x is None else figure.add_vline
                draw(rule.y if rule.x is None else rule.x, line=line, name=rule.name, **panel_of)
                named.add(rule.name)
            figure.update_xaxes(panel.x.settings(panel.places("x")), row=row, col=column)
            figure.update_yaxes(panel.y.settings(panel.places("y")), row=row, col=column)
        figure.update_layout(
            template="none", height=high, barmode="stack", hovermode="closest",
            font={"family": "sans-serif", "size": 14, "color": INK},
            margin=margin,
            legend={"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
            showlegend=len(named) > 1 or FRONT in named,
            coloraxis={"colorscale": list(FIELD)},
            hoverlabel={"align": "left"},
        )  # fmt: skip
        for label, (low, most) in [panel.field for panel in self.list if panel.field]:
            bar = {
                "thickness": 14,
                "title": {"text": label, "side": "right", "font": {"size": WORDS_PX}},
            }
            figure.update_layout(coloraxis={"cmin": low, "cmax": most, "colorbar": bar})
        return figure


class Rule(NamedTuple):
    """A straight line across a panel, at one x or one y, and what it means."""

    name: str
    x: float | None
    y: float | None
    colour: str


class Panel:
    """One pair of axes and what is in it."""

    def __init__(self, title: str, x: Axis, y: Axis, better: str) -> None:
        self.title, self.x, self.y, self.better = title, x, y, better
        self.traces: list[Any] = []
        self.field: tuple[str, tuple[float, float]] | None = None
        self._counted: list[tuple[float, float]] = []
        self.rules: list[Rule] = []

    def points(
        self, rows: Sequence[Row], x: str, y: str, look: Look, *,
        hollow: Callable[[Row], bool] = nowhere, note: str = "", in_front: bool = True,
    ) -> None:  # fmt: skip
        """Draw a point of one kind for each row.

        Parameters
        ----------
        x, y : str
            Columns of numbers, or of names of the axis. None: no point there.
        hollow : callable
            Tells rows that do not count (parts missed, speed not kept): no front touches them.
        note : str
            What the page shows of each point under the pointer: text with columns in braces.
        in_front : bool
            Whether the points take part in the Pareto front.
        """
        at = [(self.x.drawn(row[x]), self.y.drawn(row[y])) for row in rows]
        empty = [hollow(row) for row in rows]
        name, colour, marker, line = look
        there = (("lines", line), ("markers", marker))
        self.traces.append(
            go.Scatter(
                x=[place[0] for place in at], y=[place[1] for place in at], name=name,
                mode="+".join(word for word, on in there if on),
                line={"color": colour, "width": 2, "dash": DASHES.get(line, "solid")},
                marker={
                    "symbol": SYMBOLS.get(marker, "circle"), "size": 8,
                    "color": ["white" if one else colour for one in empty],
                    "line": {"color": colour, "width": 2 if marker == "x" or any(empty) else 1},
                },
                cliponaxis=False,
                customdata=[note.format(**row) for row in rows],
                hovertemplate=f"<b>{name}</b><br>%{{customdata}}<br>x: %{{x}}<br>y: %{{y}}"
                "<extra></extra>",
            )
        )  # fmt: skip
        if in_front:
            self._counted += [
                place for place, out in zip(at, empty, strict=True) if None not in place and not out
            ]

    def kinds(
        self, rows: Sequence[Row], key: str, x: str, y: str, looks: Mapping[Any, Look], **more: Any
    ) -> None:
        """Draw the points of every kind, which a column tells; `more` is as of `points`."""
        for kind, mine in by(rows, key).items():
            self.points(mine, x, y, looks[kind], **more)

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
        label: str, limits: tuple[float, float],
    ) -> None:  # fmt: skip
        """Draw values z (m, n) over a grid as colours; x (n,) and y (m,) are cells' middles."""
        self.field = label, limits
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
                x=[x], y=[self.y.drawn(y)], name=DEFAULT, mode="markers", hoverinfo="skip",
                marker={"symbol": "circle-open", "size": 17, "color": INK, "line": {"width": 2}},
            )
        )  # fmt: skip

    def rule(
        self, text: str, x: float | None = None, y: float | None = None, colour: str = FAINT
    ) -> None:
        """Draw a straight line across, at one x or one y."""
        self.rules.append(Rule(text, x, y, colour))

    @property
    def names(self) -> list[str]:
        """What stands in the key."""
        return [each.name for each in [*self.all, *self.rules] if each.name]

    @property
    def all(self) -> list[Any]:
        """All that is drawn: what was added, and the Pareto front."""
        return [*self.traces, *self.front()]

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
        found += [getattr(rule, which) for rule in self.rules]
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
