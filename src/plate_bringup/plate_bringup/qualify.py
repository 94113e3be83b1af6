"""Command that predicts how many parts per minute a feeder will present, before the rig is built:
`ros2 run plate_bringup qualify`.

The command simulates production with several numbers of parts on the plate. `python -m
plate_bringup.qualify` is the same command for computers without ROS.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from plate_core import MAX_PARTS, PlateError, Rig, load_rig, piped
from plate_core.rig import rig_names, rig_path
from plate_core.tasks import Scenario, load_scenario

from .loop import Setup
from .production import FeederCell, Production, filled, percentiles, produce

__all__ = ["Row", "page", "qualified"]

AS_GOOD = 0.99
"""The best fill is the smallest number of parts on the plate that reaches this fraction of the
maximum number of parts per minute."""

CYCLE_S = (0.2, 60.0)
"""Allowed range of the robot's cycle [s]."""

MINUTES = (0.05, 60.0)
"""Allowed range of the duration of one production [min]."""

MAX_SEEDS = 100

HEADINGS = (
    "fill", "parts/min", "worst", "robot waits", "first pick", "failed", "lost", "chute",
    "error P95", "turned P95", "CPU",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """Results for one fill. A fill is the number of parts that the hopper keeps on the plate.

    Attributes
    ----------
    fill : int
        Number of parts that the hopper keeps on the plate.
    runs : tuple of Production
        One result for each seed.
    """

    fill: int
    runs: tuple[Production, ...]

    @property
    def parts_per_min(self) -> float:
        """Mean number of parts per minute over the runs."""
        return float(np.mean([run.parts_per_min for run in self.runs]))

    @property
    def waiting(self) -> float:
        """Mean fraction of the time for which the robot waits [-]."""
        return float(np.mean([run.waiting for run in self.runs]))

    @property
    def cells(self) -> tuple[str, ...]:
        """Results as texts, in the order of `HEADINGS`."""
        runs = self.runs
        first = percentiles([run.first_s for run in runs], 1.0)[0]
        error = percentiles([run.error_mm[1] for run in runs], 1.0)[2]
        turned = percentiles([run.error_deg[1] for run in runs], 1.0)[2]
        return (
            str(self.fill), f"{self.parts_per_min:.1f}",
            f"{min(run.parts_per_min for run in runs):.1f}", f"{100 * self.waiting:.1f} %",
            _value_text(first, "s", 1), str(sum(run.failed for run in runs)),
            str(sum(run.lost for run in runs)), str(sum(run.discharged for run in runs)),
            _value_text(error, "mm", 2), _value_text(turned, "deg", 1),
            f"{100 * np.mean([run.cpu for run in runs]):.0f} %",
        )  # fmt: skip


def _value_text(value: float, unit: str, digits: int) -> str:
    return f"{value:.{digits}f} {unit}" if np.isfinite(value) else "-"


def best(rows: Sequence[Row]) -> Row | None:
    """Return the row of the best fill (see `AS_GOOD`), or None if no part was picked."""
    max_rate = max(row.parts_per_min for row in rows)
    good = [row for row in rows if row.parts_per_min >= AS_GOOD * max_rate]
    return min(good, key=lambda row: row.fill) if max_rate > 0 else None


def qualified(
    recipe: Scenario,
    rig: Rig,
    fill: int,
    cycle_s: float,
    time_s: float,
    seeds: Sequence[int],
    note: Callable[[int, FeederCell], None],
) -> Row:
    """Simulate production with one fill, which is the number of parts that the hopper keeps on the
    plate.

    Parameters
    ----------
    recipe : Scenario
        Feed task with a hopper.
    rig : Rig
    fill : int
    cycle_s, time_s : float
        Cycle of the robot, and duration of each run [s].
    seeds : sequence of int
    note : callable
        Function that is called with the seed after each computed cycle.

    Raises
    ------
    PlateError
        If the recipe is impossible with this rig or this fill.
    """
    setups = [Setup(filled(recipe, fill), seed) for seed in seeds]
    runs = [
        produce(setup, cycle_s, time_s, rig, lambda cell, setup=setup: note(setup.seed, cell))  # type: ignore[misc]
        for setup in setups
    ]
    return Row(fill, tuple(runs))


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a text table, in which the best fill is marked."""
    chosen = best(rows)
    cells = [HEADINGS, *(row.cells for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(HEADINGS))]
    marks = ["", *(" <- best fill" if row is chosen else "" for row in rows)]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) + mark
        for line, mark in zip(cells, marks, strict=True)
    )


def page(path: Path, title: str, about: str, rows: Sequence[Row]) -> None:
    """Write a web page with a chart and a table.

    Raises
    ------
    PlateError
        If the page cannot be written.
    """
    chosen = best(rows)
    head = "".join(f"<th>{escape(word)}</th>" for word in HEADINGS)
    body = "\n".join(
        f"<tr{' class=best' if row is chosen else ''}>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in row.cells)
        + "</tr>"
        for row in rows
    )
    best_fill = f"Best fill: {chosen.fill} parts." if chosen else "No part was picked."
    text = f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>
<style>
body {{ font: 16px/1.5 sans-serif; color: #222; max-width: 60em; margin: 2em auto; padding: 0 1em }}
table {{ border-collapse: collapse }} td, th {{ padding: .2em .7em; text-align: right }}
tr {{ border-bottom: 1px solid #ddd }} .best {{ background: #e3f0f7; font-weight: bold }}
svg {{ max-width: 100%; height: auto }}
</style>
<h1>{escape(title)}</h1>
<p>{escape(about)}</p>
<p><b>{escape(best_fill)}</b></p>
{chart(rows)}
<table><tr>{head}</tr>
{body}
</table>
<p>Best fill: the smallest fill with at least {100 * AS_GOOD:.0f} % of the maximum parts per minute.
Worst: the run with the fewest parts per minute. Robot waits: fraction of the time since its first
pick. Lost: parts that left the plate over an edge without the chute, and requested parts that left
it over the chute. Chute: other parts that left the plate over the chute. Errors: deviation of the
part's position and angle at the grip from those reported to the robot. P95: 95th percentile. CPU:
fraction of one core of this machine for vision, planner, solver and driver.</p>
</html>
"""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PlateError(
            f"page is {path}: {error.strerror}, allowed: a file in an existing folder"
        ) from None


def chart(rows: Sequence[Row]) -> str:
    """Return a chart (SVG) of the parts per minute and the waiting time over the fill. Each dot is
    one run."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({"svg.fonttype": "none", "font.size": 11}):
        figure = Figure(figsize=(9, 3.4), layout="constrained")
        panels = figure.subplots(1, 2)
        series = (
            ("parts per minute", [[run.parts_per_min for run in row.runs] for row in rows]),
            ("robot waits [%]", [[100 * run.waiting for run in row.runs] for row in rows]),
        )
        fills = [row.fill for row in rows]
        for panel, (label, values) in zip(panels, series, strict=True):
            for fill, found in zip(fills, values, strict=True):
                panel.plot([fill] * len(found), found, ".", color="#767676")
            panel.plot(fills, [np.mean(found) for found in values], "o-", color="#0b5f8a")
            panel.set(xlabel="fill [parts]", ylabel=label, xticks=fills)
            panel.set_ylim(0, 1.1 * max(1.0, *(max(found) for found in values)))
            panel.grid(color="#e4e4e4")
        file = io.StringIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()[file.getvalue().index("<svg") :]


@piped()
def main() -> None:
    """Run the command line. Exit code 0: parts were picked. 1: no part was picked. 2: arguments are
    wrong."""
    args = arguments()
    try:
        recipe = load_scenario(args.recipe)
        rig_name = args.rig or recipe.rig
        rig = load_rig(rig_name)
        if args.page is not None and (
            args.page.is_dir() or not args.page.resolve().parent.is_dir()
        ):
            raise PlateError(f"page is {args.page}, allowed: a file in an existing folder")
        for fill in args.fill:
            filled(recipe, fill)
        about = (
            f"Recipe {recipe.name}, rig {rig_path(rig_name).name}, robot with one pick per "
            f"{args.robot_cycle:g} s, simulated for {args.minutes:g} min with each of {args.seeds} "
            "seeds."
        )
        print(about, flush=True)
        rows = []
        for fill in args.fill:
            progress = Progress(fill, args.seeds, 60 * args.minutes)
            seeds, length_s = range(args.seeds), 60 * args.minutes
            rows.append(qualified(recipe, rig, fill, args.robot_cycle, length_s, seeds, progress))
            progress.done(rows[-1])
        print(table(rows))
        if args.page is not None:
            page(args.page, f"Feeder: {recipe.name}", about, rows)
            print(args.page)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(0 if best(rows) else 1)


class Progress:
    """Progress reports on stderr about the runs of one fill. In a terminal, all reports overwrite
    the same line."""

    def __init__(self, fill: int, seeds: int, time_s: float) -> None:
        self._fill, self._seeds, self._time_s = fill, seeds, time_s
        self._reported = 0
        terminal = sys.stderr.isatty()
        self._begin, self._end, self._each = ("\r\033[K", "", 1) if terminal else ("", "\n", 10)

    def __call__(self, seed: int, cell: FeederCell) -> None:
        """Print the progress if it has changed enough. The simulation calls this method after each
        computed cycle."""
        tally = cell.tally
        done = int(100 * (seed + min(tally.time_s / self._time_s, 1.0)) / self._seeds)
        if done < self._reported + self._each:
            return
        self._reported = done
        print(
            f"{self._begin}fill {self._fill}: {done} %, seed {seed}: {tally.picks} parts in "
            f"{tally.time_s:.0f} s",
            end=self._end, file=sys.stderr, flush=True,
        )  # fmt: skip

    def done(self, row: Row) -> None:
        """Print the result of the runs."""
        print(
            f"{self._begin}fill {row.fill}: {row.parts_per_min:.1f} parts per minute, the robot "
            f"waits {100 * row.waiting:.1f} % of the time",
            file=sys.stderr, flush=True,
        )  # fmt: skip


def arguments() -> argparse.Namespace:
    """Read the arguments of the command line."""
    parser = argparse.ArgumentParser(
        prog="qualify",
        description="Simulate a feeder in production with several fills of the plate, before a "
        "rig is built. Exit code: 0 parts were picked, 1 no parts, 2 wrong arguments.",
    )
    parser.add_argument(
        "--recipe", required=True,
        help="scenario of kind feed: name in config/scenarios, or .yaml file",
    )  # fmt: skip
    parser.add_argument(
        "--rig", default="",
        help=f"rig file, or one of {', '.join(rig_names())} (default: the rig of the recipe)",
    )  # fmt: skip
    parser.add_argument(
        "--robot-cycle", type=_number_parser("robot-cycle", *CYCLE_S), default=2.0, metavar="S",
        help="time between two picks of the robot [s] (default: 2)",
    )  # fmt: skip
    parser.add_argument(
        "--minutes", type=_number_parser("minutes", *MINUTES), default=2.0, metavar="MIN",
        help="simulated duration of each run [min] (default: 2)",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", type=_number_parser("seeds", 1, MAX_SEEDS, int), default=3, metavar="N",
        help="number of runs for each fill (default: 3)",
    )  # fmt: skip
    parser.add_argument(
        "--fill", type=_parse_fills, default=[5, 10, 15, 20, 30], metavar="N,N,...",
        help="numbers of parts that the hopper keeps on the plate (default: 5,10,15,20,30)",
    )  # fmt: skip
    parser.add_argument(
        "--page", type=Path, metavar="FILE.html", help="write the results and a chart"
    )
    return parser.parse_args()


def _number_parser(
    name: str, low: float, high: float, number: Callable[[str], float] = float
) -> Callable[[str], Any]:
    def parse_number(text: str) -> float:
        try:
            value = number(text)
        except ValueError:
            value = np.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{name} is {text}, allowed: {low:g} to {high:g}")
        return value

    return parse_number


def _parse_fills(text: str) -> list[int]:
    fill = _number_parser("fill", 1, MAX_PARTS, int)
    return list(dict.fromkeys(fill(word.strip()) for word in text.split(",")))


if __name__ == "__main__":
    main()
