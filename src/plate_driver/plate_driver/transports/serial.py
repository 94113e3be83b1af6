"""Transport to a motor controller on a serial port (docs/protocol.md). The inputs are motor tables
and the orders stop, enable and home. The outputs are sensor values and the reported state. A table
is uploaded as a whole, or sent as a stream of setpoints. If the link fails, the port is
reopened."""

from __future__ import annotations

import errno
import os
import termios
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
import serial

from plate_core import CycleError, FrameError, PlateError
from plate_core.driver_status import DriverReason
from plate_core.files import kind_of
from plate_core.rig import CameraTrigger, Limits
from plate_core.serial_protocol import (
    TICK_S,
    Capabilities,
    Enable,
    Fault,
    Home,
    Knot,
    Packet,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    Trigger,
    frame,
    pack,
    parse,
)

from ..setpoints import MAX_KNOTS, MAX_S, MotorTable, SetpointStream, densest, knots, plays
from .line import upload_s
from .link import Link
from .transport import (
    CALL_AGAIN,
    STOPPED_SINCE,
    UNCONNECTED,
    Condition,
    Measured,
    Order,
    Report,
    TransportContext,
)

BAUD = 921_600

PIECES = 64
"""Number of pieces of a typical table. The driver checks whether the line is fast enough for a
table of this size."""

REOPEN_S = (0.1, 0.2, 0.4, 0.8)
"""Delays between attempts to reopen the port [s]. The last delay is repeated."""

SENT_KEPT = 8
"""Number of sent tables that are stored, because the device may still play them or keep them
waiting."""

NEAR = ((1e-6,), (1e-3,), (0.1,))
"""Maximum rounding errors of travel [m], speed [m/s] and acceleration [m/s2] in a state."""

LEAD_S = 0.3
"""Time by which setpoints of a stream are sent before the device plays them [s]. The device brakes
if its setpoints end in less than 0.1 s."""

TIMEOUT_S = 0.5
"""Maximum time without a message, in addition to a round trip [s]. After a longer time, the device
is reported as not answering."""

STOP_ANSWER_S = 0.5
"""Maximum time until the device answers a stop, in addition to four round trips [s]."""

HOME_ANSWER_S = 1.0
"""Maximum time until the device answers a home command, in addition to four round trips [s]."""

READY_S = 8.0
"""Maximum time from an enable command until the motors are ready, in addition to four round trips
[s]. The value consists of 5 s for the search for home, 0.5 s for the motion to home, and a
margin."""

ROUNDING = 1e-5
"""Relative difference up to which a limit of the device counts as equal to the rig's limit. The
device sends its limits in single precision."""

READ_BYTES = 65_536
"""Maximum number of bytes per read. The device sends fewer bytes in half a second at 921,600
baud."""

UNANSWERED = "the device does not answer"
NO_ANSWER = Report(Condition.GONE, DriverReason.NO_ANSWER, UNANSWERED)
CONNECTING = Report(
    Condition.GONE,
    DriverReason.NO_ANSWER,
    "the device has not reported its state yet: waiting for it",
)
"""Report before the first telemetry. A board that starts when its port is opened can need some
seconds."""

CONDITIONS = {
    State.OFF: Condition.OFF,
    State.HOMING: Condition.ENABLING,
    State.READY: Condition.READY,
    State.PLAYING: Condition.READY,
    State.BRAKING: Condition.BRAKING,
}

REASONS = {
    Fault.HARDWARE: DriverReason.HARDWARE,
    Fault.SUPPLY: DriverReason.SUPPLY,
    Fault.FOLLOWING: DriverReason.FOLLOWING,
    Fault.HEAT: DriverReason.HEAT,
    Fault.LIMIT: DriverReason.LIMIT,
    Fault.HOST_SILENT: DriverReason.HOST_SILENT,
    Fault.STOPPED: DriverReason.EARLIER_STOP,
}
"""Reason of each fault. If there are several faults, the first fault in this order determines the
reason. An unknown home position is not in the list, because the next enable searches for it and no
person must check the rig."""

OF_DRIVES = Fault.HARDWARE | Fault.SUPPLY | Fault.FOLLOWING
"""Faults for which the report of a drive contains more details."""

