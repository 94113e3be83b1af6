"""Measure what the charts need and draw them: docs/results.md and out/report/index.html.

python bench/charts.py [--quick] [--draw]

Measurements go to out/bench/*.json. One that is there is not made again, unless the code that it
rests on has changed, or it was a quick one and --quick is not given.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from harness import ROOT, is_done, optional, read, run_all
from plate_core import PlateError
from report.chart import Chart, Data
from report.forces import force_map, inversion, learning, rotations
from report.loop import control, tracking
from report.plot import save_picture
from report.results import FOLDER, write_results
from report.solver import options, solver, steering
from report.stability import STABILITY
from report.world import cost, sim, vision

CHARTS: tuple[tuple[Callable[[Data], Chart], tuple[str, ...]], ...] = (
    (force_map, ("force_map",)),
    (solver, ("solver",)),
    (options, ("options",)),
    (steering, ("steering",)),
    (rotations, ("rotations",)),
    (inversion, ("inversion",)),
    (sim, ("sim", "bodies")),
    (vision, ("vision",)),
    (control, ("control",)),
    (tracking, ("tracking",)),
    (cost, ("stages", "sim")),
    (learning, ("learning",)),
    *((make, ("stability",)) for make in STABILITY),
)
"""Every chart, and the measurements that it is drawn from."""


def main() -> int:
    """Run the command line; returns its exit code."""
    args = arguments()
    if optional("plotly") is None:
        print(
            "error: plotly is not installed: pip install -r requirements-bench.txt", file=sys.stderr
        )
        return 1
    folder = args.out / "bench"
    if not args.draw:
        needed = dict.fromkeys(name for _, names in CHARTS for name in names)
        run_all([n for n in needed if not is_done(folder, n, args.quick)], args.quick, folder)
    data = read(folder)
    charts = list(made(data))
    if not charts:
        print(f"error: no measurement in {folder}: leave out --draw", file=sys.stderr)
        return 1
    # The project's own text shows thorough measurements only.
    own = args.out == ROOT / "out" and not args.quick
    draw(charts, data, ROOT / "docs" if own else args.out / "docs", args.out / "report/index.html")
    return 0


def made(data: Data) -> Iterator[Chart]:
    """Yield all charts for which there are measurements; the others are told."""
    for make, names in CHARTS:
        try:
            if names[0] not in data:
                raise PlateError(f"measurement {names[0]} is not there")
            yield make(data)
        except PlateError as error:
            print(f"left out a chart: {error}", file=sys.stderr)


def draw(charts: list[Chart], data: Data, docs: Path, page: Path) -> None:
    """Write pictures and tables, the text that shows them, and the page."""
    from report.page import csv_text, write_report  # needs plotly

    folder = docs / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for chart in charts:
        (folder / f"{chart.key}.csv").write_text(csv_text(chart.rows), encoding="utf-8")
        save_picture(chart, folder / f"{chart.key}.png")
    write_results(docs / "results.md", data, charts)
    write_report(page, data, charts)
    print(f"{docs / 'results.md'}\n{page}")


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="measure little where it is missing")
    parser.add_argument("--draw", action="store_true", help="only draw what is there")
    parser.add_argument("--out", type=Path, default=ROOT / "out", help="(out)")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
