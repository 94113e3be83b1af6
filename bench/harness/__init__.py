"""Common functions of all measurements: fair timing, results and their files, cache, parallel runs.

The closed loop without ROS is `plate_bringup.loop`. `harness.serial` runs this loop over a
simulated serial line.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools"))

from harness.cache import Cache
from harness.measurements import LONG, MEASUREMENTS, is_done, read, report_failures, run_all
from harness.pairs import paired, places
from harness.pool import by_case, cluster_option, executor, on_cluster, parallel, resumed
from harness.race import MIN_ROUNDS, Race, cpu_time, race, timed
from harness.result import (
    ROOT,
    Result,
    Table,
    commit,
    folder_made,
    missing,
    optional,
    rounded,
    shown,
    text_table,
    write,
)
from harness.rows import Rows
from plate_core.intervals import of_median, of_rate, rate_text

__all__ = [
    "LONG",
    "MEASUREMENTS",
    "MIN_ROUNDS",
    "ROOT",
    "Cache",
    "Race",
    "Result",
    "Rows",
    "Table",
    "by_case",
    "cluster_option",
    "commit",
    "cpu_time",
    "executor",
    "folder_made",
    "is_done",
    "missing",
    "of_median",
    "of_rate",
    "on_cluster",
    "optional",
    "paired",
    "parallel",
    "places",
    "race",
    "rate_text",
    "read",
    "report_failures",
    "resumed",
    "rounded",
    "run_all",
    "shown",
    "text_table",
    "timed",
    "write",
]  # fmt: skip