REFUSED = {
    Status.WRONG_STOP: f"wrong stop: {STOPPED_SINCE}",
    Status.WRONG_STATE: "wrong state: the device brakes, or has a fault that persists",
}
"""Texts for refused enable and home commands, by the device's answer."""


A_PORT = "allowed: the device of a serial port, such as /dev/ttyACM0"

PORT_ERRORS = {
    errno.ENOENT: "is not there",
    errno.EACCES: "is not accessible; check that this user is in the group dialout",
    errno.EWOULDBLOCK: "is used by another program",
    errno.EBUSY: "is used by another program",
    errno.ENOTTY: f"is a device, but no serial port, {A_PORT}",
}
"""Texts for known errors when a port is opened, by error number."""


class Port(Protocol):
    """Subset of `serial.Serial` that the transport uses. `read` and `write` return immediately."""

    def read(self, size: int) -> bytes: ...

    def write(self, data: bytes) -> int | None: ...

    def close(self) -> None: ...


class _Serial(serial.Serial):
    """Port with a `write` that returns immediately. The `write` of pyserial waits or polls in a
    loop."""

    def write(self, data: bytes) -> int:
        """Write as many bytes as the buffer accepts, and return their number."""
        try:
            return os.write(self.fileno(), data)
        except BlockingIOError:
            return 0


def open_port(name: str, baud: int = BAUD) -> Port:
    """Open a serial port with exclusive access.

    Raises
    ------
    PlateError
        If the port does not exist or cannot be used. The message gives the reason.
    """
    kind = kind_of(name)
    if kind not in ("a device", ""):
        raise PlateError(f"serial port {name} is {kind}, {A_PORT}")
    try:
        port: Port = _Serial(name, baud, timeout=0, exclusive=True)
    except (OSError, ValueError, termios.error) as error:  # SerialException is an OSError
        number = getattr(error, "errno", None) or getattr(error.__context__, "args", (0,))[0]
        why = PORT_ERRORS.get(number) or f"does not open at {baud} baud ({error})"
        raise PlateError(f"serial port {name} {why}") from None
    return port


def check_line(baud: int, longest_upload_s: float) -> None:
    """Raise an error if the upload of a cycle takes too long on a line with this speed."""
    seconds = upload_s(PIECES, baud)
    if seconds > longest_upload_s:
        raise PlateError(
            f"baud is {baud}, so the upload of a cycle with {PIECES} pieces takes {seconds:.2f} s, "
            f"allowed: at most {longest_upload_s:g} s (longest_upload_s)"
        )


def make_serial(context: TransportContext) -> SerialTransport:
    """Return the transport to a motor controller on a serial port."""
    values = context.parameters
    port, baud = str(values["port"]), int(values["baud"])
    check_line(baud, float(values["longest_upload_s"]))
    return SerialTransport(
        lambda: open_port(port, baud), context.clock, context.seed, bool(values["streams"]), baud,
        context.rig.limits, trigger_message(context.rig.camera.trigger),
    )  # fmt: skip


def trigger_message(trigger: CameraTrigger | None) -> Trigger | None:
    """Return the message that sets the camera's trigger, or None if there is no trigger."""
    if trigger is None:
        return None
    return Trigger(int(trigger.phase * 2**16), round(trigger.pulse_s * 1e3))


