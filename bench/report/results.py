"""docs/results.md: every chart with its data and its command, and pictures of the demos."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from report.chart import Chart, Data
from report.page import machines, measured, usual_commit

FOLDER = "results"
"""Folder of the pictures and CSV files, next to the page."""

FACTS = "measured.json"
"""File in this folder with the times, computers and headings of the CSV files."""

ABOUT = """# Results: speed against accuracy

This page compares each stage with baselines in speed and accuracy, and shows where methods fail.
`make charts` writes it; do not edit it. `out/report/index.html` has the same charts with zoom and
all rows. Forces are in mu mg, the sliding friction of one part. A black line
connects the results that no other result beats in both time and error. A ring marks the default. A
hollow mark means that not all runs ended well. Times are CPU times without ROS; on a busy machine
(the load is given) they are up to twice as long. `make bench ARGS=NAME` repeats a measurement.

The solver evaluates motions after two plays, but `free_running`, `drives`, `rigs`, `feeding` and
the films were made before, with one play.
"""


def read_facts(folder: Path, data: Data) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the facts about measurements, and the headings of CSV files by chart.

    `data` contains measurements as in their JSON files. For a measurement that is not in `data`,
    the facts describe the earlier measurement from which the CSV files were made.
    """
    path = folder / FACTS
    stored = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    keys = ("quick", "seconds", "commit", "machine")
    new = {name: {key: item.get(key) for key in keys} for name, item in data.items()}
    return stored.get("measurements", {}) | new, stored.get("columns", {})


def write_results(path: Path, facts: Data, charts: Sequence[Chart]) -> None:
    """Write the page, and next to it the pictures, the CSV files and the facts about them."""
    folder = path.parent / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for one in charts:
        (folder / f"{one.key}.csv").write_text(one.sheet.csv, encoding="utf-8")
        width, height = one.panels.size_px
        one.panels.draw().write_image(folder / f"{one.key}.png", width=width, height=height)
    names = dict.fromkeys(name for one in charts for name in one.sources if name in facts)
    used = {name: facts[name] for name in names}
    columns = {one.key: one.sheet.columns for one in charts}
    text = json.dumps({"measurements": facts, "columns": columns}, indent=1)
    (folder / FACTS).write_text(text + "\n", encoding="utf-8")
    lines = [
        f"Machine{'' if len(machines(used)) == 1 else ' of ' + ', '.join(mine)}: {facts}."
        for facts, mine in machines(used).items()
    ]
    quick = ", ".join(name for name, item in used.items() if item["quick"])
    lines += [f"**Quick measurements with few cases: {quick}.**"] if quick else []
    commit = usual_commit(used)
    lines += [f"Commit: {commit}, unless another is given."]
    parts = [
        ABOUT,
        "\n".join(lines) + "\n",
        *(section(one, facts, commit) for one in charts),
        demos(folder),
    ]
    path.write_text("\n".join(parts).rstrip() + "\n", encoding="utf-8")


def section(chart: Chart, facts: Data, commit: str) -> str:
    """Return the section of one chart."""
    lines = [
        f"## {chart.full_title}\n",
        f"{chart.finding}\n",
        f"![{chart.key}]({FOLDER}/{chart.key}.png)\n",
        f"*{chart.reading}*\n",
    ]
    if chart.default:
        lines.append(f"Default: {chart.default}\n")
    measurements = [f"`{name}`{measured(facts.get(name), commit)}" for name in chart.sources]
    rows = f"[{len(chart.sheet.rows)} rows]({FOLDER}/{chart.key}.csv)"
    plural = "s" if len(measurements) > 1 else ""
    lines.append(f"Data: {rows} of the measurement{plural} {' and '.join(measurements)}.\n")
    return "\n".join(lines)


def demos(folder: Path) -> str:
    """Return the section of the demos."""
    path = folder / "demos.json"
    if not path.exists():
        return ""
    runs: Mapping[str, Mapping[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    lines = [
        "## Demos\n",
        "Each film is one run of the real graph by `make demo SCENARIO=NAME ARGS=--lockstep`, "
        "unless another command is given; `python tools/demos.py` makes all films. Arrows show the "
        "mean friction force of the running cycle.\n",
    ]
    for name, run in runs.items():
        text = run["description"]
        if run["command"] != f"make demo SCENARIO={name} ARGS=--lockstep":
            text += f" `{run['command']}`"
        lines.append(f"### {name}\n\n{text}\n")
        if (folder / f"{name}.webp").exists():
            film, strip = f"{FOLDER}/{name}.webp", f"{FOLDER}/{name}.png"
            lines.append(f"[![{name}]({film})]({strip})\n")
    return "\n".join(lines)
