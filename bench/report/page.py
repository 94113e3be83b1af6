"""One page with all charts and tables. It needs nothing else, no network and no other file."""

from __future__ import annotations

import csv
import io
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from harness import shown
from report.chart import Chart, Data, Panel, Row
from report.interactive import kinds, library, panel_json

HERE = Path(__file__).parent

SHAPES = {
    "o": '<circle cx="11" cy="7" r="4.5"/>',
    "s": '<rect x="7" y="3" width="8" height="8"/>',
    "D": '<path d="M11 1.5 16.5 7 11 12.5 5.5 7z"/>',
    "^": '<path d="M11 2 16 11.5H6z"/>',
    "v": '<path d="M11 12 16 2.5H6z"/>',
    "x": '<path d="M7 3l8 8M15 3l-8 8"/>',
    "■": '<rect x="3" y="3" width="16" height="8"/>',
    "": "",
}
"""Markers in the key of a chart."""

DASHES = {"--": "5 3", ":": "2 3", "-": "none"}


def write_report(path: Path, data: Data, charts: Sequence[Chart]) -> None:
    """Write the page.

    Parameters
    ----------
    path : path
        The HTML file.
    data : mapping
        Measurements by name, as in their JSON files.
    charts : sequence of Chart
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    style, script = ((HERE / f"page.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    parts = [
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>Vibrating plate: speed against accuracy</title>\n<style>{style}</style>",
        header(data),
        navigation(charts),
        "<main>",
        summary(charts),
        *(section(chart, data) for chart in charts),
        '<section id="tables"><h2>All measurements</h2>',
        *(measurement(name, item) for name, item in data.items()),
        "</section></main>",
        f"<script>{library()}</script>\n<script>{script}</script>\n</html>\n",
    ]
    path.write_text("\n".join(parts), encoding="utf-8")


def header(data: Data) -> str:
    """Say what the page is about, and warn of quick measurements."""
    quick = [name for name, item in data.items() if item["quick"]]
    warning = (
        f'<p class="warning">Quick measurements with few cases: {", ".join(quick)}.</p>'
        if quick
        else ""
    )
    return (
        "<header><h1>One vibrating plate, many parts: speed against accuracy</h1>"
        "<p>A flat plate shakes in its own plane; friction carries the parts on it, and the right "
        "motion sends each part its own way. A camera sees the parts, and before the next cycle of "
        "the plate (0.05 to 0.2 s) a motion must be found. So every stage has a time and an error: "
        "this page shows one against the other, ours beside the best others, and how both grow "
        "with the number of parts.</p>"
        '<p class="soft">Method A of the paper strings rotations of the plate about chosen centres '
        "together, Method B, our default, superposes sinusoids. µmg is the friction of one part: "
        "forces are given as shares of it. Times are of one core. Point at a mark to see what it "
        "is; drag to zoom, double-click to zoom out; the names above a chart switch its marks on "
        "and off.</p>"
        f"{warning}{machine(data)}</header>"
    )


def machine(data: Data) -> str:
    """Say what the figures were measured on."""
    facts = dict.fromkeys(
        ", ".join(f"{key} {value}" for key, value in item["machine"].items() if key != "load")
        for item in data.values()
    )
    return "".join(f'<p class="soft">Measured on: {escape(text)}.</p>' for text in facts)


def navigation(charts: Iterable[Chart]) -> str:
    """Return links to all charts."""
    links = "".join(
        f'<a href="#{chart.key}">{escape(lettered(chart.letter, chart.title.split(":")[0]))}</a>'
        for chart in charts
    )
    return (
        f'<nav><div><a href="#summary">Summary</a>{links}<a href="#tables">Tables</a></div></nav>'
    )


def lettered(letter: str, title: str) -> str:
    """Return a title with its letter, if it has one."""
    return f"({letter}) {title}" if letter else title


def summary(charts: Iterable[Chart]) -> str:
    """Return a table of what came out."""
    rows = "".join(
        f'<tr><td class="text"><a href="#{chart.key}">'
        f"{escape(lettered(chart.letter, chart.title))}</a></td>"
        f'<td class="text">{escape(chart.finding)}</td></tr>'
        for chart in charts
    )
    return (
        '<section id="summary"><h2>Summary</h2><div class="scroll" style="max-height:none">'
        f'<table class="summary"><tbody>{rows}</tbody></table></div></section>'
    )


def section(chart: Chart, data: Data) -> str:
    """Return one chart: what it says, its panels, and the table behind it."""
    letter = f'<span class="letter">({chart.letter})</span>' if chart.letter else ""
    panels = "".join(panel_html(panel) for panel in chart.panels)
    pairs = " pairs" if len(chart.panels) in (2, 4) else ""
    default = f'<p class="why"><b>Our default.</b> {escape(chart.default)}</p>'
    return (
        f'<section id="{chart.key}"><h2>{letter}{escape(chart.title)}</h2>'
        f"<p>{escape(chart.finding)}</p>"
        f'<p class="soft">{escape(chart.reading)}</p>'
        f'{key(chart)}<div class="panels{pairs}">{panels}</div>{default if chart.default else ""}'
        f"<details><summary>Table, {len(chart.rows)} rows</summary>"
        f"{html_table(chart.headings, chart.rows)}</details>"
        f'<p class="soft">{csv_link(chart)} {repeat(chart.sources, data)}</p></section>'
    )


def panel_html(panel: Panel) -> str:
    """Return the place of a panel and, beside it, its JSON."""
    content = panel_json(panel).replace("</", r"<\/")  # no end of the script inside it
    return (
        f'<div><div class="panel" role="img" aria-label="{escape(panel.title)}"></div>'
        f'<script type="application/json">{content}</script></div>'
    )


def key(chart: Chart) -> str:
    """Return the buttons that name all kinds of marks and switch them."""
    buttons = []
    for name, (colour, marker, line) in kinds(chart).items():
        stroke = (
            f'<path d="M1 7H21" stroke="{colour}" stroke-width="2" '
            f'stroke-dasharray="{DASHES[line]}"/>'
            if line
            else ""
        )
        buttons.append(
            f'<button type="button" aria-pressed="true" data-name="{escape(name)}">'
            f'<svg width="22" height="14" fill="{colour}" stroke="{colour}">{stroke}'
            f"{SHAPES[marker]}</svg>{escape(name)}</button>"
        )
    return f'<div class="key">{"".join(buttons)}</div>' if buttons else ""


def csv_link(chart: Chart) -> str:
    """Return a link that saves the rows; they are inside it."""
    text = base64(csv_text(chart.rows))
    return f'<a download="{chart.key}.csv" href="data:text/csv;base64,{text}">{chart.key}.csv</a>.'


def csv_text(rows: Sequence[Row]) -> str:
    """Return rows with the same keys as the text of a CSV file."""
    file = io.StringIO()
    writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def base64(text: str) -> str:
    """Return a text as base64."""
    return b64encode(text.encode()).decode("ascii")


def repeat(sources: Sequence[str], data: Data) -> str:
    """Tell how to measure again."""
    told = [
        f"<code>make bench ARGS={escape(name)}</code> ({data[name]['seconds']:.0f} s)"
        for name in sources
    ]
    commits = ", ".join(dict.fromkeys(data[n].get("commit") or "unknown" for n in sources))
    measured = f" Measured at commit {escape(commits)}." if told else ""
    return "To measure again: " + ", ".join(told) + "." + measured


def measurement(name: str, item: Mapping[str, Any]) -> str:
    """Return one measurement: its sentences and tables, and what it was made on."""
    where = ", ".join(f"{key} {value}" for key, value in item["machine"].items())
    lines = "".join(f"<li>{escape(line)}</li>" for line in item["summary"])
    tables = "".join(
        f"<h3>{escape(table['title'])}</h3>{html_table(table['columns'], table['rows'])}"
        + (f'<p class="soft">{escape(table["note"])}</p>' if table["note"] else "")
        for table in item["tables"]
    )
    return (
        f"<details><summary>{escape(name)}: {escape(item['about'])}</summary><ul>{lines}</ul>"
        f'{tables}<p class="soft">{repeat([name], {name: item})} {escape(where)}</p></details>'
    )


def html_table(columns: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a table; columns of text are aligned to the left."""
    kind = {
        key: ' class="text"' if any(isinstance(row.get(key), str) for row in rows) else ""
        for key in columns
    }
    head = "".join(f"<th{kind[key]}>{escape(label)}</th>" for key, label in columns.items())
    body = "\n".join(
        "<tr>"
        + "".join(f"<td{kind[k]}>{escape(shown(row.get(k)))}</td>" for k in columns)
        + "</tr>"
        for row in rows
    )
    return f'<div class="scroll"><table><tr>{head}</tr>\n{body}</table></div>'
