"""Charts as figures of plotly: to point at, to zoom, to switch kinds on and off."""

from __future__ import annotations

from math import log10
from typing import Any

from plotly import graph_objects as go
from plotly.offline import get_plotlyjs

from report.chart import (
    FIELD,
    FRONT,
    Axis,
    Chart,
    Field,
    Panel,
    Points,
    Rule,
    edges,
    pareto_front,
    ticks_of,
    values,
)

SYMBOLS = {"o": "circle", "s": "square", "D": "diamond", "^": "triangle-up",
           "v": "triangle-down", "x": "x-thin"}  # fmt: skip
"""Names of markers."""

DASHES = {"-": "solid", "--": "dash", ":": "dot"}

INK, GRID = "#222222", "#e4e4e4"

HEIGHT_PX, BAR_PX = 380, 30
"""Height of a panel, and of one line of a bar chart beyond ten."""


def library() -> str:
    """Return plotly's JavaScript: no page needs a network."""
    return str(get_plotlyjs())


def kinds(chart: Chart) -> dict[str, tuple[str, str, str]]:
    """Return colour, marker and line of every kind of points of a chart, by name."""
    found = {
        points.name: (points.colour, "■" if points.bars else points.marker, points.line)
        for panel in reversed(chart.panels)
        for points in reversed(panel.points)
    }
    found = dict(reversed(found.items()))
    if any(panel.better for panel in chart.panels):
        found[FRONT] = ("black", "", "-")
    return found


def panel_json(panel: Panel) -> str:
    """Return a panel as JSON for plotly."""
    figure = go.Figure()
    if panel.field is not None:
        add_field(figure, panel, panel.field)
    for points in panel.points:
        figure.add_trace(bars(points) if points.bars else scatter(points))
    corners = pareto_front(panel)
    if corners:
        x, y = zip(*corners, strict=True)
        figure.add_trace(
            go.Scatter(
                x=x, y=y, name=FRONT, mode="lines", line={"color": "black", "width": 1.2},
                hoverinfo="skip",
            )
        )  # fmt: skip
    for mark in panel.marks:
        figure.add_trace(
            go.Scatter(
                x=[mark.x], y=[mark.y], name=mark.text, mode="markers+text", text=[mark.text],
                textposition="top center", hoverinfo="skip", textfont={"color": INK, "size": 12},
                marker={"symbol": "circle-open", "size": 18, "color": INK, "line": {"width": 2}},
            )
        )  # fmt: skip
    for rule in panel.rules:
        add_rule(figure, panel, rule)
    figure.update_layout(
        template="none",
        font={"family": "system-ui, sans-serif", "size": 12, "color": INK},
        title={"text": panel.title, "x": 0.01, "xanchor": "left", "y": 0.98, "yanchor": "top",
               "font": {"size": 14}},
        margin={"l": 62, "r": 30, "t": 36, "b": 52},
        height=max(HEIGHT_PX, 90 + BAR_PX * len(panel.y.names)),
        showlegend=False, barmode="stack", hovermode="closest", hoverlabel={"align": "left"},
        xaxis=axis(panel.x, values(panel, "x")), yaxis=axis(panel.y, values(panel, "y")),
    )  # fmt: skip
    return str(figure.to_json())


def scatter(points: Points) -> go.Scatter:
    """Return points and their line."""
    mode = "+".join(
        word
        for word, there in (
            ("lines", points.line), ("markers", points.marker), ("text", any(points.labels)),
        )
        if there
    )  # fmt: skip
    hollow = points.hollow or (False,) * len(points.x)
    thin = points.marker == "x"
    return go.Scatter(
        x=list(points.x), y=list(points.y), name=points.name, mode=mode,
        line={"color": points.colour, "width": 2, "dash": DASHES.get(points.line, "solid")},
        marker={
            "symbol": SYMBOLS.get(points.marker, "circle"), "size": 9,
            "color": ["white" if empty else points.colour for empty in hollow],
            "line": {"color": points.colour, "width": 2 if thin or any(hollow) else 1},
        },
        text=list(points.labels) or None, textposition="middle right",
        textfont={"color": points.colour, "size": 11},
        customdata=list(points.notes) or [""] * len(points.x), cliponaxis=False,
        hovertemplate=f"<b>{points.name}</b><br>%{{customdata}}<br>x: %{{x}}<br>y: %{{y}}"
        "<extra></extra>",
    )  # fmt: skip


