"""Panels of one plotly figure: the same in the page, to point at and to zoom, and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from plotly import graph_objects as go
from plotly.subplots import make_subplots

from report.axis import LETTER, MARK_PX, Axis, Box, Room, edges

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
"""Size of words beside marks; others are one larger."""

BESIDE = (
    "middle right", "middle left", "top center", "bottom center",
    "top right", "bottom right", "top left", "bottom left",
)  # fmt: skip
"""Where words may stand beside a mark, the best first."""


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
        names = dict.fromkeys(t.name for panel in self.list for t in panel.all if t.name)
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
        side = (
            (area[0] - (across - 1) * between[0]) / across,
            (area[1] - (down - 1) * between[1]) / down,
        )
        named: set[str] = set()
        for number, panel in enumerate(self.list):
            row, column = number // across + 1, number % across + 1
            panel.place_words(side)
            for trace in panel.all:
                if trace.name:
                    trace.legendgroup, trace.showlegend = trace.name, trace.name not in named
                    named.add(trace.name)
                figure.add_trace(trace, row, column)
            panel.draw_rules(figure, "" if not number else str(number + 1))
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


class Panel:
    """One pair of axes and what is in it."""

    def __init__(self, title: str, x: Axis, y: Axis, better: str) -> None:
        self.title, self.x, self.y, self.better = title, x, y, better
        self.traces: list[Any] = []
        self.field: tuple[str, tuple[float | None, float | None]] | None = None
        self._counted: list[tuple[float, float]] = []
        self._rules: list[Rule] = []

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
                text=list(labels) or None, cliponaxis=False,
                textfont={"color": colour, "size": WORDS_PX},
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
                x=[x], y=[y], name=DEFAULT, mode="markers", hoverinfo="skip",
                marker={"symbol": "circle-open", "size": 17, "color": INK, "line": {"width": 2}},
            )
        )  # fmt: skip

    def rule(
        self, text: str, x: float | None = None, y: float | None = None, colour: str = FAINT
    ) -> None:
        """Draw a straight line across, at one x or one y, with a word on it."""
        self._rules.append(Rule(text, x, y, colour))

    def place_words(self, side: tuple[float, float]) -> None:
        """Find a place for all words in a panel as wide and high as `side` [px]."""
        if self.x.names or self.y.names:
            return
        ends = self.x.ends(self.places("x")), self.y.ends(self.places("y"))
        room = Room(side, self.x, self.y, ends)
        words = []
        for trace in self.all:
            if not isinstance(trace, go.Scatter):
                continue
            texts = trace.text or [""] * len(trace.x)
            there = [
                (room.across(x), room.up(y), text)
                for x, y, text in zip(trace.x, trace.y, texts, strict=True)
                if x is not None and y is not None
            ]
            if "lines" in trace.mode:
                room.line([(x, y) for x, y, _ in there])
            if "markers" in trace.mode:
                for x, y, _ in there:
                    room.mark(x, y)
            words += [(trace, there)] * bool(trace.text)
        for rule in self._rules:
            rule.place(room)
        for trace, there in words:
            trace.textposition = [
                BESIDE[room.best(beside(x, y, text))] if text else BESIDE[0] for x, y, text in there
            ]

    @property
    def all(self) -> list[Any]:
        """All that is drawn: what was added, and the Pareto front."""
        return [*self.traces, *self.front()]

    def draw_rules(self, figure: go.Figure, number: str) -> None:
        """Draw all lines across into the figure's pair of axes with a number."""
        for rule in self._rules:
            rule.draw(figure, number, self.x, self.y)

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
        found += [getattr(rule, which) for rule in self._rules]
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


def beside(x: float, y: float, text: str) -> list[Box]:
    """Return the boxes of words beside a mark at x, y [px], in the order of `BESIDE`."""
    wide, high, off = LETTER * WORDS_PX * len(text), WORDS_PX, MARK_PX + 1
    right, left, middle = x + off, x - off - wide, x - wide / 2
    above, level, below = y + off, y - high / 2, y - off - high
    corners = (
        (right, level), (left, level), (middle, above), (middle, below),
        (right, above), (right, below), (left, above), (left, below),
    )  # fmt: skip
    return [(a, b, a + wide, b + high) for a, b in corners]


@dataclass
class Rule:
    """A straight line across a panel, at one x or one y, with a word on it."""

    text: str
    x: float | None
    y: float | None
    colour: str
    spot: int = 0

    def place(self, room: Room) -> None:
        """Find a place for the word: at either end of the line, on either side of it."""
        wide, high = LETTER * WORDS_PX * len(self.text), WORDS_PX + 3
        if self.y is not None:
            at, length = room.up(self.y), room.size[0]
            spots = [(x, y) for x in (length - wide, 0) for y in (at, at - high)]
            boxes = [(x, y, x + wide, y + high) for x, y in spots]
            line = [(0.0, at), (length, at)]
        else:
            at, length = room.across(self.x or 0.0), room.size[1]
            spots = [(x, y) for y in (0, length - wide) for x in (at - high, at)]
            boxes = [(x, y, x + high, y + wide) for x, y in spots]
            line = [(at, 0.0), (at, length)]
        self.spot = room.best(boxes)
        room.line(line)

    def draw(self, figure: go.Figure, number: str, x: Axis, y: Axis) -> None:
        """Draw the line into the figure's pair of axes with a number."""
        line = {"color": self.colour, "width": 1.2, "dash": "dash"}
        first, near = self.spot < 2, self.spot % 2 == 0
        word: dict[str, Any] = {
            "text": self.text, "showarrow": False, "borderpad": 1,
            "font": {"color": self.colour, "size": WORDS_PX},
        }  # fmt: skip
        if self.y is not None:
            along = {"xref": f"x{number} domain", "yref": f"y{number}"}
            figure.add_shape(type="line", y0=self.y, y1=self.y, x0=0, x1=1, line=line, **along)
            word |= {"y": y.place(self.y), "x": int(first), "yanchor": "bottom" if near else "top"}
            word["xanchor"] = "right" if first else "left"
        else:
            along = {"xref": f"x{number}", "yref": f"y{number} domain"}
            figure.add_shape(type="line", x0=self.x, x1=self.x, y0=0, y1=1, line=line, **along)
            word |= {"x": x.place(self.x or 0.0), "y": int(not first), "textangle": -90}
            word |= {
                "xanchor": "right" if near else "left",
                "yanchor": "bottom" if first else "top",
            }
        figure.add_annotation(**word, **along)
