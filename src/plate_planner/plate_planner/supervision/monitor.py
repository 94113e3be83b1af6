"""Monitor of the planner's inputs. The monitor decides whether a task can start, and whether it can
continue.

`InputMonitor` combines four checks: timeouts of inputs, the driver's state, a second publisher of a
topic, and stalls of the planner's own process. The time is an argument of the methods [s, steady
clock].
"""

from __future__ import annotations

from collections.abc import Callable

from plate_core.standstill import Standstill
from plate_core.status import Finding

from .inputs import Inputs
from .phase import Failure, Reason, TaskState

STILL_S = 1.0
"""If the planner's process has stalled for longer than this time [s], the planner refuses goals
that may have waited during the stall."""

SINGLE = ("parts", "part_forces", "plate_cycle", "driver_status", "cycle_started", "feed_orders")
"""Topics that may have only one publisher. If time is simulated, the clock is another one."""

MARGIN_S = 0.1
"""Additional time that the monitor waits until all parts are detected [s]. With this time, the
planner itself normally ends the task first."""


class InputMonitor:
    """Stores the state of the planner's inputs, and decides whether a task can start or continue.

    All times are measured by the steady clock [s].

    Parameters
    ----------
    inputs : Inputs
    start_timeout_s : float
        Maximum time from the arrival of a goal until all parts are detected [s].
    now : float
        Present time [s].
    publishers : callable
        Function that returns the number of publishers of a topic.
    second_publisher : callable
        Function that returns a text if several nodes publish a topic, otherwise "".
    second_clock : callable
        Function that returns a text if several nodes publish the simulated time that this node
        uses, otherwise "".

    Attributes
    ----------
    inputs : Inputs
        State of the planner's inputs. The owner of the monitor records each message in this object.
    """

    def __init__(
        self,
        inputs: Inputs,
        start_timeout_s: float,
        now: float,
        publishers: Callable[[str], int],
        second_publisher: Callable[[str], str],
        second_clock: Callable[[], str] = str,
    ) -> None:
        self.inputs, self._start_timeout_s = inputs, start_timeout_s
        self._standstill = Standstill(STILL_S, now)
        self._publishers, self._second_publisher = publishers, second_publisher
        self._second_clock = second_clock

    def wake(self, now: float, period: float) -> Failure | None:
        """Record that the planner is running. Return a failure if the planner's process has stalled
        since the last call for longer than the input timeout. Otherwise return None.

        Each callback of the node must call this method first. `period` is the length of a cycle
        [s].
        """
        self._standstill.is_late(now)
        failure = self.inputs.stood_still(now, period)
        self.inputs = self.inputs.ran_at(now) if failure is None else self.inputs.woken(now)
        return failure

    def goal_may_be_old(self, now: float) -> bool:
        """Whether a goal that is received at the time `now` may have waited while the process
        stalled."""
        return self._standstill.is_late(now)

    def second_publishers(self) -> str:
        """Return a text if a topic of `SINGLE` or the clock has several publishers. Otherwise
        return ""."""
        # The clock is first, because a clock that jumps has many other effects.
        return self._second_clock() or next(filter(None, map(self._second_publisher, SINGLE)), "")

    def findings(self, now: float) -> list[Finding | None]:
        """Return findings about missing inputs for the diagnostics at the time `now`."""
        return self.inputs.findings(now, self._publishers)

    def start_problem(self, now: float) -> str:
        """Return the reason why a task cannot start, or "" if it can start."""
        return (
            self.second_publishers()
            or self.inputs.driver_problem(now)
            or self.inputs.parts_problem(now, self._publishers)
            or self.inputs.starts_problem(now)
        )

    def task_problem(
        self, now: float, goal_time: float, task: TaskState, period: float
    ) -> Failure | None:
        """Return the reason why a running task cannot continue, or None if it can continue.

        Parameters
        ----------
        now : float
            Present time [s].
        goal_time : float
            Arrival time of the goal [s].
        task : TaskState
        period : float
            Length of a cycle [s].
        """
        failure = self.inputs.problem(now, goal_time, period, self._publishers)
        waited = now - goal_time > self._start_timeout_s + MARGIN_S
        if failure is None and task.began is None and waited:
            # The planner has a time limit that is measured by stamps. If the stamps do not advance,
            # this limit is never reached. Therefore the monitor also measures the time.
            text = f"not all parts were detected within {self._start_timeout_s:g} s after the goal"
            failure = Failure(Reason.PARTS_MISSING, text)
        if several := self.second_publishers():
            text = "; ".join(filter(None, (failure and failure.text, several)))
            failure = Failure(failure.reason if failure else Reason.RIVAL, text)
        return failure
