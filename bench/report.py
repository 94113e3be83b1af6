"""One page with all tables and pictures. It needs nothing else: pictures are inside it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

from harness import shown

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1c1c1c; max-width: 64rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.4rem; }
h3 { font-size: 1rem; margin-bottom: .3rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #e2e2e2; }
th { vertical-align: bottom; border-bottom: 2px solid #888; }
th.text, td.text { text-align: left; }
figure { margin: 1.5rem 0; } img { max-width: 100%; height: auto; }
figcaption, .note { color: #555; font-size: 13px; }
.warning { background: #fff3cd; padding: .5rem .8rem; }
"""


def write_report(
    path: Path, data: Mapping[str, Mapping[str, Any]], pictures: Iterable[tuple[Path, str]]
) -> None:
    """Write the page.

    Parameters
    ----------
    path : path
        The HTML file.
    data : mapping
        Measurements by name, as in their JSON files.
    pictures : iterable of (path, caption)
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    body = [
        "<h1>One vibrating plate, many parts: measurements</h1>",
        warning(data),
        *(figure(file, caption) for file, caption in pictures),
        *(section(name, measurement) for name, measurement in data.items()),
    ]
    path.write_text(
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n'
        f"<title>Vibrating plate: measurements</title>\n<style>{STYLE}</style>\n"
        + "\n".join(body)
        + "\n</html>\n",
        encoding="utf-8",
    )


def warning(data: Mapping[str, Mapping[str, Any]]) -> str:
    """Say which measurements were quick ones, if any."""
    quick = [name for name, measurement in data.items() if measurement["quick"]]
    if not quick:
        return ""
    return f'<p class="warning">Quick measurements, few cases: {", ".join(quick)}.</p>'


def figure(file: Path, caption: str) -> str:
    """Return a picture with its caption."""
    text = escape(caption)
    image = b64encode(file.read_bytes()).decode("ascii")
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{image}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def section(name: str, measurement: Mapping[str, Any]) -> str:
    """Return one measurement: its sentences and tables, and what it was made on."""
    machine = ", ".join(f"{key} {value}" for key, value in measurement["machine"].items())
    return "\n".join(
        [
            f"<h2>{escape(name)}: {escape(measurement['about'])}</h2>",
            "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in measurement["summary"]),
            "</ul>",
            *(html_table(table) for table in measurement["tables"]),
            f'<p class="note">make bench ARGS={escape(name)}, {measurement["seconds"]:g} s; '
            f"{escape(machine)}</p>",
        ]
    )


def html_table(table: Mapping[str, Any]) -> str:
    """Return a table; columns of text are aligned to the left."""
    columns = table["columns"]
    kind = {
        key: ' class="text"' if any(isinstance(row.get(key), str) for row in table["rows"]) else ""
        for key in columns
    }
    head = "".join(f"<th{kind[key]}>{escape(label)}</th>" for key, label in columns.items())
    rows = "\n".join(
        "<tr>"
        + "".join(f"<td{kind[k]}>{escape(shown(row.get(k)))}</td>" for k in columns)
        + "</tr>"
        for row in table["rows"]
    )
    note = f'<p class="note">{escape(table["note"])}</p>' if table["note"] else ""
    return (
        f"<h3>{escape(table['title'])}</h3>\n"
        f'<div class="scroll"><table><tr>{head}</tr>\n{rows}</table></div>\n{note}'
    )
