"""One line that tells how a running task gets on."""

from __future__ import annotations

import sys
import time

from plate_core.tasks import AssembleTask, FollowTask, PoseTask, Scenario

from .record import Record


class ProgressLine:
    """Rewrites itself on a terminal; elsewhere a new line every `QUIET_S`."""

    PERIOD_S = 0.25
    QUIET_S = 2.0

    def __init__(self, scenario: Scenario) -> None:
        self._following = isinstance(scenario.task, FollowTask)
        self._there = "placed" if isinstance(scenario.task, AssembleTask | PoseTask) else "sorted"
        self._terminal = sys.stdout.isatty()
        self._shown_at = 0.0

    def show(self, record: Record, last: bool = False) -> None:
        """Print what is known now; `last`: and end the line."""
        now = time.monotonic()
        if self._terminal:
            print(f"\r\033[K  {self.text(record)}", end="\n" if last else "", flush=True)
        elif last or now - self._shown_at >= self.QUIET_S:
            self._shown_at = now
            print(f"  {self.text(record)}", flush=True)

    def text(self, record: Record) -> str:
        """Return the line."""
        if not record.last("planner", "time_s"):
            return "waiting for the first image"
        if self._following:
            done = f"error {1e3 * float(record.last('planner', 'rms_error_m')):.2f} mm rms"
        else:
            done = f"{record.last('planner', 'parts_sorted')}/" + record.last(
                "planner", "parts_total"
            )
            done += f" parts {self._there}"
        missed = 100 * float(record.last("solver", "missed_share", "0"))
        return (
            f"{done} | {float(record.last('planner', 'time_s')):5.1f} s"
            f" | force missed {missed:3.0f} %"
            f" | solve {float(record.last('solver', 'solve_ms_median', '0')):3.0f} ms"
        )
