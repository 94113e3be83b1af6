"""Measure and draw docs/results.md, out/report/index.html and tables of other pages.

The tables are in README, docs/graph.md, docs/guide/rig.md and docs/guide/trust.md.

python bench/charts.py [--quick] [--draw] [--cluster ADDRESS]

Measurements are written to out/bench/*.json. An existing measurement is repeated if its code has
changed. A quick measurement is also repeated if --quick is not given. The measurements of
docs/results.md require a committed tree, and wait until the computer is idle. --draw draws the
existing measurements. With --draw, a chart that was not measured on this computer is drawn from its
CSV file in docs/results (or OUT, with --out OUT).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from harness import (
    ROOT,
    cluster_option,
    commit,
    folder_made,
    is_done,
    on_cluster,
    optional,
    read,
    report_failures,
    run_all,
)
from plate_core import PlateError, piped


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    args = arguments()
    if not folder_made(args.out):
        return 2
    for name in ("plotly", "kaleido", "pandas", "tabulate"):
        if optional(name) is None:
            lack = f"error: {name} is not installed: pip install -r requirements-bench.txt"
            print(lack, file=sys.stderr)
            return 1
    import report

    folder = args.out / "bench"
    failed: list[str] = []
    # The pages of the project contain only complete measurements. Therefore the pages are updated
    # only without --quick.
    published = args.out == ROOT / "out" and not args.quick
    if not args.draw:
        needed = dict.fromkeys(name for chart in report.CHARTS for name in chart.sources)
        needed |= dict.fromkeys(report.names())
        lacking = [name for name in needed if not is_done(folder, name, args.quick)]
        if published and lacking and commit().endswith("-dirty"):
            dirty = (
                f"error: the commit is {commit()}, which has uncommitted changes, allowed: none "
                "(or use --quick)"
            )
            print(dirty, file=sys.stderr)
            return 1
        try:
            with on_cluster(args.cluster if lacking else ""):
                failed = run_all(lacking, args.quick, folder, when_idle=published)
        except PlateError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
            return 130
    text = (ROOT if published else args.out) / "docs/results.md"
    data, results = read(folder), text.with_suffix("")
    # the measurement is valid for the current commit, because the measured code is unchanged
    for name in data:
        if is_done(folder, name, args.quick):
            data[name]["commit"] = commit()
    facts, columns = report.read_facts(results, data)
    charts = report.made(data, results, columns)
    if not charts:
        why = f"{folder} and {results} contain no results; measure first, without --draw"
        print(f"error: {why}", file=sys.stderr)
        return report_failures(failed) or 1
    report.write_results(text, facts, charts)
    report.write_report(args.out / "report/index.html", facts, charts)
    if published:
        report.fill_documents(data, facts)
    print(f"{text}\n{args.out / 'report/index.html'}")
    return report_failures(failed)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="if results are missing, measure only a few cases"
    )
    parser.add_argument(
        "--draw", action="store_true", help="draw the existing results, measure nothing"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "out",
        help="folder for the measurements (bench/) and the page (report/); with a folder other "
        "than out, docs/results.md is also written there (default: out)",
    )
    cluster_option(parser)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
