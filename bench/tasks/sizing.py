"""Number of parts: time, parts dropped.

The whole loop in a clean world: image noise, even friction, parts that collide.
"""

from __future__ import annotations

from harness import Cache, Result, Table, by_case
from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from tasks.runs import sorting, summed

COUNTS = {50: 2, 32: 2, 24: 3, 16: 5, 10: 5}
"""Parts that are sorted, and how many seeds; the longest first: a run of 50 parts takes as long as
thirty of 10."""


def measure(quick: bool) -> Result:
    """Sort all numbers of parts."""
    rig, counts = load_rig(), {10: 1} if quick else COUNTS
    cases = {n: [(Setup(sorting(n), k), rig) for k in range(runs)] for n, runs in counts.items()}
    rows = [
        {"scenario": f"sort_{count}", "gamma": rig.gamma, "parts": count} | summed(runs)
        for count, runs in by_case(summary, cases, Cache.of(__name__)).items()
    ]
    return Result([Table.of("parts", rows[::-1])])
