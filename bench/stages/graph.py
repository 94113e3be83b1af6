"""Tests of the real graph: faults, malformed messages, random goals, some minutes of sorting.

The programs of tools/ disturb the real graph: they inject faults into nodes, and send malformed
messages and random goals. Then the graph sorts for some minutes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from harness import ROOT, Result, Table

TRANSPORTS = {"sim": "In simulation", "serial": "Over a serial line"}

MESSAGES, QUICK_MESSAGES = 10_000, 500
"""Number of malformed messages to each node."""

GOALS, QUICK_GOALS = 200, 10

FAULTS = {key: key for key in ("fault", "node", "task_status", "plate rests", "to go on")}
"""Columns of the tables of faults. The table of the case `faults` also contains the diagnostics."""

MINUTES, QUICK_MINUTES = 8.0, 0.5
"""Duration of sorting [min]."""


def measure(quick: bool) -> Result:
    """Run the cases one after the other."""
    from cases.faults import table_cells

    nodes = ("--nodes", "planner", "driver") if quick else ()
    tables, summary = [], []
    for transport, where in TRANSPORTS.items():
        found = run_case("faults", *nodes, "--transport", transport)
        tables.append(Table(f"faults_{transport}", where, FAULTS, table_cells(found)))
        well = sum(row["well"] for row in found["rows"])
        summary.append(
            f"{where}: {well} of {len(found['rows'])} faults had the expected effect; "
            f"{len(found['faults'])} of {found['tables']} motor tables exceeded a limit"
        )
    verdicts = run_case("fuzz", "--count", QUICK_MESSAGES if quick else MESSAGES)
    tables.append(Table.of("fuzz", verdicts))
    summary.append(f"Malformed messages: {sum(v['crashes'] for v in verdicts)} crashes")
    goals = run_case("goals", "--count", QUICK_GOALS if quick else GOALS)
    reasons = ", ".join(f"{count} {name.lower()}" for name, count in goals.pop("reasons").items())
    summary.append(
        f"Random goals: {goals['goals']} (invalid: {goals['wrong']}), {goals['cancels']} cancels "
        f"and {goals['stops']} stops. {goals['unanswered']} goals got no result, and "
        f"{goals['wrong ones that began']} invalid goals were started. Results: {reasons}. At the "
        f"end, the plate {'rests' if goals['plate rests'] else 'does not rest'}"
    )
    hours = run_case("soak", "--minutes", QUICK_MINUTES if quick else MINUTES)
    tables.append(measure_memory(hours))
    summary.append(
        f"{60 * hours['hours']:.1f} minutes of sorting: {hours['done']} of {hours['tasks']} tasks "
        f"done; {hours['held']} of {hours['cycles']} cycles held, {hours['late']} late; "
        f"{hours['faults']} of {hours['tables']} motor tables exceeded a limit; image to setpoints "
        f"{hours['latency_ms']:.0f} ms, 99th percentile {hours['latency_p99_ms']:.0f} ms"
    )
    return Result(tables, summary)


def run_case(case: str, *arguments: object) -> Any:
    """Run a case of `tools/robustness.py`, and return its result."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        command = [
            sys.executable,
            str(ROOT / "tools/robustness.py"),
            "--case",
            case,
            *map(str, arguments),
        ]
        # The exit code is ignored, because the rows in the file contain the same information.
        done = subprocess.run(
            [*command, "--json", str(path)], capture_output=True, text=True, check=False
        )
        if not path.exists():
            raise RuntimeError(f"{case}: {done.stderr or done.stdout}")
        return json.loads(path.read_text(encoding="utf-8"))


def measure_memory(hours: dict[str, Any]) -> Table:
    """Return each node's memory during sorting, and its fraction of a CPU core."""
    rows = [
        row | {"slope": f"{row['mb_per_hour']:.1f} ± {row['interval']:.1f}",
               "cpu": 100 * row["cpu_share"]}
        for row in hours["memory"]
    ]  # fmt: skip
    return Table.of("hours", rows)
