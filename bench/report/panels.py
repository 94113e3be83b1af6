"""Panels of one plotly figure, used interactively in the page and as a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, NamedTuple

from plotly import graph_objects as go
from plotly.subplots import make_subplots

from report.axis import Axis, cell_edges

Row = dict[str, Any]

PROJECT, BASELINE, SECOND, THIRD, FAINT, LIMIT = (
    "#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#767676", "#b02a37",
)  # fmt: skip
"""Colours: the project's default, the baselines, the project's second and third variants, notes,
limits."""

INK = "#222222"

FIELD = ("#ffffd9", "#7fcdbb", "#2c7fb8")
"""Colours for the values of a field, from the lowest to the highest value. Black and coloured lines
are visible on all these colours."""

SYMBOLS = {
    "o": "circle", "s": "square", "D": "diamond", "^": "triangle-up", "v": "triangle-down",
    "x": "x-thin",
}  # fmt: skip
DASHES = {"-": "solid", "--": "dash", ":": "dot"}

FRONT, DEFAULT = "Pareto front", "default"

ACROSS = 2
"""Maximum number of panels in a row. More panels would be too small, because pages show pictures
with a width of about 700 px."""

PANEL_PX, BAR_PX = (440, 350), 26
"""Width and height of a panel, and height of one line of a bar chart."""

LABEL_PX, TITLE_PX, LINE_PX = 95, 36, 28
"""Space for the numbers and the label of an axis, for a panel's title, and for a line of the legend
(key)."""

TEXT_PX = 13
"""Size of small text."""

LETTER = 0.6
"""Mean width of a letter [size of the text]."""


class Style(NamedTuple):
    """Appearance of the points of one kind, for example of one method.

    Attributes
    ----------
    name : str
        Name in the key.
    colour : str
    marker : str
        A key of `SYMBOLS`. If it is empty, only a line is drawn.
    line : str
        A key of `DASHES`. Empty: only points.
    """

    name: str
    colour: str = PROJECT
    marker: str = "o"
    line: str = ""


def group_rows(rows: Sequence[Row], *keys: str) -> dict[Any, list[Row]]:
    """Return the groups of rows that have equal values in one or more columns. The order of the
    rows is kept."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        values = tuple(row[key] for key in keys)
        found.setdefault(values[0] if len(keys) == 1 else values, []).append(row)
    return found


def is_never(_: Row) -> bool:
    """Return False for every row."""
    return False


class Panels:
    """Panels of one figure with a common key. `add` adds a panel. The methods of the panel draw
    points and lines.

    Attributes
    ----------
    list : list of Panel
        Panels in the order of the figure, row by row.
    """

    def __init__(self) -> None:
        self.list: list[Panel] = []

    def add(self, title: str, x: Axis, y: Axis, better: str = "") -> Panel:
        """Add a panel and return it.

        Parameters
        ----------
        better : str
            Better directions of x and y for the Pareto front, such as `less less`. Empty: no front.
        """
        self.list.append(Panel(title, x, y, better))
        return self.list[-1]

    @property
    def across(self) -> int:
        """Number of panels in a row."""
        return min(len(self.list), ACROSS)

    @property
    def down(self) -> int:
        """Number of rows of panels."""
        return -(-len(self.list) // self.across)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the figure [px]."""
        lines = max(len(panel.y.names) for panel in self.list)
        high = max(PANEL_PX[1], LABEL_PX + TITLE_PX + BAR_PX * lines)
        return ACROSS * PANEL_PX[0], self.down * high + self._key_px

    @property
    def _names_px(self) -> int:
        """Width of the texts to the left of a panel [px]."""
        names = [name for panel in self.list for name in panel.y.names]
        return max([LABEL_PX, *(round(LETTER * 14 * len(name)) + 20 for name in names)])

    @property
    def _key_px(self) -> int:
        """Height of the key [px]."""
        names = dict.fromkeys(name for panel in self.list for name in panel.names)
        lines, x = 1, 0.0
        for name in names:
            wide = 50 + LETTER * TEXT_PX * len(name)
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
            template="none", height=high, hovermode="closest",
            font={"family": "sans-serif", "size": 14, "color": INK},
            margin=margin,
            legend={"orientation": "h", "x": 0, "y": 1, "yref": "container", "yanchor": "top"},
            showlegend=len(named) > 1 or FRONT in named,
            coloraxis={"colorscale": list(FIELD)},
            hoverlabel={"align": "left"},
        )  # fmt: skip
        for label, (low, upper) in [panel.field for panel in self.list if panel.field]:
            bar = {
                "thickness": 14,
                "title": {"text": label, "side": "right", "font": {"size": TEXT_PX}},
            }
            figure.update_layout(coloraxis={"cmin": low, "cmax": upper, "colorbar": bar})
        return figure


