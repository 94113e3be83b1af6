"""Sorting time and dropped parts by number of parts.

The complete loop is simulated in a clean world, with image noise, even friction and colliding
parts.
"""

from __future__ import annotations

from harness import Cache, Result, Table, by_case
from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from tasks.runs import sorting, summed

COUNTS = {50: 2, 32: 2, 24: 3, 16: 5, 10: 5}
"""Number of seeds, by number of parts. The longest runs are first: a run with 50 parts takes as
long as 30 runs with 10 parts."""


def measure(quick: bool) -> Result:
    """Run the sort tasks with all numbers of parts."""
    rig, counts = load_rig(), {10: 1} if quick else COUNTS
    cases = {n: [(Setup(sorting(n), k), rig) for k in range(runs)] for n, runs in counts.items()}
    rows = [
        {"scenario": f"sort_{count}", "gamma": rig.gamma, "parts": count} | summed(runs)
        for count, runs in by_case(summary, cases, Cache.of(__name__)).items()
    ]
    return Result([Table.of("parts", rows[::-1])])
