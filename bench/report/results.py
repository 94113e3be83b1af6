"""docs/results.md: every chart with its figures, how to repeat it, and the demos in pictures."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from report.chart import Chart, Data
from report.page import common_commit, machines, measured

FOLDER = "results"
"""Beside the text: pictures and CSV files."""

FACTS = "measured.json"
"""There too: when and on what machine the CSV files were measured, and their headings."""

WITHIN_LIMITS = re.compile(r"; all \d+ motor tables within limits( \(\d+ % used\))?")
"""In the outcome of a demo; said once for all."""

ABOUT = """# Results: speed against accuracy

Written by `make charts` from its measurements; do not edit. The same with charts to point at and to
zoom, and with all rows: `out/report/index.html`. Forces are in mu mg, the sliding friction of one
part. A black line joins what is not beaten in both time and error, our default has a ring, a hollow
mark says that not all runs ended well. Times are of the cores; on a busy machine (its load is
given) they are up to twice as long.
"""


def read_facts(folder: Path, data: Data) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what is known of measurements, and the headings of CSV files, by chart.

    Measurements that are not in `data` (as in their JSON files) are those of which the CSV files
    in the folder were made.
    """
    path = folder / FACTS
    told = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    keys = ("quick", "seconds", "commit", "machine")
    new = {name: {key: item.get(key) for key in keys} for name, item in data.items()}
    return told.get("measurements", {}) | new, told.get("columns", {})


def write_results(path: Path, facts: Data, charts: Sequence[Chart]) -> None:
    """Write the text, and beside it pictures, CSV files and what is known of them."""
    folder = path.parent / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for one in charts:
        (folder / f"{one.key}.csv").write_text(one.sheet.csv, encoding="utf-8")
        width, height = one.panels.size_px
        one.panels.draw().write_image(folder / f"{one.key}.png", width=width, height=height)
    names = dict.fromkeys(name for one in charts for name in one.sources if name in facts)
    used = {name: facts[name] for name in names}
    columns = {one.key: one.sheet.columns for one in charts}
    told = json.dumps({"measurements": facts, "columns": columns}, indent=1)
    (folder / FACTS).write_text(told + "\n", encoding="utf-8")
    lines = [
        f"Machine{'' if len(machines(used)) == 1 else ' of ' + ', '.join(mine)}: {facts}."
        for facts, mine in machines(used).items()
    ]
    quick = ", ".join(name for name, item in used.items() if item["quick"])
    lines += [f"**Quick measurements with few cases: {quick}.**"] if quick else []
    minutes = sum(item["seconds"] for item in used.values()) / 60
    commit = common_commit(used)
    figures = "All measurements here (demos apart) and those in the tables of README, graph.md, "
    figures += "hardware.md, feeder.md and trust.md"
    lines += [f"{figures}: commit {commit}." if commit else "Each section names its commit."]
    parts = [
        ABOUT,
        "\n".join([*lines, f"All measurements behind the charts: {minutes:.0f} minutes."]) + "\n",
        *(section(one, facts, commit) for one in charts),
        demos(folder),
    ]
    path.write_text("\n".join(parts).rstrip() + "\n", encoding="utf-8")


def section(chart: Chart, facts: Data, commit: str) -> str:
    """Return one chart in words and figures."""
    lines = [
        f"## {chart.full_title}\n",
        f"{chart.finding}\n",
        f"![{chart.key}]({FOLDER}/{chart.key}.png)\n",
        f"*{chart.reading}*\n",
    ]
    if chart.default:
        lines.append(f"Our default: {chart.default}\n")
    told = [
        f"`make bench ARGS={name}`{measured(facts.get(name), commit)}" for name in chart.sources
    ]
    rows = f"[{len(chart.sheet.rows)} rows]({FOLDER}/{chart.key}.csv)"
    lines.append(f"{rows}: {', '.join(told)}.\n")
    return "\n".join(lines)


def demos(folder: Path) -> str:
    """Return the demos that were made, with what became of them."""
    path = folder / "demos.json"
    if not path.exists():
        return ""
    runs: Mapping[str, Mapping[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    lines = [
        "## Demos\n",
        "Each is one run of the real graph, five nodes in five processes, by "
        "`make demo SCENARIO=NAME ARGS=--lockstep` where no other command is named; "
        "`python tools/demos.py` makes all. With `--lockstep` simulated time waits for the "
        "answers, and a seed repeats the film; without it is real time. All motor tables were "
        "within the limits, where nothing else is said. A cross shows where a part fell off. "
        "Arrows are the mean friction force of the cycle that runs: in films on each part, in "
        "picture strips on a part anywhere on the plate.\n",
    ]
    for name, run in runs.items():
        told = f"{run['description']} {WITHIN_LIMITS.sub('', run['outcome'])}"
        if run["command"] != f"make demo SCENARIO={name} ARGS=--lockstep":
            told += f" `{run['command']}`"
        lines.append(f"### {name}\n\n{told}\n")
        if (folder / f"{name}.webp").exists():
            film, strip = f"{FOLDER}/{name}.webp", f"{FOLDER}/{name}.png"
            lines.append(f"![{name}]({film})\n\n[Picture strip]({strip})\n")
    return "\n".join(lines)