def bars(points: Points) -> go.Bar:
    """Return bars from the left."""
    return go.Bar(
        x=list(points.x), y=list(points.y), name=points.name, orientation="h",
        marker={"color": points.colour}, text=list(points.labels) or None,
        textposition="outside", cliponaxis=False,
        customdata=list(points.notes) or [""] * len(points.x),
        hovertemplate=f"<b>{points.name}</b><br>%{{y}}: %{{x}}<br>%{{customdata}}<extra></extra>",
    )  # fmt: skip


def add_field(figure: go.Figure, panel: Panel, field: Field) -> None:
    """Add colours over a grid."""
    low, high = field.limits or (None, None)
    figure.add_trace(
        go.Heatmap(
            x=edges(panel.x, field.x), y=edges(panel.y, field.y),
            z=[list(row) for row in field.z], zmin=low, zmax=high, colorscale=list(FIELD),
            customdata=[[[x, y] for x in field.x] for y in field.y], name=field.label,
            colorbar={"title": {"text": field.label, "side": "right"}, "thickness": 14},
            hovertemplate=f"{panel.x.label}: %{{customdata[0]:.4g}}<br>{panel.y.label}: "
            f"%{{customdata[1]:.4g}}<br>{field.label}: %{{z:.3g}}<extra></extra>",
        )
    )  # fmt: skip


def add_rule(figure: go.Figure, panel: Panel, rule: Rule) -> None:
    """Add a line across the panel and a word on it."""
    line = {"color": rule.colour, "width": 1.2, "dash": "dash"}
    word = {
        "text": rule.text, "showarrow": False, "font": {"color": rule.colour, "size": 11},
        "yanchor": "bottom", "xanchor": "right",
    }  # fmt: skip
    if rule.x is not None:
        figure.add_shape(type="line", x0=rule.x, x1=rule.x, y0=0, y1=1, yref="paper", line=line)
        word |= {"x": place(panel.x, rule.x), "y": 0.02, "yref": "paper", "textangle": -90}
    elif rule.y is not None:
        figure.add_shape(type="line", y0=rule.y, y1=rule.y, x0=0, x1=1, xref="paper", line=line)
        word |= {"y": place(panel.y, rule.y), "x": 1, "xref": "paper"}
    figure.add_annotation(**word)


def place(axis: Axis, value: float) -> float:
    """Return where plotly puts words and ends of ranges: at the exponent, on a log axis."""
    return log10(value) if axis.log else value


def axis(axis: Axis, values: list[float]) -> dict[str, Any]:
    """Return plotly's settings of an axis with these numbers on it."""
    settings: dict[str, Any] = {
        "title": {"text": axis.label, "standoff": 8}, "gridcolor": GRID, "zeroline": False,
        "ticks": "outside", "tickcolor": GRID, "linecolor": "#888888", "showline": True,
        "automargin": True,
    }  # fmt: skip
    if axis.names:
        return settings | {
            "type": "category", "categoryorder": "array", "categoryarray": list(axis.names),
            "showgrid": False,
        }  # fmt: skip
    if axis.log:
        settings |= {"type": "log"}
    ticks = ticks_of(axis, values)
    if ticks:
        settings |= {
            "tickmode": "array", "tickvals": ticks, "ticktext": [f"{t:g}" for t in ticks],
        }  # fmt: skip
    if axis.limits:
        settings["range"] = [place(axis, end) for end in axis.limits]
    return settings
