"""State of the planner's inputs. The state contains the arrival times of messages, and determines
whether a task can continue with these inputs.

All functions are pure, and the time is an argument. All times are measured by the steady clock [s].
Therefore an old image stamp or a stopped simulated clock cannot make an input appear new.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from plate_core.driver_status import DriverState, DriverStatus
from plate_core.status import Finding, Input, Level

from .phase import Failure, Reason

CYCLES = 3.0
"""Minimum timeout of an input [cycles]. If the configured timeout is shorter, this minimum is
used."""

SECOND_HAND_S = 0.2
"""Time by which the planner's timeout exceeds the timeouts of other nodes [s]. If another node
lacks input, it therefore reports this before the planner's timeout. The report of that node
contains the more exact reason."""

ERROR_TIMEOUT_S = 1.0
"""Maximum duration of an error that the driver or the detector reports, and maximum time in which
all messages of the topic parts are refused [s]. If it lasts longer, the task ends. Shorter errors
are tolerated, because a connection may fail for a short time, and the detector may misinterpret a
single image."""

REPORT_TIMEOUT_S = 1.3
"""Maximum age of a node's diagnostics [s]. Nodes publish diagnostics once per second. If the newest
diagnostics of a node are older, the node counts as timed out."""

LOOP = ("detector", "solver", "driver", "device", "simulator")
"""Nodes whose diagnostics are evaluated, in the order of the data flow. If one of these nodes has
no input, the plate does not move as planned."""

FEEDER_S = 1.5
"""Timeout of a feeder's orders [s]. The feeder repeats its order every 0.5 s. If no order arrives
for this time, the plate must rest."""

FRESH_S = 0.5
"""Maximum age of the last messages of the topics parts and plate_cycle [s]. If cycles are long, the
maximum age is longer. If such a message is older, all later nodes in the data flow lack input only
as a consequence. In this case, the reports of the later nodes are ignored."""

LIFE_S = 0.8
"""Maximum age of the message driver_status [s]. The driver publishes this message every 0.5 s."""


@dataclass(frozen=True)
class Report:
    """Newest diagnostics of a node. The attributes are the arrival time, the level, the message,
    and the time since which the level is unchanged."""

    at: float
    level: Level
    message: str
    since: float


@dataclass(frozen=True)
class Inputs:
    """Inputs received so far.

    Attributes
    ----------
    parts, driver : Input
        Arrival times of the messages of the topics parts and driver_status. A message of the topic
        parts counts only if its stamp is new.
    ran : float
        Time at which the planner was last active [s, steady clock]. All other times of type float
        are on the same clock.
    stamp : int or None
        Stamp of the last parts [ns].
    repeated : bool
        Whether the last message of the topic parts had the same stamp as the message before.
    unanswered : float or None
        Time of the first message part_forces for which no plate_cycle has arrived yet. None if no
        plate_cycle is missing.
    driver_status : DriverStatus or None
        Newest message driver_status. None before the first message.
    error_since : float or None
        Time since which driver_status has reported an error. None if it reports no error.
    enabled_ns : int or None
        Time at which the motors were enabled, from the newest ready status [ns, wall clock].
        None before the first ready status.
    enabled_again : float or None
        Time at which `enabled_ns` changed. None if it has not changed. A change shows that the
        motors were stopped before, even if no message reported the stop.
    reports : mapping of str to Report
        Newest diagnostics by node.
    starts : Input or None
        Arrival times of reported cycle starts. None if reports are not required.
    orders : Input or None
        Arrival times of the orders that a feeder repeats. None until the first order.
    refusal : str
        Reason why the last message of the topic parts was refused. Empty if it was accepted.
    refused_since : float or None
        Time since which all messages of the topic parts were refused. None if the last message was
        accepted.
    start_refusal : str
        Reason why the last report of a cycle start was refused, for example because its stamp is
        from another clock than those of the images. Empty if it was accepted.
    """

    parts: Input
    driver: Input
    ran: float
    stamp: int | None = None
    repeated: bool = False
    unanswered: float | None = None
    driver_status: DriverStatus | None = None
    error_since: float | None = None
    enabled_ns: int | None = None
    enabled_again: float | None = None
    reports: Mapping[str, Report] = field(default_factory=dict)
    starts: Input | None = None
    orders: Input | None = None
    refusal: str = ""
    refused_since: float | None = None
    start_refusal: str = ""

    @classmethod
    def none_yet(cls, now: float, timeout_s: float, triggered: bool = True) -> Inputs:
        """Return the state before any message has arrived.

        If the camera is triggered at cycle starts (`triggered`), reports of cycle starts are not
        required.
        """
        parts = Input(
            "parts", "parts", "check that the detector and the camera run", timeout_s, now
        )
        driver = Input(
            "driver_status", "driver_status", "check that the driver runs", timeout_s, now
        )
        advice = "check that the driver or the simulator publishes cycle starts"
        starts = Input("start of a cycle", "cycle_started", advice, timeout_s, now)
        return cls(parts, driver, now, starts=None if triggered else starts)

    # Messages received

    def parts_received(self, now: float, stamp_ns: int) -> Inputs:
        """Record that a message of the topic parts has arrived."""
        if stamp_ns == self.stamp:
            return self if self.repeated else replace(self, repeated=True)
        return replace(self, parts=self.parts.received(now), stamp=stamp_ns, repeated=False)

    def parts_refused(self, now: float, why: str) -> Inputs:
        """Record that the content of a message of the topic parts was refused."""
        since = now if self.refused_since is None else self.refused_since
        return replace(self, refusal=why, refused_since=since)

    def parts_accepted(self) -> Inputs:
        """Record that the content of a message of the topic parts was accepted."""
        return replace(self, refusal="", refused_since=None) if self.refusal else self

    def start_received(self, now: float) -> Inputs:
        """Record that the start of a cycle was reported."""
        if self.starts is None:
            return self
        return replace(self, starts=self.starts.received(now), start_refusal="")

    def start_refused(self, why: str) -> Inputs:
        """Record that a report of a cycle start was refused."""
        return replace(self, start_refusal=why)

    def order_received(self, now: float) -> Inputs:
        """Record that an order of a feeder has arrived."""
        advice = "check that the feeder runs and the computer is fast enough"
        orders = Input("feed_orders", "feed_orders", advice, FEEDER_S, now, now)
        return replace(self, orders=orders)

    def request_sent(self, now: float) -> Inputs:
        """Record that the planner has published part_forces."""
        return self if self.unanswered is not None else replace(self, unanswered=now)

    def cycle_received(self) -> Inputs:
        """Record that a cycle of the solver has arrived."""
        return replace(self, unanswered=None)

    def driver_received(self, now: float, status: DriverStatus) -> Inputs:
        """Record that a message driver_status has arrived."""
        ready = status.state is DriverState.READY
        enabled_again = ready and self.enabled_ns not in (None, status.enabled_ns)
        since = now if self.error_since is None else self.error_since
        return replace(
            self,
            driver=self.driver.received(now),
            driver_status=status,
            error_since=since if status.state is DriverState.ERROR else None,
            enabled_ns=status.enabled_ns if ready else self.enabled_ns,
            enabled_again=now if enabled_again else self.enabled_again,
        )

    def report_received(self, now: float, name: str, level: Level, message: str) -> Inputs:
        """Record that diagnostics of a node have arrived. Nodes that `LOOP` does not contain are
        ignored."""
        if name not in LOOP:
            return self
        before = self.reports.get(name)
        since = now if before is None or before.level is not level else before.since
        return replace(self, reports={**self.reports, name: Report(now, level, message, since)})

    # Evaluation

    def timeout(self, period: float) -> float:
        """Return the timeout of inputs [s] for cycles of the length `period` [s]."""
        return max(self.parts.timeout_s, CYCLES * period) + SECOND_HAND_S

    def answer_overdue(self, now: float, period: float) -> bool:
        """Whether the wait for the solver's result has exceeded the timeout."""
        return self.unanswered is not None and now - self.unanswered > self.timeout(period)

    def driver_problem(self, now: float) -> str:
        """Return the reason why the state of the driver prevents the start of a task. The text is
        empty if a task can start."""
        finding = self.driver.timeout_finding(now)
        if finding is not None:
            return finding.message
        if self.driver_status is None:
            return f"no driver_status yet; {self.driver.advice}"
        return "" if self._is_driver_ready else self._driver_text

    @property
    def _driver_text(self) -> str:
        return "" if self.driver_status is None else f"driver: {self.driver_status.text}"

    @property
    def _is_driver_ready(self) -> bool:
        """Whether the cycles are executed by the motors."""
        return self.driver_status is not None and self.driver_status.state is DriverState.READY

    def parts_problem(self, now: float, publishers: Callable[[str], int]) -> str:
        """Return the reason why missing messages of the topic parts prevent the start of a task.
        The text is empty if a task can start."""
        if self.parts.arrival is None:
            return f"no parts yet; {self._missing_parts_cause(now, publishers)}"
        if self.parts.timeout_finding(now) is not None:
            return self._missing_parts_text(now, self.parts.age(now), publishers)
        return self._refusal_text

    def starts_problem(self, now: float) -> str:
        """Return the reason why missing reports of cycle starts prevent the start of a task. The
        text is empty if a task can start."""
        if self.starts is None:
            return ""
        finding = self.starts.timeout_finding(now)
        if finding is None and self.starts.arrival is not None:
            return ""
        if self.start_refusal:
            return f"the planner refuses the reports of cycle starts: {self.start_refusal}"
        return finding.message if finding else f"no start of a cycle yet; {self.starts.advice}"

    def problem(
        self, now: float, began: float, period: float, publishers: Callable[[str], int]
    ) -> Failure | None:
        """Return the reason why a running task cannot continue, or None if it can continue.

        Parameters
        ----------
        now : float
            Present time [s, steady clock].
        began : float
            Time at which the task started [s, steady clock]. Interruptions of inputs before this
            time are ignored.
        period : float
            Length of a cycle [s].
        publishers : callable
            Function that returns the number of publishers of a topic.
        """
        why = self._find_missing_input(now, began, period, publishers)
        # If the driver reports a failed connection, return this failure. The missing inputs are its
        # consequence.
        return self._driver_failure if why and self.error_since is not None else why

    @property
    def _refusal_text(self) -> str:
        if not self.refusal:
            return ""
        return f"the planner refuses the messages of the topic parts: {self.refusal}"

    @property
    def _driver_failure(self) -> Failure:
        return Failure(Reason.DRIVER_STOPPED, self._driver_text)

    def _find_missing_input(
        self, now: float, began: float, period: float, publishers: Callable[[str], int]
    ) -> Failure | None:
        timeout = self.timeout(period)
        age = min(self.driver.age(now), now - began)
        if age > self.driver.timeout_s:
            nobody = "" if publishers("driver_status") else "no node publishes it; "
            why = f"no driver_status for {age:.1f} s; {nobody}{self.driver.advice}"
            return Failure(Reason.NO_DRIVER, why)
        if self.error_since is not None:
            if now - max(self.error_since, began) > ERROR_TIMEOUT_S:
                return self._driver_failure
        elif not self._is_driver_ready:
            return self._driver_failure
        if self.enabled_again is not None and self.enabled_again > began:
            why = "driver: the motors were stopped and enabled again"
            return Failure(Reason.DRIVER_STOPPED, why)
        start_age = self.starts is not None and min(self.starts.age(now), now - began)
        if self.starts is not None and start_age > max(self.starts.timeout_s, CYCLES * period):
            # The missing cycle starts are the cause. Missing inputs from other nodes are a
            # consequence.
            return Failure(Reason.NO_CYCLE, self.starts_problem(now))
        age = min(self.parts.age(now), now - began)
        if self.unanswered is not None:  # in lockstep the simulator waits for the result
            age, advice = now - max(self.unanswered, began), "check that the solver runs"
            if age > timeout:
                why = self._silence_cause("plate_cycle", "solver", advice, now, publishers)
                return Failure(Reason.NO_CYCLE, f"no plate_cycle for {age:.1f} s; {why}")
        elif age > timeout:
            return Failure(Reason.NO_PARTS, self._missing_parts_text(now, age, publishers))
        refused = self.refused_since
        if refused is not None and now - max(refused, began) > ERROR_TIMEOUT_S:
            return Failure(Reason.NO_PARTS, self._refusal_text)
        seen = self.reports.get("detector")
        # An error of the detector means that its positions are wrong.
        wrong = seen is not None and seen.level is Level.ERROR
        if seen is not None and wrong and seen.at - max(seen.since, began) > ERROR_TIMEOUT_S:
            return Failure(Reason.CUT_OFF, f"detector: {seen.message}")
        name = self._find_node_without_input(now, began, period)
        if name:
            return Failure(Reason.CUT_OFF, f"{name}: {self.reports[name].message}")
        orders = self.orders
        if orders is None or orders.since < began:
            return None
        finding = orders.timeout_finding(now)
        return Failure(Reason.CUT_OFF, finding.message) if finding is not None else None

    def _find_node_without_input(self, now: float, began: float, period: float) -> str:
        """Return the first node of `LOOP` that reports missing input. The result is empty if there
        is no such node.

        Nodes that are later in the data flow lack input only as a consequence, so their reports are
        ignored. Reports of nodes after a node that timed out are ignored too.
        """
        fresh = max(FRESH_S, CYCLES * period)
        stale = {
            name
            for name, report in self.reports.items()
            if report.level is Level.STALE and report.at - began > self.parts.timeout_s
        }
        # if a device drives the simulator, the images come from the simulator, which may be the
        # cause
        if "detector" in stale:
            driven = "device" in self.reports and "simulator" in stale
            return "simulator" if driven else "detector"
        if self.parts.age(now) > fresh:
            return ""
        if "solver" in stale:
            return "solver"
        if self.unanswered is not None and now - self.unanswered > fresh:
            return ""
        if "driver" in stale:
            return "driver"
        if self.driver.age(now) > LIFE_S:
            return ""
        return next((name for name in ("device", "simulator") if name in stale), "")

    def findings(self, now: float, publishers: Callable[[str], int]) -> list[Finding | None]:
        """Return findings for the diagnostics about the inputs parts, driver and cycle starts. The
        finding is None if this input is not missing. The findings do not depend on whether a task
        runs."""
        parts = self.parts.timeout_finding(now)
        if parts is not None:
            parts = Finding(Level.STALE, self.parts_problem(now, publishers))
        driver = self.driver.timeout_finding(now)
        if driver is None and self.driver_problem(now):
            driver = Finding(Level.WARN, self.driver_problem(now))
        starts = None
        if self.starts is not None and driver is None:  # only a ready driver starts cycles
            starts = self.starts.timeout_finding(now)
            if starts is not None:
                starts = Finding(starts.level, self.starts_problem(now))
        return [parts, driver, starts]

    def stood_still(self, now: float, period: float) -> Failure | None:
        """Return a failure if the planner's process has stalled for longer than the input timeout.
        Otherwise return None.

        Messages that arrived during such a stall appear to be new afterwards, although the driver
        has stopped the plate.
        """
        stalled_s = now - self.ran
        if stalled_s <= self.timeout(period):
            return None
        return Failure(Reason.STOOD_STILL, f"the planner was stalled for {stalled_s:.1f} s")

    def ran_at(self, now: float) -> Inputs:
        """Return the inputs with `now` as the time at which the planner was last active."""
        return replace(self, ran=now)

    def woken(self, now: float) -> Inputs:
        """Return the inputs after a stall of the planner's process. Arrival times of earlier
        messages are discarded."""
        parts, driver = (
            replace(source, since=now, arrival=None if source.arrival is None else now)
            for source in (self.parts, self.driver)
        )
        starts = self.starts and replace(self.starts, since=now, arrival=None)
        return replace(
            self, parts=parts, driver=driver, ran=now, unanswered=None, reports={}, starts=starts
        )

    def _missing_parts_text(self, now: float, age: float, publishers: Callable[[str], int]) -> str:
        if self.repeated and self.stamp is not None and publishers("parts"):
            return (
                f"no new parts for {age:.1f} s: the messages have the same stamp, "
                f"{1e-9 * self.stamp:.3f} s, allowed: the time of each image"
            )
        return f"no parts for {age:.1f} s; {self._missing_parts_cause(now, publishers)}"

    def _missing_parts_cause(self, now: float, publishers: Callable[[str], int]) -> str:
        return self._silence_cause("parts", "detector", self.parts.advice, now, publishers)

    def _silence_cause(
        self, topic: str, node: str, advice: str, now: float, publishers: Callable[[str], int]
    ) -> str:
        """Return the reason why the node `node` does not publish the topic `topic`. If the reason
        is unknown, return `advice`."""
        if not publishers(topic):
            return f"no node publishes {topic}; check that the {node} runs"
        report = self.reports.get(node)
        if report is None:
            return advice
        if now - report.at > REPORT_TIMEOUT_S:
            return f"the {node} no longer publishes diagnostics; check that it runs"
        return f"the {node} runs and reports: {report.message}"
