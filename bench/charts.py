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
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from harness import ROOT
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from report import write_report
from run import MEASUREMENTS, run_all

from plate_sim.friction import STEP

OURS, PEER, SECOND, FAINT = "#0b6e99", "#d1651e", "#5a9e4b", "#8a8a8a"
"""Colours: our default method, the peer, our second method, notes."""

PALETTE = ("#0b6e99", "#d1651e", "#5a9e4b", "#7d4f9e")

SIMULATED = {"simulator": "parts", "camera": "camera"}
"""Names of the stages that only the simulation has."""

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


def draw_sim(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Error against speed, a point for each step."""
    both = figure.subplots(1, 2, sharey=True)
    for axes, gamma in zip(both, sorted({r["gamma"] for r in rows}), strict=True):
        for method, colour in (("plate_sim", OURS), ("pymunk", PEER)):
            mine = [r for r in rows if r["gamma"] == gamma and r["method"] == method]
            if not mine:
                continue
            x, y = [r["speed"] for r in mine], [r["error_percent"] for r in mine]
            axes.plot(x, y, "o-", color=colour, label=method, ms=5)
            ends = mine if len(mine) < 4 else (mine[0], mine[2], mine[-1])
            for r in ends:
                note(axes, f"{r['step_ms']:g} ms", (r["speed"], r["error_percent"]), colour, 8, -3)
            if method == "plate_sim":
                default = next(r for r in mine if abs(r["step_ms"] - 1e3 * STEP) < 1e-9)
                mark(axes, default["speed"], default["error_percent"], "our default")
        axes.set(xscale="log", yscale="log", xlabel="simulated s per s of one core")
        axes.set_title(f"shaken at {gamma} µg")
        axes.margins(x=0.2, y=0.08)
        axes.yaxis.set_major_formatter("{x:g}")
    both[0].set_ylabel("error of the travel after 1 s [%]")
    figure.legend(*both[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    if not any(r["method"] == "pymunk" for r in rows):
        both[1].text(0.02, 0.02, "pymunk: not installed", transform=both[1].transAxes, color=FAINT)


def draw_solver(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Error against time of every single target, by number of parts."""
    parts = sorted({r["parts"] for r in rows})
    grid = figure.subplots(1, len(parts), sharex=True, sharey=True)
    looks = (
        ("RotationSolver", SECOND, "s"), ("scipy lm", PEER, "x"), ("SinusoidSolver", OURS, "o"),
    )  # fmt: skip
    for axes, count in zip(grid, parts, strict=True):
        for method, colour, marker in looks:
            mine = [r for r in rows if r["parts"] == count and r["method"] == method]
            y = [max(r["error"], 1e-11) for r in mine]
            label = method + (" (default)" if method == "SinusoidSolver" else "")
            axes.plot(
                [r["ms"] for r in mine], y, marker, color=colour, ms=4, alpha=0.6, label=label
            )
        axes.axhline(1e-4, color=FAINT, lw=1, ls="--")
        axes.set(xscale="log", yscale="log", title=f"{count} part{'s' * (count > 1)}")
    grid[0].set_ylabel("largest error of a force [µmg]")
    figure.supxlabel("time of one cold solve [ms]", fontsize=11)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside upper center", ncols=3)


def draw_stages(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Time of each stage against the number of parts."""
    axes = figure.subplots()
    names = ("solver", "vision", "driver", "planner")
    colours = dict(zip(names, PALETTE, strict=True))
    x = [r["parts"] for r in rows]
    ends = []
    for name in names:
        axes.plot(x, [r[name] for r in rows], "o-", color=colours[name], ms=5)
        ends.append((rows[-1][name], name, colours[name]))
    for name, look in (("simulator", ":"), ("camera", "--")):
        axes.plot(x, [r[name] for r in rows], look, color=FAINT, lw=1.5)
        ends.append((rows[-1][name], f"simulated {SIMULATED[name]}", FAINT))
    axes.plot(x, [r["answer"] for r in rows], "-", color="black", lw=1)
    axes.plot(x, [r["period"] for r in rows], "-", color="#b02a37", lw=2)
    ends += [(rows[-1]["answer"], "image to setpoints", "black")]
    ends += [(rows[-1]["period"], "one cycle: the limit", "#b02a37")]
    axes.set(yscale="log", xlabel="parts on the plate", ylabel="median time for one image [ms]")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xticks(x)
    label_ends(axes, x[-1], ends)


def draw_tracking(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Tracking error against speed, with the speed no part can exceed."""
    axes = figure.subplots()
    for method, colour in (("sinusoids", OURS), ("rotations", SECOND)):
        mine = [r for r in rows if r["method"] == method]
        if not mine:
            continue
        x, y = [r["speed_mm_s"] for r in mine], [r["rms_mm"] for r in mine]
        label = method + (" (default)" if method == "sinusoids" else "")
        axes.plot(x, y, "-", color=colour, lw=1.5, label=label)
        for r in mine:
            fill = colour if r["success"] else "white"
            axes.plot(r["speed_mm_s"], r["rms_mm"], "o", color=colour, mfc=fill, ms=7)
        bound = mine[0]["bound_mm_s"]
        axes.axvline(bound, color=colour, ls="--", lw=1.2)
        axes.annotate(
            f"aT/16 = {bound:.0f} mm/s", (bound, 0.97), (-4, 0), color=colour, rotation=90,
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="right", va="top",
            fontsize=9,
        )  # fmt: skip
        for r in mine:
            if r["speed_mm_s"] == 20 and method == "sinusoids":
                mark(axes, 20, r["rms_mm"], "our default: follow_2", right=True)
    axes.plot([], [], "o", color=FAINT, mfc="white", ms=7, label="lost the path")
    axes.set(
        xscale="log", yscale="log", xlabel="speed along the path [mm/s]",
        ylabel="RMS distance from the path's point [mm]",
    )  # fmt: skip
    ticks = sorted({r["speed_mm_s"] for r in rows})
    axes.set_xticks([*ticks, 300, 600, 1200], [f"{t}" for t in [*ticks, 300, 600, 1200]])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter("{x:g}")
    axes.margins(y=0.12)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)


def draw_steering(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Time and missed share against the number of parts."""
    left, right = figure.subplots(1, 2)
    for method, colour in (("sinusoids", OURS), ("rotations", SECOND)):
        mine = [r for r in rows if r["method"] == method]
        x = [r["parts"] for r in mine]
        label = method + (" (default)" if method == "sinusoids" else "")
        left.plot(x, [r["warm_ms"] for r in mine], "o-", color=colour, label=label)
        left.plot(x, [r["cold_ms"] for r in mine], "o:", color=colour, mfc="white")
        right.plot(x, [r["missed_percent"] for r in mine], "o-", color=colour)
        right.plot(x, [r["predicted_percent"] for r in mine], "o:", color=colour, mfc="white")
    left.set(yscale="log", xlabel="parts", ylabel="median time of a solve [ms]")
    left.yaxis.set_major_formatter("{x:g}")
    right.set(xlabel="parts", ylabel="displacement missed, RMS [% of asked]", ylim=(0, None))
    right.axhline(15, color=FAINT, ls="--", lw=1)
    right.annotate(
        "good enough", (1, 15), (0, 3), xycoords=("axes fraction", "data"), fontsize=8.5,
        textcoords="offset points", ha="right", color=FAINT,
    )  # fmt: skip
    for axes, full, empty in ((left, "warm", "cold start"), (right, "in truth", "as predicted")):
        axes.set_xticks(x)
        axes.plot([], [], "o-", color=FAINT, label=full)
        axes.plot([], [], "o:", color=FAINT, mfc="white", label=empty)
        axes.legend(handles=axes.get_lines()[-2:], fontsize=9)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], loc="outside upper center", ncols=2)


def mark(axes: Axes, x: float, y: float, text: str, right: bool = False) -> None:
    """Put a ring round our default and name it, on its left or right."""
    axes.plot(x, y, "o", ms=15, mfc="none", mec="black", mew=1.3)
    axes.annotate(
        text, (x, y), (12 if right else -12, 0), textcoords="offset points",
        ha="left" if right else "right", va="center", fontsize=9.5,
    )  # fmt: skip


def note(
    axes: Axes, text: str, place: tuple[float, float], colour: str, right: float = 7, up: float = 4
) -> None:
    """Write a small word beside a point, `right` and `up` of it [points]."""
    axes.annotate(text, place, (right, up), textcoords="offset points", fontsize=8.5, color=colour)


def label_ends(axes: Axes, x: float, ends: Iterable[tuple[float, str, str]]) -> None:
    """Name lines at their right ends, moved apart (logarithmic axis)."""
    placed, least = -np.inf, 0.062 * float(np.diff(np.log10(axes.get_ylim()))[0])
    for y, text, colour in sorted(ends):
        placed = max(float(np.log10(y)), placed + least)
        axes.annotate(
            text, (x, 10**placed), (10, 0), textcoords="offset points", color=colour,
            va="center", fontsize=10, annotation_clip=False,
        )  # fmt: skip


CHARTS = (
    Chart(
        "sim_error_speed",
        "Simulator: error and speed at several steps, 1 part, beside pymunk. Down and to the right "
        "is better.",
        lambda data: table(data, "sim", "error"),
        draw_sim,
    ),
    Chart(
        "solver_error_time",
        "Averaged problem: error against time of single random targets, from a cold start. The "
        "dashed line is what was wanted; errors below 1e-11 are drawn there.",
        lambda data: data["solver"]["samples"],
        draw_solver,
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
        "tracking",
        "Two parts on a rectangle each: tracking error against speed, and the speed that no part "
        "can exceed.",
        lambda data: table(data, "tracking", "tracking"),
        draw_tracking,
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
