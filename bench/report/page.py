"""One page with all charts and their rows. It needs nothing else, no network and no other file."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd
from plotly.offline import get_plotlyjs

from harness import shown
from report.chart import Chart, Data
from report.panels import PANEL_PX

STYLE = Path(__file__).with_suffix(".css")

ABOUT = """<header><h1>One vibrating plate, many parts: speed against accuracy</h1>
<p>A flat plate shakes in its own plane; friction carries the parts on it, and the right motion
sends each part its own way. A camera sees the parts, and before the next cycle of the plate (0.05
to 0.2 s) a motion must be found. So every stage has a time and an error: this page shows one
against the other, ours beside the best others, and how both grow with the number of parts.</p>
<p class="soft">Method A of the paper strings rotations of the plate about chosen centres together,
Method B, our default, superposes sinusoids. Forces are given in mu mg, the sliding friction of one
part. Times are of one core. A hollow mark says that not all runs ended well. Point at a mark to see
what it is; drag to zoom, double-click to zoom out; the names above a chart switch its marks on and
off.</p>"""


def write_report(path: Path, facts: Data, charts: Sequence[Chart]) -> None:
    """Write the page.

    Parameters
    ----------
    path : path
        The HTML file.
    facts : mapping
        Name of a measurement -> what it was made on, as far as that is known.
    charts : sequence of Chart
    """
    links = "".join(
        f'<a href="#{one.key}">{escape(one.full_title.split(":")[0])}</a>' for one in charts
    )
    rows = "".join(
        f'<tr><td><a href="#{one.key}">{escape(one.full_title)}</a></td>'
        f"<td>{escape(one.finding)}</td></tr>"
        for one in charts
    )
    parts = [
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        "<title>Vibrating plate: speed against accuracy</title>",
        f"<style>{STYLE.read_text(encoding='utf-8')}</style>",
        f"<script>{get_plotlyjs()}</script>",
        ABOUT,
        warning(facts),
        *(f'<p class="soft">Measured on: {escape(text)}.</p>' for text in machines(facts)),
        f'</header><nav><a href="#summary">Summary</a>{links}</nav>',
        f'<main><section id="summary"><h2>Summary</h2><table class="words">{rows}</table>',
        "</section>",
        *(section(one, facts) for one in charts),
        "</main>\n</html>\n",
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(parts), encoding="utf-8")


def warning(facts: Data) -> str:
    """Warn of quick measurements."""
    quick = ", ".join(name for name, item in facts.items() if item["quick"])
    text = f'<p class="warning">Quick measurements with few cases: {quick}.</p>'
    return text if quick else ""


def machines(facts: Data) -> dict[str, list[str]]:
    """Return what figures were measured on, and which."""
    found: dict[str, list[str]] = {}
    for name, item in facts.items():
        told = [f"{key} {value}" for key, value in item["machine"].items() if key != "load"]
        found.setdefault(", ".join(told), []).append(name)
    return found


def section(chart: Chart, facts: Data) -> str:
    """Return one chart: what it says, its figure, and the table behind it."""
    figure = chart.panels.draw().to_html(
        full_html=False,
        include_plotlyjs=False,
        config={"responsive": True, "displayModeBar": False},
    )
    default = f'<p class="why"><b>Our default.</b> {escape(chart.default)}</p>'
    table = cells(chart.frame).to_html(index=False, border=0)
    csv = b64encode(chart.sheet.csv.encode()).decode()
    return (
        f'<section id="{chart.key}"><h2>{escape(chart.full_title)}</h2>'
        f'<p>{escape(chart.finding)}</p><p class="soft">{escape(chart.reading)}</p>'
        f'<div class="wide"><div class="chart" role="img" aria-label="{escape(chart.title)}" '
        f'style="min-width:{chart.panels.across * PANEL_PX[0] * 3 // 4}px">{figure}</div></div>'
        f"{default if chart.default else ''}<details><summary>Table, {len(chart.sheet.rows)} rows"
        f'</summary><div class="scroll">{table}</div></details>'
        f'<p class="soft"><a download="{chart.key}.csv" href="data:text/csv;base64,{csv}">'
        f"{chart.key}.csv</a>. {repeat(chart.sources, facts)}</p></section>"
    )


def repeat(sources: Iterable[str], facts: Data) -> str:
    """Tell how to measure again."""
    told = [
        f"<code>make bench ARGS={name}</code>{escape(measured(facts.get(name)))}"
        for name in sources
    ]
    return "To measure again: " + ", ".join(told) + "." if told else ""


def measured(facts: Mapping[str, Any] | None, common: str = "") -> str:
    """Tell how long a measurement took, its load, and its commit if that is not the `common` one
    of all, as far as that is known."""
    if facts is None:
        return ""
    commit, load = facts.get("commit") or "unknown", facts["machine"]["load"]
    told = "" if commit == common else f"commit {commit}, "
    return f" ({facts['seconds']:.0f} s, {told}load {load:g})"


def common_commit(facts: Data) -> str:
    """Return the commit of all measurements; empty if they are of several."""
    commits = {item.get("commit") or "" for item in facts.values()}
    return commits.pop() if len(commits) == 1 else ""


def cells(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the texts of a table's cells."""
    return frame.astype(object).where(frame.notna(), None).map(shown)
