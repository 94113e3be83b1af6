"""docs/results.md: every chart with its data and its command, and pictures of the demos."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from report.chart import Chart, Data
from report.page import machines, usual_commit

FOLDER = "results"
"""Folder of the pictures and CSV files, next to the page."""

FACTS = "measured.json"
"""File in this folder with the times, computers and headings of the CSV files."""

ABOUT = """# Results: speed against accuracy

This page compares each stage of the control loop with other methods (baselines), and shows where
methods fail. `make charts` generates the page. `out/report/index.html` has the same charts with
zoom and all rows.

- A black line connects the results that no other result beats in both time and error.

- A ring marks the default of the project.

- A hollow point means that some runs failed.

- Forces are in mu mg, the sliding friction of one part.

- Method A moves the plate in a sequence of rotations, Method B in a sum of sinusoids.

- Times are CPU times without ROS. If the load of the computer is high, the times are up to twice as
  long.

- In the stability maps (the last five charts), the black line is the measured border between
  success and failure. The dashed line is the border by theory.

- `make bench ARGS=NAME` repeats the measurement that the line *Data* names.
  [measured.json](results/measured.json) contains the duration of each measurement,
  and the computer's load.

The solver predicts each motion over two successive plays. The measurements `free_running`,
`drives`, `rigs`, `feeding` and the films are older, with a prediction of one play.
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
    for chart in charts:
        (folder / f"{chart.key}.csv").write_text(chart.sheet.csv, encoding="utf-8")
        width, height = chart.panels.size_px
        chart.panels.draw().write_image(folder / f"{chart.key}.png", width=width, height=height)
    names = dict.fromkeys(name for chart in charts for name in chart.sources if name in facts)
    used = {name: facts[name] for name in names}
    columns = {chart.key: chart.sheet.columns for chart in charts}
    text = json.dumps({"measurements": facts, "columns": columns}, indent=1)
    (folder / FACTS).write_text(text + "\n", encoding="utf-8")
    lines = [
        f"Machine{'' if len(machines(used)) == 1 else ' of ' + ', '.join(measurements)}: {facts}."
        for facts, measurements in machines(used).items()
    ]
    quick = ", ".join(name for name, item in used.items() if item["quick"])
    lines += [f"**Quick measurements with few cases: {quick}.**"] if quick else []
    commit = usual_commit(used)
    lines += [f"Commit of the code: {commit}, unless the line *Data* gives another."]
    parts = [
        ABOUT,
        "\n".join(lines) + "\n",
        *(section(chart, facts, commit) for chart in charts),
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
    measurements = []
    for name in chart.sources:
        measured_commit = facts.get(name, {}).get("commit") or commit
        measurements.append(
            f"`{name}`" + f" (commit {measured_commit})" * (measured_commit != commit)
        )
    lines.append(f"[Data]({FOLDER}/{chart.key}.csv): {', '.join(measurements)}.\n")
    return "\n".join(lines)


def demos(folder: Path) -> str:
    """Return the section of the demos."""
    path = folder / "demos.json"
    if not path.exists():
        return ""
    runs: Mapping[str, Mapping[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    lines = [
        "## Demos\n",
        "Each film shows one run of the ROS graph with the simulator. If no other command is "
        "given, the command is `make demo SCENARIO=NAME ARGS=--lockstep`. `python tools/demos.py` "
        "makes all films. An arrow is the mean friction force on a part in the running cycle.\n",
    ]
    before = ""
    for name, run in runs.items():
        text = run["description"]
        # Films that differ only in the number of parts get one description.
        if (pattern := re.sub(r"\d+", "N", text)) == before:
            text = ""
        before = pattern
        if run["command"] != f"make demo SCENARIO={name} ARGS=--lockstep":
            text += f" `{run['command']}`"
        lines.append(f"### {name}\n" + f"\n{text.strip()}\n" * bool(text))
        if (folder / f"{name}.webp").exists():
            film, strip = f"{FOLDER}/{name}.webp", f"{FOLDER}/{name}.png"
            lines.append(f"[![{name}]({film})]({strip})\n")
    return "\n".join(lines)
