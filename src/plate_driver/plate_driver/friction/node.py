"""The driver's services measure_friction and write_friction, and its topic friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core import Parts, PlateCycle, PlateError, load_rig
from plate_core.driver_status import DriverState, DriverStatus
from plate_core.rig import edit_rig, rig_path
from plate_core.ros import (
    CALLS,
    DATA,
    LATCHED,
    SafeLifecycleNode,
    msg_to_cycle,
    msg_to_parts,
    nanoseconds,
    to_time,
)
from plate_interfaces.msg import Friction, PartFriction
from plate_interfaces.msg import Parts as PartsMsg
from plate_interfaces.srv import MeasureFriction

from ..clocks import Clocks
from ..intake import CycleIntake
from ..playback import Playback
from ..transport_owner import TransportOwner
from ..transports import Latch
from .measurement import FrictionMeasurement, FrictionResult, Rest, rig_mu
from .push import Push

SETTLE_S = 0.4
"""Minimum time from the end of a push to the stamp of an image that is used [s]. The stamp of an
image may be later than its exposure by up to this time."""

LATE_S = 5.0
"""Maximum time from the expected end of a push until the transport reports the start of the push
[s]. The limit applies only if the transport reports cycle starts."""

SAME_S = 1e-6
"""The sent and the reported cycle count as the same cycle if their periods differ by at most this
value [s]."""

IMAGES = 4
"""Number of images per measurement of parts at rest."""

MAX_WAIT_S = 5.0
"""Maximum time to wait for images that show the parts at rest [s]."""

STILL_CALLS = 250
"""Maximum number of consecutive calls of `watch` during which the node's time does not change. 250
calls take 5 s of wall time. After more calls, the measurement fails. Simulated time stops if the
simulator is not active or has ended. In lockstep, simulated time always stops during a measurement,
because the simulator waits for a cycle. The driver refuses cycles during a measurement, and the
planner requests none before the first goal. The limit is a number of calls and not a wall time,
because this process may have been suspended."""


class FrictionServer:
    """Measurement of friction with the driver's transport, one push after the other.

    The driver calls `configure` when it is configured, `watch` every 20 ms while it is active, and
    `fail` when the motors are no longer ready.

    Parameters
    ----------
    driver : SafeLifecycleNode
        Node that owns the services, the topic and the subscriptions. The node's parameter
        `rig_file` names the file that `write_friction` changes.
    playback : Playback
    transports : TransportOwner
    intake : CycleIntake
    latch : Latch
    clocks : Clocks
    status : callable
        Function that returns the state of the motors.
    """

    def __init__(
        self,
        driver: SafeLifecycleNode[Any],
        playback: Playback,
        transports: TransportOwner,
        intake: CycleIntake,
        latch: Latch,
        clocks: Clocks,
        status: Callable[[], DriverStatus],
    ) -> None:
        self._driver, self._playback, self._transports = driver, playback, transports
        self._intake = intake
        self._latch = latch
        self._clocks = clocks
        self._status = status
        self._result: FrictionResult | None = None
        self._reset()

    def _reset(self) -> None:
        self._running = False
        self._measurement: FrictionMeasurement | None = None
        self._played: Push | None = None
        self._running_cycle: PlateCycle | None = None
        # Images with this stamp [ns] or a later stamp show parts at rest. None if this time is
        # unknown.
        self._after_ns: int | None = None
        self._images: list[Parts] = []
        self._since = 0.0  # start of the wait for parts at rest [s]
        # time of the last call of `watch` [s], and number of calls at this time
        self._now, self._still = -1.0, 0

    @property
    def running(self) -> bool:
        """Whether a measurement runs."""
        return self._running

    def configure(self) -> None:
        """Create the services, the topic and the subscriptions."""
        # Discard an earlier result, because it may belong to another rig.
        driver, self._result = self._driver, None
        self._publisher = driver.managed_publisher(Friction, "friction", LATCHED)
        driver.managed_subscription(PartsMsg, "parts", self._on_parts, DATA)
        self._starts_received = False
        driver.managed_subscription(JointTrajectory, "cycle_started", self._on_start, DATA)
        for kind, name, answer in (
            (MeasureFriction, "measure_friction", self._on_measure),
            (Trigger, "write_friction", self._on_write),
        ):
            service = driver.create_service(kind, name, answer, qos_profile=CALLS)
            driver.keep(driver.destroy_service, service)

    # Calls

    def _on_measure(
        self, request: MeasureFriction.Request, response: MeasureFriction.Response
    ) -> MeasureFriction.Response:
        response.success, status = False, self._status()
        if not request.start:
            response.success, response.message = True, "no measurement of friction was running"
            if self._running:
                self.fail("it was canceled")
                response.message = "canceled: the plate comes to rest after the current push"
        elif self._running:
            response.message = "a measurement already runs, allowed: one measurement at a time"
        elif status.state is not DriverState.READY:
            response.message = f"the driver is {status.text}, allowed: ready"
        elif self._intake.task_runs:
            response.message = "a task runs, allowed: no task; end it with stop"
        else:
            self._reset()
            self._result, self._stops = None, self._latch.number
            self._running, self._since = True, self._clocks.playback_s()
            self._started = self._after_ns = self._driver.get_clock().now().nanoseconds
            self._publish_status(Friction.RUNNING, "waiting for images of parts at rest", 0.0)
            response.success = True
            response.message = "started; the topic friction reports progress and result"
            response.started = to_time(self._started)
        return response

    def _on_write(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = False
        try:
            if self._result is None:
                raise PlateError("friction was not measured; call measure_friction first")
            path = rig_path(self._driver.options.rig_file)
            before, mu = load_rig(path), float(f"{rig_mu(self._playback.rig, self._result):.3g}")
            edit_rig(
                path, {("friction",): {"mu": f"{mu:g}"}},
                lambda rig: rig == replace(before, friction=replace(before.friction, mu=mu)),
            )  # fmt: skip
            response.success = True
            response.message = (
                f"written: {path}: mu {before.friction.mu:g} -> {mu:g}; nodes use it after their "
                "next configure"
            )
        except PlateError as error:
            response.message = str(error)
        return response

    # Work

    def _on_parts(self, msg: PartsMsg) -> None:
        """Store the parts of a new image if the image was taken after the end of the push.

        The time of an image is its stamp, because an image may arrive much later on a busy
        computer. In lockstep, the same image arrives several times.
        """
        after_ns, stamp_ns = self._after_ns, nanoseconds(msg.header.stamp)
        if self._running and after_ns is not None and stamp_ns >= after_ns:
            try:
                self._images.append(msg_to_parts(msg))
                self._after_ns = stamp_ns + 1
            except PlateError as error:
                self._driver.get_logger().warning(f"parts: {error}", throttle_duration_sec=2.0)

    def _on_start(self, msg: JointTrajectory) -> None:
        """Record the start of a push, which determines the end of the push."""
        self._starts_received = True
        push = self._running_cycle
        if push is None or self._after_ns is not None:
            return
        try:
            cycle = msg_to_cycle(msg)
        except PlateError:  # the planner logs a warning about this error
            return
        if cycle.moves and abs(cycle.period - push.period) < SAME_S:
            length_s = SETTLE_S + sum(part.period for part in push.parts)
            self._after_ns = nanoseconds(msg.header.stamp) + round(1e9 * length_s)

    def watch(self, now: float) -> None:
        """Continue the measurement at the time `now` on the playback clock [s]."""
        try:
            # The comparison of the stop numbers also detects a stop after which the motors were
            # enabled again.
            if self._latch.number != self._stops:
                raise PlateError("the motors were stopped")
            self._still = self._still + 1 if now == self._now else 0
            self._now = now
            if self._still > STILL_CALLS:
                raise PlateError(
                    "friction: simulated time has stopped, allowed: time that advances; check "
                    "that the simulator is active. In lockstep, friction cannot be measured"
                )
            if self._running_cycle is not None:
                guard = self._playback.guard
                over_s = now - guard.sent_at - guard.lasts_s
                if over_s > SETTLE_S and not self._starts_received:
                    self._after_ns = self._driver.get_clock().now().nanoseconds
                elif over_s > LATE_S and self._after_ns is None:
                    raise PlateError(f"friction: a push has not begun within {LATE_S:g} s")
                if over_s > SETTLE_S and self._after_ns is not None:
                    self._playback.rest(self._clocks.playback_s())
                    self._running_cycle, self._since = None, now
                return
            if len(self._images) >= IMAGES:
                rest = Rest.of(self._images[-IMAGES:])
                if rest is not None:
                    self._send_next_push(rest, now)
                    return
                self._images = self._images[-IMAGES + 1 :]
            if now - self._since > MAX_WAIT_S:
                seen = f"{len(self._images)} images" if self._images else "no message of parts"
                raise PlateError(
                    f"friction: {seen} within {MAX_WAIT_S:g} s, allowed: {IMAGES} images that show "
                    "all parts at rest; check that the detector runs, and that the clocks of the "
                    "camera and of this computer are synchronised"
                )
        except PlateError as error:
            self.fail(str(error))

    def _send_next_push(self, rest: Rest, now: float) -> None:
        """Evaluate the places of the parts, and send the next push."""
        self._images = []
        if self._measurement is None:
            corrected = self._playback.guard.correction is not None
            new = FrictionMeasurement.start(self._playback.rig, rest, corrected)
        else:
            new = self._measurement.after(rest, self._played)
        self._measurement, push = new, new.push
        if push is None:
            self._publish_result(new.result)
            return
        self._running_cycle, self._played, self._after_ns = push.cycle, None, None
        transport, stamp_ns = self._transports.current, self._clocks.stamp_ns()
        assert transport is not None
        factor = self._playback.send_push(transport, push.cycle, stamp_ns, now)
        if factor < 1:
            less = push.cycle.scaled(factor)
            self._played = replace(push, accel=push.accel * factor, cycle=less)
        self._publish_status(Friction.RUNNING, new.progress, new.fraction)

    def _publish_result(self, result: FrictionResult) -> None:
        self._result = result
        text = "; ".join((result.text, *result.notes))
        self._reset()
        self._driver.get_logger().info(text)
        parts = [
            PartFriction(
                id=part.id, x=float(part.position[0]), y=float(part.position[1]), mu=part.mu,
                mu_error=part.error, static_ratio=float(part.static_ratio),
            )
            for part in result.parts
        ]  # fmt: skip
        self._publish_status(
            Friction.DONE, text, 1.0, mu=result.mu, mu_error=result.error,
            between_parts=result.between_parts, over_plate=result.over_plate,
            static_ratio=float(result.static_ratio),
            static_ratio_error=float(result.static_error), parts=parts,
        )  # fmt: skip

    def fail(self, why: str) -> None:
        """End a measurement without a result."""
        if self._running:
            self._reset()
            self._driver.get_logger().error(f"measure_friction failed: {why}")
            self._publish_status(Friction.FAILED, why, 0.0)

    def _publish_status(self, state: int, text: str, fraction: float, **result: object) -> None:
        msg = Friction(state=state, text=text, fraction=float(fraction), **result)
        msg.header.stamp = to_time(self._started)
        msg.header.frame_id = "plate_home"
        self._publisher.publish(msg)
