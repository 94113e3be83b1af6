"""Disturb the real graph and evaluate its behaviour: one command, six cases.

python tools/robustness.py --case NAME [OPTIONS] [--json FILE]

faults      kill, freeze and cut off each node during a task
freezes     freeze and kill nodes at random, and evaluate the age of every motor table
fuzz        send malformed messages to every topic of each node
goals       send valid and invalid goals, cancels, preemptions and stops at random
page_flood  send commands from several sockets to the live page
soak        run task after task in real time, and measure growth of memory and drift of latency

The file of a case (tools/cases) describes its criteria. The exit code is 1 if a case fails.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from contextlib import closing, suppress
from inspect import signature
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cases import Outcome
from graph.processes import Interrupted, signals_raise

from plate_core import PlateError, piped

CASES = ("faults", "freezes", "fuzz", "goals", "page_flood", "soak")

OPTIONS: dict[str, dict[str, Any]] = {
    "nodes": {"nargs": "+", "help": "names of nodes; default: all"},
    "count": {"type": int, "help": "number of faults, goals, or messages to each node"},
    "minutes": {"type": float, "help": "duration; for freezes the maximum"},
    "seed": {"type": int, "help": "random seed; default: 0"},
    "transport": {"choices": ("sim", "serial"), "help": "default: sim"},
    "kills": {"type": float, "help": "fraction of faults that kill a node; default: 0"},
    "image_rate": {"type": float, "help": "rate of a free-running camera [1/s]; default: 0, none"},
    "scenario": {"help": "default: that of the demo"},
    "uneven": {"type": float, "help": "variation of friction [fraction]; default: 0"},
}
"""All options of the cases. A case accepts the options that are arguments of its function `run`."""


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", required=True, choices=CASES)
    for name, values in OPTIONS.items():
        parser.add_argument(f"--{name}", default=argparse.SUPPRESS, **values)
    parser.add_argument("--json", type=Path, help="file for the result")
    given = vars(parser.parse_args())
    case, path = given.pop("case"), given.pop("json")
    run = importlib.import_module(f"cases.{case}").run
    known_options = [*signature(run).parameters][1:]
    for name in given:
        if name not in known_options:
            parser.error(
                f"--{name} is no option of {case}, allowed: --{', --'.join(known_options)}"
            )
    last = Outcome(None)
    with TemporaryDirectory() as logs, signals_raise(), suppress(Interrupted):
        try:
            with closing(run(Path(logs), **given)) as outcomes:
                for last in outcomes:
                    if last.line:
                        print(last.line, flush=True)
                    # write the file after each step, so that an interrupted run also has a result
                    if path:
                        path.write_text(json.dumps(last.result, indent=1), encoding="utf-8")
        except PlateError as error:
            sys.exit(f"{case}: {error}")
    print(last.text or json.dumps(last.result, indent=1))
    return 0 if last.well else 1


if __name__ == "__main__":
    sys.exit(main())
