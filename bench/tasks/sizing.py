"""How many parts a rig sorts: the default one, more and more parts.

The whole loop in a clean world: image noise, even friction, parts that collide.
"""

from __future__ import annotations

from harness import Cache, Result, Table, processes, resumed
from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from tasks.runs import sorting, summed

COUNTS = {50: 2, 32: 2, 24: 3, 16: 5, 10: 5}
"""Parts that are sorted, and how many seeds; the longest first: a run of 50 parts takes as long as
thirty of 10."""

COLUMNS = {
    "scenario": "scenario", "gamma": "shaking ratio", "parts": "parts", "succeeded": "succeeded",
    "dropped": "dropped", "time_s": "time, median [s]", "longest_s": "longest [s]",
    "rms_mm": "RMS error, median [mm]", "worst_rms_mm": "of the worst run [mm]",
}  # fmt: skip


def measure(quick: bool) -> Result:
    """Sort all numbers of parts."""
    rig, cache = load_rig(), Cache.of(__name__)
    counts = {10: 1} if quick else COUNTS
    work = {
        f"{count} {seed}": (Setup(sorting(count), seed), rig)
        for count, runs in counts.items()
        for seed in range(runs)
    }
    with processes() as pool:
        done = iter(resumed(pool, summary, work, cache))
    rows = []
    for count, runs in counts.items():
        mine = [next(done) for _ in range(runs)]
        row = {"scenario": f"sort_{count}", "gamma": rig.gamma, "parts": count} | summed(mine)
        rows.append({key: row[key] for key in COLUMNS})
    note = "Seeds from 0 on; time is simulated. Image noise, even friction, parts that collide."
    rows = rows[::-1]
    return Result(
        [Table("parts", "How many parts are sorted", COLUMNS, rows, note)],
    )