class SerialTransport:
    """Transport to a motor controller with the protocol of docs/protocol.md.

    The transport never enables the motors without a call of `enable`. This is also true after a
    restart of the link, a reset of the device, or a time without messages to the device.

    Parameters
    ----------
    make_port : callable
        Function that opens the port. The function is called again after a failure.
    clock : callable
        Function that returns a time that never decreases [s].
    seed : int
        First session number. The number must differ between runs.
    streams : bool
        Whether cycles are sent as a stream of setpoints. If False, each cycle is uploaded as a
        whole.
    baud : float
        Speed of the line [bit/s].
    limits : Limits, optional
        Limits of the rig. The transport does not enable a device with different limits.
    trigger : Trigger, optional
        Message that sets when the device triggers the camera. Default: never.
    """

    motors = True

    def __init__(
        self,
        make_port: Callable[[], Port],
        clock: Callable[[], float],
        seed: int,
        streams: bool = False,
        baud: float = BAUD,
        limits: Limits | None = None,
        trigger: Trigger | None = None,
    ) -> None:
        self._limits, self._trigger = limits, trigger
        self._unfit: Report | None = None
        self._boot: int | None = None
        self._reset = False  # whether the device was reset after the last enable
        # Problem of the device's clock that caused a stop of the motors. The next enable clears
        # this text.
        self._clock_fault = ""
        self._closed = False
        self._streams, self._baud = streams, baud
        self._streamed: SetpointStream | None = None
        # start time of the stream on the device's clock [s]
        self._stream_start: float | None = None
        # Stream that begins when the current stream has ended.
        self._next: SetpointStream | None = None
        self.min_lead_s = float("inf")
        self._make_port, self._clock, self._session = make_port, clock, seed
        self._port: Port | None = None
        self._reader = Reader()
        self._link = Link.connecting(self._session, clock(), baud, trigger)
        self._stops: list[Order] = []
        self._request: Order | None = None  # pending enable or home command
        self._cut = False
        self._table = 0
        self._sent: dict[int, MotorTable] = {}
        self._failures = 0
        self._reopen_at = 0.0
        self._no_contact = CONNECTING
        self._troubles: list[str] = []
        self._stop_noted = -1
        self._following_m = self._load = 0.0
        self.refused = 0
        self.retries = 0

    @property
    def sent(self) -> Mapping[int, MotorTable]:
        """Last sent tables by their numbers in the protocol."""
        return self._sent

    @property
    def calibrates(self) -> bool:
        """Whether this transport can be used for a calibration. A calibration requires a device
        that receives whole cycles instead of a stream of setpoints."""
        return not self._streams

    @property
    def max_knots(self) -> int:
        """Maximum number of knots that the device accepts."""
        device = self._link.device
        return MAX_KNOTS if device is None or self._streams else min(device.max_knots, MAX_KNOTS)

    @property
    def hold_s(self) -> float:
        """Maximum time for which the device repeats a table [s]."""
        device = self._link.device
        return float("inf") if device is None else device.hold_ms * 1e-3

    def open(self) -> None:
        """Open the port and send the message Hello. If the port does not open, later calls of
        `poll` try again."""
        self._closed = False
        self._reopen(self._clock())
        self.poll()

    def send(self, table: MotorTable, repeats: int) -> None:
        """Upload or stream a motor table. The device plays the table when its current cycle has
        ended.

        Raises
        ------
        CycleError
            If the device is not ready, or it cannot store all knots of the table.
        """
        report = self.report()
        if report.condition is not Condition.READY:
            reason = f" ({report.text})" if report.text else ""
            raise CycleError(f"the device is {report.condition.value}{reason}, allowed: ready")
        repeats = plays(repeats, self.hold_s, table.cycle.period)
        if not self._streams:
            sent, splice_ticks, follows = message_content(table, self._sent)
            if len(sent) > self.max_knots:
                raise CycleError(
                    f"plate_cycle: {len(sent)} knots, allowed by the device: {self.max_knots}"
                )
            self._table = self._table % 65_535 + 1
            self._sent[self._table] = table
            self._sent = dict(list(self._sent.items())[-SENT_KEPT:])
            self._link = self._link.uploading(self._table, sent, repeats, splice_ticks, follows)
            self.poll()
            return
        self._check_density(table, repeats)
        if self._streamed is not None and not self._streamed.ended:
            self._streamed = self._streamed.followed_by(table, repeats)
        else:
            self._next = SetpointStream.of(table, repeats)
        self.poll()

    def _check_density(self, table: MotorTable, repeats: int) -> None:
        """Refuse a table if the device cannot store all setpoints of a stream that are sent ahead.

        A stream begins only when its first setpoints are stored.
        """
        device = self._link.device
        capacity = MAX_KNOTS if device is None else device.max_knots
        ahead = densest(table, repeats, LEAD_S + MAX_S)
        if ahead > capacity:
            raise CycleError(
                f"plate_cycle: {ahead} setpoints within {LEAD_S + MAX_S:g} s, allowed by the "
                f"device: {capacity}"
            )

    def poll(self) -> list[Measured]:
        """Read messages, send due packets, and return the new measurements. Call this method every
        few milliseconds."""
        if self._port is None:
            self._reopen(self._clock())
            return []
        measured: list[Measured] = []
        now = self._clock()
        self.min_lead_s = min(self.min_lead_s, self._stream_lead_s(now))
        try:
            data = self._port.read(READ_BYTES)
            now = self._clock()  # time after the arrival of all bytes of `data`
            reader, packets = self._reader.fed(data)
            self.refused += reader.refused - self._reader.refused
            self._reader = reader
            for data in packets:
                telemetry = self._process_received(data, now)
                if telemetry is not None:
                    when = self._link.clock.host_time(telemetry.device_us)
                    measured.append(self._to_measured(telemetry, min(when, now), now))
            self._check_clock(now)
            self._complete_orders()
            self._feed_stream(now)
            link, due = self._link.due(now)
            self.retries += link.retries - self._link.retries
            self._link = link
            if due:
                self._write(self._port, due)
        except OSError as error:
            self._disconnect(
                Report(Condition.GONE, DriverReason.PORT, f"serial port: {error}"), now
            )
            return measured
        if self._link.failed:
            self._disconnect(self._link.failed, now)
        elif self._link.refusal:
            self._record_trouble(self._link.refusal)
            self._link = self._link.without_refusal()
            # End the stream, because the device would brake at a gap in the setpoints.
            self._streamed = None
        return measured

    def report(self) -> Report:
        """Return the state of the motors as the device reports it."""
        telemetry, now = self._link.telemetry, self._clock()
        if self._port is None or self._link.device is None or telemetry is None:
            return self._no_contact
        timeout_s = TIMEOUT_S + self._link.line.round_s
        if now - self._link.received_at > timeout_s:
            return NO_ANSWER
        if now - self._link.telemetry_at > max(timeout_s, self._link.line.telemetry_timeout_s):
            why = "the device does not report its state"
            return Report(Condition.GONE, DriverReason.NO_TELEMETRY, why)
        if self._unfit:
            return self._unfit
        condition = CONDITIONS[telemetry.state]
        if self._clock_fault:
            halting = condition in (Condition.OFF, Condition.BRAKING)
            # If the device does not brake yet, the stop has not reached it.
            condition = condition if halting else Condition.GONE
            return Report(condition, DriverReason.DEVICE_CLOCK, self._clock_fault)
        if telemetry.state is State.OFF and self._reset:
            return Report(condition, DriverReason.DEVICE_RESET, "the device was reset")
        if telemetry.state not in (State.OFF, State.BRAKING):
            return Report(condition)
        reasons = (reason for fault, reason in REASONS.items() if fault & telemetry.faults)
        text = fault_names(telemetry.faults & ~Fault.NO_HOME)
        if self._link.trouble is not None and telemetry.faults & OF_DRIVES:
            text += f": {self._link.trouble.text}"
        return Report(condition, next(reasons, DriverReason.NONE), text)

    @property
    def busy(self) -> bool:
        """Whether a command still waits to be sent or to be answered."""
        return self._link.busy

    @property
    def load(self) -> float:
        """Maximum computing time of a device tick since the last `values`, as a fraction of its
        period."""
        return self._load

    def troubles(self) -> list[str]:
        """Return the problems that occurred since the last call of this method."""
        troubles, self._troubles = self._troubles, []
        return troubles

    def values(self) -> dict[str, str]:
        """Return values for the diagnostics, by name. Maxima and minima are those since the last
        call of this method."""
        link, lead, self.min_lead_s = self._link, self.min_lead_s, float("inf")
        values = {
            "retries": str(self.retries),
            "frames_refused": str(self.refused),
            "heartbeats_answered": f"{link.line.answered:.2f}",
        }
        if link.line.trip_s is not None:
            values["round_trip_ms"] = f"{1e3 * link.line.trip_s:.1f}"
        if link.telemetry is not None:
            values |= {
                "device_state": link.telemetry.state.name.lower(),
                "faults": fault_names(link.telemetry.faults) or "none",
                "stop": str(link.telemetry.stop),
                "following_error_mm": f"{1e3 * self._following_m:.3f}",
                "following_watched": "yes" if link.device and link.device.following_m else "no",
                "device_thermal_load": f"{link.telemetry.heat:.4f}",
                "device_load": f"{self._load:.3f}",
            }
            self._following_m, self._load = link.telemetry.following_m, link.telemetry.load
        if np.isfinite(lead):
            values["least_lead_ms"] = f"{1e3 * lead:.1f}"
        return values

    # Orders of a person

    def stop(self, cut: bool = False) -> Order:
        """Make the device brake. If `cut` is True, the device switches off the motor current
        immediately instead. All other pending commands are dropped."""
        self._streamed = self._next = None
        self._complete_request(STOPPED_SINCE)
        order = self._make_order(STOP_ANSWER_S)
        if self._closed:
            return order.complete(UNANSWERED)
        self._cut = cut or (self._cut and bool(self._stops))
        self._stops.append(order)
        self._link = self._link.stopping(self._cut)
        self.poll()
        return order

    def enable(self) -> Order:
        """Request that the device enables the motors once. The request contains the stop number
        that the device reports now."""
        telemetry = self._link.telemetry
        order = self._make_order(READY_S)
        if self._unfit:
            return order.complete(self._unfit.text)
        report = self.report()
        if report.condition is Condition.GONE or telemetry is None:
            hint = CALL_AGAIN if report.reason in UNCONNECTED else ""
            return order.complete(report.text + hint)
        # Refuse the enable command, because it is unknown which stop it would end.
        if self._stops or self._link.fresh_telemetry is None:
            return order.complete(
                "the device has not reported the last stop yet; call enable again"
            )
        if self._request is not None:
            return order.complete("the device has not answered the last enable or home yet")
        if self._is_clock_broken(self._clock()):
            return order.complete(self._link.clock.problem)
        self._clock_fault = ""
        self._request, self._link = order, self._link.enabling(telemetry.stop)
        self.poll()
        return order

    def home(self) -> Order:
        """Request that the motors search for home again. The device refuses this request unless its
        motors are off."""
        order = self._make_order(HOME_ANSWER_S)
        if self.report().condition is Condition.GONE:
            return order.complete(self.report().text)
        if self._stops or self._request is not None:
            return order.complete("a stop, an enable or a home is not answered yet")
        self._request, self._link = order, self._link.homing()
        self.poll()
        return order

    def close(self) -> None:
        """Make the device brake unless its motors are off, and release the port."""
        telemetry = self._link.telemetry
        off = telemetry is not None and telemetry.state is State.OFF
        if self._port is not None and not self._stops and not off:
            self.stop()
        self._streamed = self._next = None
        self._closed = True
        self._close_port()

    def _make_order(self, max_s: float) -> Order:
        return Order(max_s + 4 * self._link.line.round_s)

    def _complete_orders(self) -> None:
        """Complete the orders that the device has answered, with or without an error."""
        answer = self._link.answer
        if answer is None or answer.status is None:
            return
        failure = "" if answer.status is Status.DONE else _refusal_text(answer.status)
        if isinstance(answer.message, Stop):
            for order in self._stops:
                order.complete(failure)
            self._stops, self._cut = [], False
        elif self._request is None:
            return
        elif failure or isinstance(answer.message, Home):
            self._complete_request(failure)
        elif isinstance(answer.message, Enable) and self._link.fresh_telemetry is not None:
            state = self._link.fresh_telemetry.state
            if state in (State.READY, State.PLAYING):
                self._reset = False
                self._complete_request()
            elif state is not State.HOMING:
                reason = fault_names(self._link.fresh_telemetry.faults)
                self._complete_request(f"the device has stopped again: {reason}")

    def _complete_request(self, failure: str = "") -> None:
        """Complete the pending enable or home order, if any. An empty `failure` means success."""
        request, self._request = self._request, None
        if request is not None:
            request.complete(failure)

    # The line

    def _write(self, port: Port, due: list[Packet]) -> None:
        # Noise on the line may look like the start of a frame. The zero byte ends this partial
        # frame.
        data = b"\0" + b"".join(frame(pack(packet)) for packet in due)
        if port.write(data) != len(data):
            self._record_trouble("the serial line is full, so messages were lost and are repeated")

    def _record_trouble(self, trouble: str) -> None:
        if trouble not in self._troubles:
            self._troubles.append(trouble)

    def _process_received(self, data: bytes, now: float) -> Telemetry | None:
        try:
            packet = parse(data)
        except FrameError:
            self.refused += 1
            return None
        before, suspect = self._link.device, self._link.clock.suspect(now)
        self._link = self._link.received(packet, now)
        if self._link.clock.suspect(now) and not suspect:
            self._record_trouble(self._link.clock.problem)
        if before is None and self._link.device is not None:
            self._failures, self._no_contact = 0, CONNECTING
            self._process_greeting(self._link.device)
        message = packet.message
        if not isinstance(message, Telemetry):
            return None
        self._following_m = max(self._following_m, message.following_m)
        self._load = max(self._load, message.load)
        if message.faults & ~(Fault.STOPPED | Fault.NO_HOME) and message.stop != self._stop_noted:
            self._stop_noted = message.stop
            self._record_trouble(
                f"device has stopped: {fault_names(message.faults)}"
                f"{self._following_error_text(message)}"
            )
        if message.state not in (State.READY, State.PLAYING):
            self._streamed = self._next = None
        # The host time of the telemetry is unknown before the first pulse.
        return message if self._link.clock.known else None

    def _process_greeting(self, device: Capabilities) -> None:
        """Process the device's reply to Hello. Check whether the device was reset, and whether its
        limits equal those of this rig."""
        self._reset = self._reset or self._boot not in (None, device.boot)
        self._boot = device.boot
        why = "" if self._limits is None else limit_differences(device, self._limits)
        self._unfit = Report(Condition.GONE, DriverReason.WRONG_DEVICE, why) if why else None
        if why:
            self._record_trouble(why)

    def _is_clock_broken(self, now: float) -> bool:
        return self._link.clock.broken(now, self._link.line.round_s)

    def _check_clock(self, now: float) -> None:
        """Stop a device with a broken clock, because its motions may exceed the limits."""
        telemetry = self._link.fresh_telemetry
        if telemetry is None or telemetry.state in (State.OFF, State.BRAKING):
            return
        if self._stops or not self._is_clock_broken(now):
            return
        self._clock_fault = self._link.clock.problem
        self._streamed = self._next = None
        self._complete_request(self._clock_fault)
        self._link = self._link.stopping()

    def _to_measured(self, telemetry: Telemetry, time: float, now: float) -> Measured:
        """Convert telemetry to a measurement at the host time `time` [s]. While the device brakes,
        the field `playing` of the measurement is None."""
        braking = telemetry.state is State.BRAKING
        playing = None if braking else self._sent.get(telemetry.table)
        ticks = telemetry.ticks
        if playing is not None and (tail := playing.tail) is not None:
            splice_ticks = round(playing.cycle.period / TICK_S)
            if ticks >= splice_ticks:
                playing, ticks = tail, ticks - splice_ticks
        return Measured(
            time, telemetry.device_us * 1e-6, telemetry.table,
            telemetry.position, telemetry.acceleration, playing,
            time - ticks * TICK_S, self._link.clock.rejection(now),
        )  # fmt: skip

    def _following_error_text(self, telemetry: Telemetry) -> str:
        device = self._link.device
        if not telemetry.faults & Fault.FOLLOWING or device is None:
            return ""
        error, allowed = 1e3 * self._following_m, 1e3 * device.following_m
        return f" (a motor was {error:.2g} mm from its setpoint, allowed: {allowed:.2g})"

    def _stream_lead_s(self, now: float) -> float:
        """Return the time by which the stream is ahead of the device [s].

        The result is infinite if no stream plays or if the whole stream was sent.
        """
        if self._streamed is None or self._stream_start is None or self._streamed.ended:
            return float("inf")
        return self._streamed.time - (now - self._link.clock.offset_s - self._stream_start)

    def _feed_stream(self, now: float) -> None:
        """Send setpoints so that the stream stays `LEAD_S` ahead of the device, or start the next
        stream."""
        stream, telemetry = self._streamed, self._link.fresh_telemetry
        if telemetry is None:
            return
        ready = telemetry.state is State.READY
        if stream is not None and stream.ended and ready and not self.busy:
            stream = self._streamed = None
        if stream is None:
            if self._next is not None and ready:
                self._table = self._table % 65_535 + 1
                self._streamed, first = self._next.until(LEAD_S)
                self._next = None
                self._stream_start = None
                self._link = self._link.streaming(self._table, first)
            return
        if telemetry.table != self._table or not self._link.clock.known:
            return  # the stream does not play yet, or the offset of the device's clock is unknown
        if self._stream_start is None:
            self._stream_start = telemetry.device_us * 1e-6
        if stream.ended:
            return
        self._streamed, more = stream.until(stream.time - self._stream_lead_s(now) + LEAD_S)
        if more:
            self._link = self._link.adding(self._table, stream.sent, more)

    def _connect(self, port: Port) -> None:
        self._port, self._reader = port, Reader()
        self._session = (self._session + 1) % 2**32
        self._link = Link.connecting(self._session, self._clock(), self._baud, self._trigger)
        if self._stops:  # send stops again that the device has not acknowledged
            self._link = self._link.stopping(self._cut)

    def _reopen(self, now: float) -> None:
        if now < self._reopen_at:
            return
        try:
            self._connect(self._make_port())
        except PlateError as error:
            why = f"{error}: waiting for it"
            self._disconnect(Report(Condition.GONE, DriverReason.PORT, why), now)

    def _disconnect(self, why: Report, now: float) -> None:
        if why != self._no_contact:  # record each reason only once
            self._record_trouble(why.text)
        self._no_contact = why
        self._streamed = self._next = None
        self._complete_request(why.text)
        self._close_port()
        self._reopen_at = now + REOPEN_S[min(self._failures, len(REOPEN_S) - 1)]
        self._failures += 1

    def _close_port(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except OSError as error:
                self._record_trouble(f"serial port: {error}")


def message_content(
    table: MotorTable, before: Mapping[int, MotorTable]
) -> tuple[tuple[Knot, ...], int, int]:
    """Return the content of a table's messages: its knots, its splice time, and the table that it
    continues.

    The splice time [TICK_S] is 0 if the table has no tail. The third value is the number of the
    table that this table continues in motion. This number is 0 if this table begins at rest.

    If the first knot equals the splice knot of a table in `before` up to rounding, it is replaced
    by the splice knot, so that both are bitwise equal. If there are several such tables, the latest
    table is used.
    """
    first, *rest = knots(table)
    follows = 0
    state = np.array([first.position, first.velocity, first.acceleration])
    for number, other in reversed(list(before.items())):
        end = len(other.cycle.times) - 1
        splice = np.array([other.q[end], other.qd[end], other.qdd[end]], np.float32)
        if other.cycle.tail is not None and np.all(np.abs(splice - state) <= NEAR):
            q, qd, qdd = (tuple(row) for row in splice.tolist())
            first, follows = Knot(first.ticks, q, qd, qdd), number
            break
    if table.cycle.tail is None:
        return (first, *rest), 0, follows
    # The tail's first knot is omitted, because it is equal to the cycle's last knot.
    end = len(table.cycle.times) - 1
    return (first, *rest[:end], *rest[end + 1 :]), rest[end].ticks, follows


def fault_names(faults: Fault) -> str:
    """Return the names of faults."""
    return ", ".join(fault.name.lower().replace("_", " ") for fault in faults if fault.name)


def limit_differences(device: Capabilities, limits: Limits) -> str:
    """Return a text about the limits of the device that differ from the rig file. Return "" if all
    limits are equal."""
    pairs = {
        "stroke [m]": (device.stroke_m, limits.stroke_m),
        "speed [m/s]": (device.speed, limits.speed),
        "accel [m/s2]": (device.accel, limits.accel),
        "force [N]": (device.force, limits.force),
        "continuous force [N]": (device.continuous_force, limits.continuous_force),
        "following error [m]": (device.following_m, limits.following_error_m),
    }
    wrong = [
        f"{name} {reported:.4g}, rig file {rig:.4g}"
        for name, (reported, rig) in pairs.items()
        if abs(reported - rig) > ROUNDING * abs(rig)
    ]
    return f"the device's limits differ from the rig's: {', '.join(wrong)}" if wrong else ""


def _refusal_text(status: Status) -> str:
    return REFUSED.get(status, f"the device answers: {status.name.lower().replace('_', ' ')}")
