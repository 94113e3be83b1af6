"""Computes the level, the message and the values of the planner's diagnostics. This module does not
use ROS.

The level is the most severe level of the task, its inputs and the estimator. The message contains
the texts of all three, the most severe text first.
"""

from __future__ import annotations

from plate_core.status import Finding, Level, combined

from .supervision import InputMonitor
from .task_run import TaskRunner

__all__ = ["PlannerDiagnostics"]


class PlannerDiagnostics:
    """Computes the level, the message and the values of the planner's diagnostics.

    Parameters
    ----------
    tasks : TaskRunner
    monitor : InputMonitor
    triggered : bool
        Whether the camera takes images at cycle starts.

    Attributes
    ----------
    refusal : str
        Reason why the last invalid message was refused. Empty if no message was refused since the
        diagnostics were last published.
    """

    def __init__(self, tasks: TaskRunner, monitor: InputMonitor, triggered: bool) -> None:
        self._tasks, self._monitor, self._triggered = tasks, monitor, triggered
        self.refusal = ""

    def finding(self, now: float) -> Finding:
        """Return the level and the message of the diagnostics at the time `now` [s, steady
        clock]."""
        findings = self._monitor.findings(now)
        image_problem = self._tasks.estimator.image_problem
        if image_problem and self._triggered:
            image_problem += "; set camera_triggered to false"
        for text in (
            self.refusal,
            self._monitor.second_publishers(),
            image_problem,
            self._tasks.estimator.answer_problem,
            self._tasks.others(),
        ):
            if text:
                findings.append(Finding(Level.WARN, text))
        result, run = combined(findings, ""), self._tasks.run
        if run is None:
            return Finding(result.level, "; ".join(filter(None, ("idle", result.message))))
        level = result.level
        if run.task.phase.is_failure:
            failure = Level.ERROR if run.failed else Level.WARN
            level = max(level, failure, key=lambda found: found.rank)
        new = [
            found for found in findings if found is not None and found.message not in run.task.text
        ]
        return Finding(level, "; ".join(filter(None, (run.task.text, combined(new, "").message))))

    def values(self, now: float) -> dict[str, str]:
        """Return the values of the diagnostics at the time `now` [s, steady clock], by name."""
        run, inputs = self._tasks.run, self._monitor.inputs
        progress = {} if run is None or run.progress is None else run.progress.values()
        driver = inputs.driver_status
        return {
            **progress,
            "task": "" if run is None else run.name,
            "refusal": self.refusal,
            "task_state": "idle" if run is None else run.task.text,
            "driver_status": "" if driver is None else driver.text,
            "parts_silent_s": f"{inputs.parts.age(now):.2f}",
            "overlooked": str(self._tasks.overlooked.count),
            "image_rate_hz": f"{self._tasks.estimator.image_rate:.1f}",
            "prediction_error_m": f"{self._tasks.estimator.prediction_error:.6f}",
        }

    def reported(self) -> None:
        """Clear `refusal`. Call this method after the diagnostics were published."""
        self.refusal = ""
