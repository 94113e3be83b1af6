"""One page with all charts and their rows. The page needs no network and no other file."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import pandas as pd
from plotly.offline import get_plotlyjs

from harness import shown
from report.chart import Chart, Data
from report.panels import PANEL_PX

STYLE = Path(__file__).with_suffix(".css")

PAGE = Path(__file__).with_suffix(".html")


def write_report(path: Path, facts: Data, charts: Sequence[Chart]) -> None:
    """Write the page.

    Parameters
    ----------
    path : path
        The HTML file.
    facts : mapping
        Facts about each measurement, such as computer and commit, by its name.
    charts : sequence of Chart
    """
    links = "".join(
        f'<a href="#{chart.key}">{escape(chart.full_title.split(":")[0])}</a>' for chart in charts
    )
    rows = "".join(
        f'<tr><td><a href="#{chart.key}">{escape(chart.full_title)}</a></td>'
        f"<td>{escape(chart.finding)}</td></tr>"
        for chart in charts
    )
    sentences = [f'<p class="soft">Measured on: {escape(text)}.</p>' for text in machines(facts)]
    text = Template(PAGE.read_text(encoding="utf-8")).substitute(
        style=STYLE.read_text(encoding="utf-8"), script=get_plotlyjs(),
        warning=quick_warning(facts),
        machines="\n".join(sentences), links=links, rows=rows,
        sections="\n".join(section(chart, facts) for chart in charts),
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def quick_warning(facts: Data) -> str:
    """Return a warning if there are quick measurements."""
    quick = ", ".join(name for name, item in facts.items() if item["quick"])
    text = f'<p class="warning">Quick measurements with few cases: {quick}.</p>'
    return text if quick else ""


def machines(facts: Data) -> dict[str, list[str]]:
    """Return the names of the measurements, grouped by a description of the computer on which they
    ran."""
    found: dict[str, list[str]] = {}
    for name, item in facts.items():
        description = [f"{key} {value}" for key, value in item["machine"].items() if key != "load"]
        found.setdefault(", ".join(description), []).append(name)
    return found


def section(chart: Chart, facts: Data) -> str:
    """Return the section of one chart: its texts, its figure, and its table."""
    figure = chart.panels.draw().to_html(
        full_html=False,
        include_plotlyjs=False,
        config={"responsive": True, "displayModeBar": False},
    )
    default = f'<p class="why"><b>Default.</b> {escape(chart.default)}</p>'
    table = cell_texts(chart.frame).to_html(index=False, border=0)
    csv = b64encode(chart.sheet.csv.encode()).decode()
    return (
        f'<section id="{chart.key}"><h2>{escape(chart.full_title)}</h2>'
        f'<p>{escape(chart.finding)}</p><p class="soft">{escape(chart.reading)}</p>'
        f'<div class="wide"><div class="chart" role="img" aria-label="{escape(chart.title)}" '
        f'style="min-width:{chart.panels.across * PANEL_PX[0] * 3 // 4}px">{figure}</div></div>'
        f"{default if chart.default else ''}<details><summary>Table, {len(chart.sheet.rows)} rows"
        f'</summary><div class="scroll">{table}</div></details>'
        f'<p class="soft"><a download="{chart.key}.csv" href="data:text/csv;base64,{csv}">'
        f"{chart.key}.csv</a>. {repeat_commands(chart.sources, facts)}</p></section>"
    )


def repeat_commands(sources: Iterable[str], facts: Data) -> str:
    """Return a text with the commands that repeat measurements."""
    commands = [
        f"<code>make bench ARGS={name}</code>{escape(measured(facts.get(name)))}"
        for name in sources
    ]
    return "To measure again: " + ", ".join(commands) + "." if commands else ""


def measured(facts: Mapping[str, Any] | None, common: str = "") -> str:
    """Return a text with the duration, the load and the commit of a measurement. Unknown values are
    omitted. The commit is also omitted if it equals `common`."""
    if facts is None:
        return ""
    commit, load = facts.get("commit") or "unknown", facts["machine"]["load"]
    commit_text = "" if commit == common else f"commit {commit}, "
    return f" ({facts['seconds']:.0f} s, {commit_text}load {load:g})"


def usual_commit(facts: Data) -> str:
    """Return the commit that occurs most often among the measurements, or an empty text without
    measurements."""
    commits = Counter(item.get("commit") or "unknown" for item in facts.values())
    return commits.most_common(1)[0][0] if commits else ""


def common_commit(facts: Data) -> str:
    """Return the commit of all measurements, or an empty text if they have different commits."""
    commits = {item.get("commit") or "" for item in facts.values()}
    return commits.pop() if len(commits) == 1 else ""


def cell_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the texts of a table's cells."""
    return frame.astype(object).where(frame.notna(), None).map(shown)
