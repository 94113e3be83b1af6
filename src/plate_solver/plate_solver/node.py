"""ROS node of the solver. For each request (part_forces), the node publishes the next plate cycle
(plate_cycle). `controller.Controller` computes the cycle before it must begin."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from plate_core import CycleRequest, PlateCycle, PlateError, load_rig
from plate_core.motion import IDLE_S, in_time, is_rest
from plate_core.rig import rig_warnings
from plate_core.ros import (
    DATA,
    NEWEST,
    WARN_S,
    NodeOptions,
    SafeLifecycleNode,
    centres_to_msg,
    cycle_to_msg,
    msg_to_request,
    nanoseconds,
    parameter,
    run_node,
)
from plate_core.status import INPUT_TIMEOUT_S, Finding, Input, Level, combined, used
from plate_interfaces.msg import PartForces

from .controller import METHODS, Controller, CycleResult
from .library import condition_number

RESTART_NS = 1_000_000_000
"""Threshold for the stamps of requests [ns]. If the stamp decreases by at least this time, the
camera or the simulator has restarted. If the stamp differs from this node's clock by at least this
time, the stamp is from another clock."""

MAX_S = 1.0
"""Maximum time for a search, in real time [s]. This maximum applies even if more time remains until
the cycle begins."""

LATER_S = 0.01
"""Increase of the publishing margin after a cycle that was not executed [s]. The publishing margin
is the time between the end of a search and the start of the cycle. The parameter `handover_s` is
the minimum of this margin."""

SOONER_S = 5e-4
"""Decrease of the publishing margin after a cycle that was executed [s]."""

LATEST_S = 0.06
"""Maximum publishing margin [s]. If the parameter `handover_s` is larger, the publishing margin
equals `handover_s`."""


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the solver."""

    method: str = parameter(
        "sinusoids",
        "Method: rotations (A) or sinusoids (B).",
        choices=tuple(METHODS),
        live=True,
    )
    seed: int = parameter(0, "Random seed of the solver's restarts.", 0, 2**31 - 1)
    restarts: int = parameter(
        0, "Maximum number of restarts of each search. 0 means the default of the method (40 for "
        "sinusoids). If the cycle may end in motion, half of this number is used.", 0, 1000,
    )  # fmt: skip
    threads: int = parameter(
        0, "Number of cores for a search. 0 means all cores. The results do not depend on it.",
        0, 1024,
    )  # fmt: skip
    handover_s: float = parameter(
        0.02, "Time by which a result must be ready before the start of the cycle [s]. The driver "
        "and the line need this time. Set 0.08 for a serial line. A search begins no restart that "
        "would end too late. After late results, the solver increases this time temporarily, up to "
        "0.06. 0 means no limit, as in simulated time; then a seed gives the same cycles on any "
        "computer.",
        0.0, 1.0,
    )  # fmt: skip
    input_timeout_s: float = parameter(
        INPUT_TIMEOUT_S,
        "Time without part_forces after which diagnostics are STALE [s, wall].",
        0.1,
        3600.0,
    )


@dataclass(frozen=True)
class Sent:
    """A published cycle. `stamp_ns` is the stamp of the request [ns], and `sent_ns` is the time of
    publication [ns]."""

    stamp_ns: int
    sent_ns: int
    cycle: PlateCycle


@dataclass
class Tally:
    """Statistics since the last report.

    - number of requests, and number of refused requests
    - reason of the last refusal, and reason of the last request without a solution
    - solving times [ms]
    - pairs of displacement error and requested displacement [m]
    """

    messages: int = 0
    refused: int = 0
    why: str = ""
    failed: str = ""
    solve_ms: list[float] = field(default_factory=list)
    errors: list[tuple[float, float]] = field(default_factory=list)


