"""Draw the measurements: out/charts/*.png and *.csv, and one page, out/report/index.html.

python bench/charts.py [--quick]

Takes out/bench/*.json; what is missing is measured first, and without --quick also what has only
been measured with it.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from draw import (
    draw_cost,
    draw_learning,
    draw_sim,
    draw_solver,
    draw_stages,
    draw_steering,
    draw_tracking,
)
from draw_solvers import draw_force_map, draw_inversion, draw_realised, draw_rotations
from draw_vision import draw_vision
from harness import ROOT
from matplotlib.figure import Figure
from report import write_report
from run import MEASUREMENTS, run_all

Data = dict[str, dict[str, Any]]
"""Measurements by name, as in their JSON files."""


@dataclass(frozen=True)
class Chart:
    """One picture: file name, what the reader is to see, data that it draws, how."""

    name: str
    caption: str
    rows: Callable[[Data], list[dict[str, Any]]]
    draw: Callable[[Figure, list[dict[str, Any]]], None]


def main() -> int:
    """Run the command line; returns its exit code."""
    args = arguments()
    data = load(args.out / "bench", args.quick)
    folder = args.out / "charts"
    folder.mkdir(parents=True, exist_ok=True)
    style()
    pictures = []
    for chart in CHARTS:
        rows = chart.rows(data)
        write_csv(folder / f"{chart.name}.csv", rows)
        figure = Figure(figsize=(7.6, 4.6), layout="constrained")
        chart.draw(figure, rows)
        path = folder / f"{chart.name}.png"
        figure.savefig(path, dpi=130)
        pictures.append((path, chart.caption))
        print(f"{path}")
    page = args.out / "report/index.html"
    write_report(page, data, pictures)
    print(f"{page}")
    return 0


def load(folder: Path, quick: bool) -> Data:
    """Read all measurements; run those that are missing."""

    def read() -> Data:
        files = {name: folder / f"{name}.json" for name in MEASUREMENTS}
        return {
            name: json.loads(path.read_text(encoding="utf-8"))
            for name, path in files.items()
            if path.exists()
        }

    there = read()
    wanted = [n for n in MEASUREMENTS if n not in there or (there[n]["quick"] and not quick)]
    if wanted:
        run_all(wanted, quick, folder)
    return read()


def table(data: Data, name: str, key: str) -> list[dict[str, Any]]:
    """Return the rows of one table."""
    return next(t["rows"] for t in data[name]["tables"] if t["key"] == key)


def force_map_rows(data: Data) -> list[dict[str, Any]]:
    """Return time and error of every way to the averaged force."""
    batched = [r for r in table(data, "force_map", "batched") if r["harmonics"] == 2]
    one = table(data, "force_map", "methods")
    return [
        {"case": case, "method": row["method"], "us": row[time], "p99": row["p99"]}
        for case, rows, time in (("batched", batched, "us"), ("methods", one, "one_us"))
        for row in rows
    ]


def rotation_rows(data: Data) -> list[dict[str, Any]]:
    """Return forces and times of Method A, with its peers."""
    rows = [
        {
            "case": "force", "label": f"{row['centres']}, {row['method']}", "value": row["p10"],
            "ours": row["method"] != "SVD",
        }
        for row in table(data, "rotations", "guaranteed")
    ]  # fmt: skip
    rows += [
        {
            "case": "force", "label": f"realised, {row['closure']}", "value": row["p10"],
            "ours": True,
        }
        for row in table(data, "rotations", "realised")
    ]  # fmt: skip
    return rows + [
        {
            "case": "time", "label": row["method"], "value": row["milliseconds"],
            "ours": row["method"].startswith("ours"),
        }
        for row in table(data, "rotations", "times")
    ]  # fmt: skip


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows with the same keys."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def style() -> None:
    """Set what all pictures share."""
    mpl.use("agg")
    mpl.rcParams.update(
        {
            "font.size": 11,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.color": "#e4e4e4",
            "axes.axisbelow": True,
            "legend.frameon": False,
            "axes.titlesize": 12,
            "axes.titlelocation": "left",
        }
    )


CHARTS = (
    Chart(
        "sim_error_speed",
        "Simulator: error and speed at several settings, 1 part, beside its peers. Down and to the "
        "right is better.",
        lambda data: table(data, "sim", "error"),
        draw_sim,
    ),
    Chart(
        "sim_cost",
        "Simulator: speed by number of parts, for every model of the ladder.",
        lambda data: table(data, "sim", "cost"),
        draw_cost,
    ),
    Chart(
        "solver_error_time",
        "Averaged problem: error against time of single random targets, from a cold start. The "
        "dashed line is what was wanted; errors below 1e-11 are drawn there.",
        lambda data: data["solver"]["samples"],
        draw_solver,
    ),
    Chart(
        "force_map",
        "The averaged force map: error of the worst 1 % of random cases against time. The dashed "
        "line is what was wanted.",
        force_map_rows,
        draw_force_map,
    ),
    Chart(
        "realised",
        "Force over one cycle in the simulator: what is missed of random requests, against the "
        "time of a solve, for both methods and every map. The dashed line is what was wanted.",
        lambda data: table(data, "requests", "realised"),
        draw_realised,
    ),
    Chart(
        "rotations",
        "Method A: guaranteed and realised forces, and the time of its linear problem, beside "
        "the paper's SVD, HiGHS and least squares.",
        rotation_rows,
        draw_rotations,
    ),
    Chart(
        "inversion",
        "Method B: what becomes of random requests, and the time of a solve. In brackets: as many "
        "harmonics as the solver chooses.",
        lambda data: table(data, "inversion", "fate"),
        draw_inversion,
    ),
    Chart(
        "steering",
        "Steering on the true cycle: how time and missed displacement grow with the number of "
        "parts. The truth is plate_sim's.",
        lambda data: table(data, "steering", "steering"),
        draw_steering,
    ),
    Chart(
        "stage_cost",
        "Cost of each stage for one image while parts are sorted. All of it, image to setpoints, "
        "has to fit into one cycle.",
        lambda data: table(data, "stages", "stages"),
        draw_stages,
    ),
    Chart(
        "vision",
        "Finding discs: error of the centres against time, ours and its peers. Hollow: parts are "
        "missed or invented, with how many. Down and to the left is better.",
        lambda data: table(data, "vision", "vision"),
        draw_vision,
    ),
    Chart(
        "tracking",
        "Parts on circles of 50 mm radius: tracking error against speed, and the fastest speed "
        "that is kept (filled), against the number of parts; beside aT/16, the bound.",
        lambda data: table(data, "tracking", "tracking"),
        draw_tracking,
    ),
    Chart(
        "learning",
        "Learning the plate: 35 Hz, damping 3 %, motors 15 % apart. Error of the harmonics of "
        "cycles not used for learning, after each experiment; three are the calibration.",
        lambda data: table(data, "learning", "learning"),
        draw_learning,
    ),
)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="measure little where it is missing")
    parser.add_argument("--out", type=Path, default=ROOT / "out", help="(out)")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