class Rule(NamedTuple):
    """Straight line across a panel at one x or one y, with its meaning."""

    name: str
    x: float | None
    y: float | None
    colour: str


class Panel:
    """One panel: a pair of axes with all drawn elements."""

    def __init__(self, title: str, x: Axis, y: Axis, better: str) -> None:
        self.title = title
        self.x = x
        self.y = y
        self.better = better
        self.traces: list[Any] = []
        self.field: tuple[str, tuple[float, float]] | None = None
        self._counted: list[tuple[float, float]] = []
        self.rules: list[Rule] = []

    def points(
        self, rows: Sequence[Row], x: str, y: str, style: Style, *,
        hollow: Callable[[Row], bool] = is_never, note: str = "", in_front: bool = True,
    ) -> None:  # fmt: skip
        """Draw a point of one kind for each row.

        Parameters
        ----------
        x, y : str
            Columns with numbers, or with names of the axis. A row with the value None has no point.
        hollow : callable
            Function of a row. If it returns True, the point is hollow, for example because parts
            were missed. The Pareto front ignores hollow points.
        note : str
            Text that the page shows at the pointer for each point, with columns in braces.
        in_front : bool
            Whether the points take part in the Pareto front.
        """
        positions = [(self.x.drawn(row[x]), self.y.drawn(row[y])) for row in rows]
        empty = [hollow(row) for row in rows]
        name, colour, marker, line = style
        modes = (("lines", line), ("markers", marker))
        self.traces.append(
            go.Scatter(
                x=[x for x, _ in positions], y=[y for _, y in positions], name=name,
                mode="+".join(word for word, on in modes if on),
                line={"color": colour, "width": 2, "dash": DASHES.get(line, "solid")},
                marker={
                    "symbol": SYMBOLS.get(marker, "circle"), "size": 8,
                    "color": ["white" if is_empty else colour for is_empty in empty],
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
                position
                for position, out in zip(positions, empty, strict=True)
                if None not in position and not out
            ]

    def kinds(
        self,
        rows: Sequence[Row],
        key: str,
        x: str,
        y: str,
        styles: Mapping[Any, Style],
        **more: Any,
    ) -> None:
        """Draw the points of every kind. The value in a column determines the kind of a row. `more`
        contains further arguments of `points`."""
        for kind, kind_rows in group_rows(rows, key).items():
            self.points(kind_rows, x, y, styles[kind], **more)

    def heat(
        self, x: Sequence[float], y: Sequence[float], z: Sequence[Sequence[float | None]],
        label: str, limits: tuple[float, float],
    ) -> None:  # fmt: skip
        """Draw values z (m, n) as colours of a grid. x (n,) and y (m,) are the centres of the
        cells."""
        self.field = label, limits
        self.traces.append(
            go.Heatmap(
                x=cell_edges(x, self.x.log), y=cell_edges(y, self.y.log),
                z=[list(row) for row in z],
                coloraxis="coloraxis", customdata=[[[a, b] for a in x] for b in y],
                hovertemplate=f"{self.x.label}: %{{customdata[0]:.4g}}<br>{self.y.label}: "
                f"%{{customdata[1]:.4g}}<br>{label}: %{{z:.3g}}<extra></extra>",
            )
        )  # fmt: skip

    def mark(self, x: float, y: float) -> None:
        """Draw a ring around the project's default."""
        self.traces.append(
            go.Scatter(
                x=[x], y=[self.y.drawn(y)], name=DEFAULT, mode="markers", hoverinfo="skip",
                marker={"symbol": "circle-open", "size": 17, "color": INK, "line": {"width": 2}},
            )
        )  # fmt: skip

    def rule(
        self, text: str, x: float | None = None, y: float | None = None, colour: str = FAINT
    ) -> None:
        """Draw a straight line across the panel, at one x or one y."""
        self.rules.append(Rule(text, x, y, colour))

    @property
    def names(self) -> list[str]:
        """Entries of the key."""
        return [trace.name for trace in [*self.all, *self.rules] if trace.name]

    @property
    def all(self) -> list[Any]:
        """All drawn elements: the added elements and the Pareto front."""
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
        """Return the numbers of all elements along one axis."""
        found = [value for trace in self.traces for value in trace[which]]
        found += [getattr(rule, which) for rule in self.rules]
        return [v for v in found if isinstance(v, int | float) and isfinite(v)]


def pareto_front(places: Sequence[tuple[float, float]], better: str) -> list[tuple[float, float]]:
    """Return the corners of the Pareto front, drawn as a staircase. Empty if `better` is empty.

    No point beyond the staircase is better in both x and y.
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