class SolverNode(SafeLifecycleNode[Options]):
    """Lifecycle node `solver`. The node computes the next plate cycle for each request.

    The node subscribes to part_forces. The node publishes plate_cycle (one per request), markers
    and diagnostics.
    """

    def __init__(self) -> None:
        super().__init__("solver", Options)
        self.report(self._find, self._values, reported=self._begin_report)

    def configure(self) -> None:
        """Load the rig, create the controller, and solve test requests."""
        options = self.options
        self._rig = rig = load_rig(options.rig_file)
        limit = rig.reach.limit
        self.get_logger().info(
            f"shaking ratio Gamma = {rig.gamma:.1f}, limited by {limit} in the rig file"
        )
        for warning in rig_warnings(rig, "motors", "limits"):
            self.get_logger().warning(warning.text)
        effort: dict[str, Any] = {"restarts": options.restarts} if options.restarts else {}
        threads = options.threads or len(os.sched_getaffinity(0))
        self._controller = Controller(rig, options.method, options.seed, threads=threads, **effort)
        self._controller.warm_up()
        self._cycles = self.managed_publisher(JointTrajectory, "plate_cycle", DATA)
        self._markers = self.managed_publisher(MarkerArray, "markers", DATA)
        self.managed_subscription(PartForces, "part_forces", self._on_forces, NEWEST)

    def begin(self) -> None:
        """Forget all earlier requests and cycles."""
        simulated = bool(self.get_parameter("use_sim_time").value)
        self._handover_s = 0.0 if simulated else self.options.handover_s
        self._controller.reset()
        self._sent: deque[Sent] = deque(maxlen=4)
        self._tally = Tally()
        self._count = {
            "answers": 0, "late_answers": 0, "refused_messages": 0, "no_solution": 0,
            "not_played": 0,
        }  # fmt: skip
        self._last: CycleResult | None = None
        self._parts: np.ndarray = np.empty((0, 2))
        timeout_s = self.options.input_timeout_s
        self._input = Input(
            "part_forces", "part_forces", "check that the planner runs", timeout_s, time.monotonic()
        )

    def retune(self) -> None:
        """Switch to the method in the parameters."""
        self._controller.method = METHODS[self.options.method]
        self.get_logger().info(f"method is now {self._controller.method}")

    def _on_forces(self, msg: PartForces) -> None:
        stamp_ns = nanoseconds(msg.header.stamp)
        self._input = self._input.received(time.monotonic())
        self._tally.messages += 1
        try:
            request = msg_to_request(msg)
        except PlateError as error:
            self._refuse(f"part_forces refused, no new cycle: {error}")
            return
        newest = self._sent[-1].stamp_ns if self._sent else None
        if newest is not None and stamp_ns < newest:
            if stamp_ns > newest - RESTART_NS:
                self._refuse("part_forces refused: its stamp is older than the last stamp")
                return
            self._sent.clear()
            self._controller.reset()
        # A request with the same stamp as the last request is answered with the same cycle again.
        # There is one exception: if the new request has no parts and the last cycle moves the
        # plate, the result is a cycle at rest. The planner sends such a request at the end of a
        # task. At this time, the driver may refuse a moving cycle. In lockstep, the simulator then
        # waits until the driver accepts a cycle for this image.
        repeated = newest == stamp_ns and (len(request.parts) > 0 or not self._sent[-1].cycle.moves)
        if second_publisher := self.second_publisher("part_forces"):
            cycle = self._rest(second_publisher)
        elif repeated:
            cycle = self._sent[-1].cycle
        else:
            cycle = self._solve(request, stamp_ns, nanoseconds(msg.start))
        self._send(cycle, msg.header.stamp)
        if not repeated:
            if newest == stamp_ns:
                self._sent.pop()
            self._sent.append(Sent(stamp_ns, self._now_ns(stamp_ns), cycle))

    def _send(self, cycle: PlateCycle, stamp: Time) -> None:
        """Publish a cycle. If the topic markers has a subscriber, also publish the markers of the
        cycle."""
        self._cycles.publish(cycle_to_msg(cycle, stamp))
        if self._markers.get_subscription_count():
            self._markers.publish(centres_to_msg(self._rig, cycle, stamp))

    def _refuse(self, text: str) -> None:
        self._count["refused_messages"] += 1
        self._tally.refused += 1
        self._tally.why = text
        self.get_logger().warning(text, throttle_duration_sec=WARN_S)

    def _solve(self, request: CycleRequest, stamp_ns: int, start_ns: int) -> PlateCycle:
        began, running = time.monotonic(), self._running(stamp_ns)
        self._adapt(request.plate)
        if not start_ns:
            start_ns = stamp_ns + round(1e9 * (running.period if running else IDLE_S))
        remaining_s = min(1e-9 * (start_ns - self._now_ns(stamp_ns)), MAX_S) - self._handover_s
        try:
            until = began + remaining_s if self._handover_s else math.inf
            result = self._controller.solve(request, running, until)
        except (PlateError, np.linalg.LinAlgError) as error:
            return self._rest(str(error))
        took = time.monotonic() - began
        self._count["answers"] += 1
        self._last, self._parts = result, request.parts.position
        if result.solution is not None:
            self._tally.solve_ms.append(1e3 * took)
            self._tally.errors.append((result.error_m, result.requested_m))
        return result.cycle

    def _adapt(self, plate: np.ndarray | None) -> None:
        """Increase the publishing margin if the last cycle was not executed, otherwise decrease it.
        A cycle was not executed if its final state differs from the plate state (3, 3) in the
        request."""
        if self._handover_s and plate is not None and self._sent:
            missed = not is_rest(self._sent[-1].cycle.state(-1) - plate)
            self._count["not_played"] += missed
            min_s = self.options.handover_s
            wished = self._handover_s + (LATER_S if missed else -SOONER_S)
            self._handover_s = max(min(wished, LATEST_S), min_s)

    def _rest(self, why: str) -> PlateCycle:
        """Count a request without a solution, and return a cycle at rest."""
        self._tally.failed = why
        self._count["no_solution"] += 1
        self.get_logger().error(f"no solution, plate rests: {why}", throttle_duration_sec=WARN_S)
        return PlateCycle.rest(IDLE_S)

    def _running(self, stamp_ns: int) -> PlateCycle | None:
        """Return the cycle that began when the image was taken: the last cycle that was published
        early enough. None if there is no such cycle."""
        for number, sent in enumerate(reversed(self._sent)):
            if in_time(1e-9 * sent.sent_ns, 1e-9 * stamp_ns):
                self._count["late_answers"] += number > 0
                return sent.cycle
        return None

    def _now_ns(self, stamp_ns: int) -> int:
        """Return this node's time [ns]. If the stamp is from another clock, return the stamp
        instead."""
        now_ns = self.get_clock().now().nanoseconds
        return now_ns if abs(now_ns - stamp_ns) < RESTART_NS else stamp_ns

    def _plate_condition(self) -> float:
        """Return the condition number of the forces that the plate can exert on the parts of the
        last request. The result is 0 if the request has no parts."""
        return condition_number(self._rig, self._parts) if len(self._parts) else 0.0

    def _find(self, now: float) -> Finding:
        """Return the diagnostics of the received requests and of the solutions, in the form of
        `plate_core.status`."""
        tally = self._tally
        findings = [
            used("part_forces", tally.messages, tally.refused, tally.why),
            self._input.timeout_finding(now),
        ]  # fmt: skip
        if tally.failed:
            findings.append(Finding(Level.ERROR, f"no solution, plate rests: {tally.failed}"))
        return combined(findings, self._last.message if self._last else "waiting for part_forces")

    def _values(self) -> Mapping[str, object]:
        errors, solve_ms = self._tally.errors, self._tally.solve_ms
        requested = sum(pair[1] ** 2 for pair in errors) ** 0.5
        missed = sum(pair[0] ** 2 for pair in errors) ** 0.5
        solution = self._last.solution if self._last else None
        return {
            "method": self._controller.method,
            "parts": len(self._parts),
            "missed_fraction": f"{missed / requested:.4f}" if requested > 0 else "0",
            "solve_ms_median": f"{np.median(solve_ms):.2f}" if solve_ms else "0",
            "solve_ms_max": f"{max(solve_ms):.2f}" if solve_ms else "0",
            "condition": f"{solution.condition:.4g}" if solution else "0",
            "fraction": f"{self._last.fraction:g}" if self._last else "0",
            "plate_condition": f"{self._plate_condition():.4g}",
            "iterations": solution.iterations if solution else 0,
            "silent_s": f"{self._input.age(time.monotonic()):.2f}",
            "cut_short": self._controller.cut_short,
            "handover_ms": f"{1e3 * self._handover_s:.1f}",
            **self._count,
        }

    def _begin_report(self) -> None:
        self._tally = Tally()


def main() -> None:
    """Run the solver."""
    run_node(SolverNode, Options)
