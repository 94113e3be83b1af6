"""Measure every stage and its best baseline. Write out/bench/NAME.json and print a short table.

python bench/run.py [NAME ...] [--quick] [--cluster ADDRESS]
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from harness import (
    LONG,
    MEASUREMENTS,
    ROOT,
    cluster_option,
    folder_made,
    on_cluster,
    report_failures,
    run_all,
    text_table,
)
from plate_core import PlateError, did_you_mean, piped


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    args = arguments()
    unknown = [name for name in args.names if name not in MEASUREMENTS]
    if unknown:
        allowed = ", ".join(MEASUREMENTS)
        hint = did_you_mean(unknown[0], MEASUREMENTS)
        print(f"error: measurement is {unknown[0]!r}{hint}, allowed: {allowed}", file=sys.stderr)
        return 2
    if not folder_made(args.out):
        return 2
    names = args.names or [name for name in MEASUREMENTS if args.quick or name not in LONG]
    try:
        with on_cluster(args.cluster):
            failed = run_all(names, args.quick, args.out)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    for name in (name for name in names if name not in failed):
        data = json.loads((args.out / f"{name}.json").read_text(encoding="utf-8"))
        print(f"\n== {name}: {data['about']}")
        for table in data["tables"]:
            print("\n".join(text_table(table)))
        for line in data["summary"]:
            print(f"  -> {line}")
    return report_failures(failed)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MEASUREMENTS))
    parser.add_argument("--quick", action="store_true", help="measure fewer cases")
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "out/bench",
        help="folder for the results (default: out/bench)",
    )
    cluster_option(parser)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
