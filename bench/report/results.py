"""docs/results.md: every chart with its figures, how to repeat it, and the demos in pictures."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from harness import shown
from report.chart import Chart, Data, Row

FOLDER = "results"
"""Beside the text: pictures and CSV files."""

MOST_ROWS = 24
"""Longer tables are in the CSV file only."""

ABOUT = """# Results: speed against accuracy

Written by `make charts` from its measurements; do not edit. The same with charts to point at and to
zoom: `out/report/index.html`. µmg is the friction of one part. The front of what is not beaten in
both time and error is drawn as a black line, our default has a ring. Times are of the cores: other
programs count little, but on a busy machine (its load is told) times are up to twice as long.
"""


def write_results(path: Path, data: Data, charts: Sequence[Chart]) -> None:
    """Write the text; pictures and tables are in a folder beside it, made by others."""
    used = dict.fromkeys(name for chart in charts for name in chart.sources)
    seconds = sum(data[name]["seconds"] for name in used)
    parts = [
        ABOUT,
        machines(data, used),
        f"All measurements behind the charts: {seconds / 60:.0f} minutes.\n",
        "## Summary\n",
        *(f"- [{titled(chart)}](#{anchor(titled(chart))}): {chart.finding}" for chart in charts),
        "",
        *(section(chart, data) for chart in charts),
        demos(path.parent / FOLDER),
    ]
    path.write_text("\n".join(parts).rstrip() + "\n", encoding="utf-8")


def machines(data: Data, names: Iterable[str]) -> str:
    """Say what the figures were measured on, and which are quick ones."""
    kinds: dict[str, list[str]] = {}
    for name in names:
        facts = {k: v for k, v in data[name]["machine"].items() if k != "load"}
        kinds.setdefault(", ".join(f"{k} {v}" for k, v in facts.items()), []).append(name)
    lines = [
        f"Machine{'' if len(kinds) == 1 else ' of ' + ', '.join(mine)}: {facts}."
        for facts, mine in kinds.items()
    ]
    quick = [name for name in names if data[name]["quick"]]
    if quick:
        lines.append(f"**Quick measurements with few cases: {', '.join(quick)}.**")
    return "\n".join(lines) + "\n"


def titled(chart: Chart) -> str:
    """Return a chart's title with its letter."""
    return f"({chart.letter}) {chart.title}" if chart.letter else chart.title


def anchor(title: str) -> str:
    """Return the name that a heading has in links."""
    kept = "".join(c for c in title.lower() if c.isalnum() or c in " -")
    return kept.replace(" ", "-")


def section(chart: Chart, data: Data) -> str:
    """Return one chart in words and figures."""
    picture, rows = f"{FOLDER}/{chart.key}.png", f"{FOLDER}/{chart.key}.csv"
    repeat = ", ".join(
        f"`make bench ARGS={name}` ({data[name]['seconds']:.0f} s)" for name in chart.sources
    )
    lines = [
        f"## {titled(chart)}\n",
        f"{chart.finding}\n",
        f"![{chart.title}]({picture})\n",
        f"*{chart.reading}*\n",
    ]
    if chart.default:
        lines.append(f"Our default: {chart.default}\n")
    if len(chart.rows) <= MOST_ROWS:
        lines.append(markdown_table(chart.headings, chart.rows))
    made = ", ".join(
        f"commit {data[name].get('commit') or 'unknown'}, load {data[name]['machine']['load']:g}"
        for name in chart.sources
    )
    lines.append(
        f"[All {len(chart.rows)} rows]({rows}). To repeat: {repeat}. Measured at {made}.\n"
    )
    return "\n".join(lines)


def markdown_table(columns: Mapping[str, str], rows: Sequence[Row]) -> str:
    """Return a table."""
    lines = [
        "| " + " | ".join(columns.values()) + " |",
        "|" + "---|" * len(columns),
        *("| " + " | ".join(shown(row.get(key)) for key in columns) + " |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def demos(folder: Path) -> str:
    """Return the demos that were made, with what became of them."""
    path = folder / "demos.json"
    if not path.exists():
        return ""
    runs: Mapping[str, Mapping[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    lines = [
        "## Demos\n",
        "Each is one run of the real graph, five nodes in five processes. With `--lockstep` "
        "simulated time waits for the answers, so a film does not depend on what else the machine "
        "did, and a seed repeats it; without it is real time. `python tools/demos.py` makes all. "
        "Arrows are the average force of the cycle that runs.\n",
    ]
    for name, run in runs.items():
        lines.append(f"### {name}\n\n{run['description']} {run['outcome']}\n")
        if (folder / f"{name}.webp").exists():
            lines += [
                f"![{name} as the camera sees it]({FOLDER}/{name}.webp)\n",
                f"<details><summary>Picture strip</summary>\n\n![{name}]({FOLDER}/{name}.png)\n\n"
                "</details>\n",
            ]
        lines.append(f"To repeat: `{run['command']}`.\n")
    return "\n".join(lines)
