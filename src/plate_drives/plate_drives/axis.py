"""One drive that the host commands during commissioning. The host sets the drive up, enables it,
moves it by small amounts, and disables it.

The set-up is the same as in the board's firmware. The host sends one setpoint in each bus cycle,
even if the cycle starts late. A delay of the host therefore slows the motion down, but the motor
does not jump. If the host's heartbeat is missing for `TIMEOUT_MS`, the drive stops without a
command.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator

import numpy as np

from plate_core import PlateError
from plate_core.rig import Limits
from plate_core.serial_protocol import Trouble

from .master import HEARTBEAT, NMT, OWN_NODE, RPDO, SYNC, TPDO, Master, Refused, trouble_text
from .survey import has_current, is_in_fault

CYCLE_MS = 10
"""Length of a bus cycle [ms]. The drive interpolates between two setpoints over this time."""

BEAT_MS = 50
"""Period at which each drive and this program send heartbeats [ms]."""

TIMEOUT_MS = 300
"""Time without a heartbeat of this program after which a drive stops without a command [ms]."""

READY_S = 5.0
"""Maximum time until the drive is enabled [s]."""

OFF_S = 0.5
"""Maximum time until the drive is disabled [s]."""
STILL_CYCLES = 30
"""Number of bus cycles during which a motor must rest before it is enabled."""

STILL_M = 5e-4
"""A motor counts as at rest while its displacement from the place where it stopped is at most this
distance [m]."""
MISSED = 3
"""Number of consecutive SYNCs without a reply, or with two replies, after which a fault is
reported."""
ASTRAY_M = 1e-3
"""Maximum following error if the rig file does not contain a limit [m]."""

START = 0x01
PRE_OPERATIONAL = 0x80
RESET_NODE = 0x81
RESET_COMMUNICATION = 0x82
OPERATIONAL, PDO_OFF, NO_RTR = 5, 1 << 31, 1 << 30
OPERATION_ENABLED, OPERATION_MASK = 0x227, 0x26F
"""State *operation enabled* of CiA 402 in a status word of a drive under remote control, and the
mask of the bits that define it."""

DISABLE = 0x00
QUICK_STOP = 0x02
SHUTDOWN = 0x06
SWITCH_ON = 0x07
OPERATE = 0x0F

STEPS = (
    (0x6040, 0, DISABLE, 2),  # disable the drive in any state
    (0x1017, 0, BEAT_MS, 2), (0x1016, 1, OWN_NODE << 16 | TIMEOUT_MS, 4),
    # If the connection to the host is lost, the drive does a quick stop, then switches the current
    # off.
    (0x6007, 0, 3, 2), (0x605A, 0, 2, 2),
    # Operation mode 8: cyclic synchronous position.
    (0x60C2, 1, CYCLE_MS, 1), (0x60C2, 2, -3, 1), (0x6060, 0, 8, 1),
    (0x1400, 1, PDO_OFF | RPDO, 4), (0x1600, 0, 0, 1), (0x1600, 1, 0x60400010, 4),
    (0x1600, 2, 0x607A0020, 4), (0x1600, 0, 2, 1), (0x1400, 2, 1, 1),
    (0x1800, 1, PDO_OFF | NO_RTR | TPDO, 4), (0x1A00, 0, 0, 1), (0x1A00, 1, 0x60410010, 4),
    (0x1A00, 2, 0x60640020, 4), (0x1A00, 0, 2, 1), (0x1800, 2, 1, 1),
    (0x1400, 1, RPDO, 4), (0x1800, 1, NO_RTR | TPDO, 4),
)  # fmt: skip
"""Object, subindex, value and number of bytes of each set-up step. The steps equal those of
firmware/drives/cia402.c, except for the times and for the process data objects (PDOs) that are not
used here. The node number is added to the values of 1400h:01 and 1800h:01."""


@contextlib.contextmanager
def ignore_signals() -> Iterator[None]:
    """Ignore SIGINT, SIGTERM and SIGHUP in the context. The code that disables drives therefore
    cannot be interrupted by these signals."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, signal.SIG_IGN) for number in signals]
    try:
        yield
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)


def switch_off(master: Master, motor: int, node: int) -> None:
    """Disable a drive and check that it has no current. Raise a PlateError if the drive may still
    have current."""
    end = master.now + OFF_S
    try:
        master.write(node, 0x6040, 0, DISABLE, 2)
        while has_current(status := master.read(node, 0x6041)) and master.now < end:
            master.wait(0.02)
        if not has_current(status):
            return
        why = trouble_text(motor, Trouble.KEEPS, 0, status)
    except PlateError as error:
        why = (
            f"{error}; motor_{motor} may still have current. Its drive should stop it "
            f"{1e-3 * TIMEOUT_MS:g} s after the last message; check this, or cut the power by hand"
        )
    with contextlib.suppress(PlateError):
        master.send(NMT, bytes([RESET_NODE, node]))
    raise PlateError(why)


class Axis:
    """A motor's drive, as a context manager. At the end of the context, the drive is always
    disabled.

    All methods raise a PlateError, with the text of `driver_status`, if there is a fault of the
    drive or the bus.

    Parameters
    ----------
    master : Master
    motor, node : int
        Numbers of the motor, 1 to 4, and of its drive.
    scale : float
        Estimated counts per metre along the motor's direction. The value is negative if the drive
        counts against the motor's direction.
    limits : Limits

    Attributes
    ----------
    position : int
        Present position of the motor [counts].
    start : int
        Position of the motor when it was enabled [counts].
    late_s : float
        Maximum delay of the host's setpoints [s].
    """

    def __init__(self, master: Master, motor: int, node: int, scale: float, limits: Limits) -> None:
        self._master, self._received = master, master.received[node]
        self._motor, self._node, self.scale = motor, node, scale
        self._allowed = limits.following_error_m or ASTRAY_M
        self.position = self.start = self._target = 0
        self._status = self._missed = self._doubled = self._beat = 0
        self._due = self.late_s = 0.0
        self._commanded = self._deviates = False

    def __enter__(self) -> Axis:
        """Configure the drive without switching on its current."""
        try:
            self._set_up()
        except BaseException as error:
            self.__exit__(None, error)
            raise
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """Disable the drive. After an error, first brake with the drive's quick stop. The quick
        stop is omitted if the drive did not follow its setpoints. Such a drive would not follow the
        ramp of a quick stop either."""
        master, end = self._master, self._master.now + OFF_S
        with ignore_signals():
            # ignore errors of the bus here, because the SDOs below report them
            with contextlib.suppress(PlateError):
                brakes = error is not None and not self._deviates
                while brakes and has_current(self._status) and master.now < end:
                    self._exchange_frames(QUICK_STOP)
            try:
                switch_off(master, self._motor, self._node)
                # The drive no longer expects the host's heartbeat.
                master.write(self._node, 0x1016, 1, 0, 4)
                self._send_controlword(PRE_OPERATIONAL)
            except PlateError as more:
                if error is None or isinstance(error, PlateError):
                    raise PlateError(f"{error}; {more}" if error else str(more)) from None

    @property
    def travel(self) -> float:
        """Displacement since the drive was enabled, computed from the drive's counts [m]."""
        return (self.position - self.start) / self.scale

    def _send_controlword(self, order: int) -> None:
        self._master.send(NMT, bytes([order, self._node]))

    def _set_up(self) -> None:
        master, received, node = self._master, self._received, self._node
        received.boots = 0
        self._send_controlword(RESET_COMMUNICATION)
        master.wait(READY_S, lambda: received.boots)
        for index, sub, value, size in STEPS:
            value += node if index in (0x1400, 0x1800) and sub == 1 else 0
            try:
                master.write(node, index, sub, value, size)
            except Refused:
                if index != 0x605A:
                    raise
                # A drive that does not support this quick stop must switch the current off
                # immediately.
                master.write(node, 0x6007, 0, 2, 2)
        mode = master.read(node, 0x6061, signed=True)
        if mode != 8:
            raise PlateError(trouble_text(self._motor, Trouble.WRONG_DRIVE, 0x6061, mode))
        self._send_controlword(START)
        master.wait(1e-3 * TIMEOUT_MS, lambda: received.state == OPERATIONAL)
        received.boots, received.emergency, self._due = 0, None, master.now
        for _ in range(2):  # exchange twice, because the first reply may belong to an earlier SYNC
            self._exchange_frames(None)
        self._missed = self._doubled = 0

    def _exchange_frames(self, word: int | None) -> None:
        """Send a controlword and the target position, then SYNC. Receive the frames of this bus
        cycle. If `word` is None, only SYNC is sent."""
        master, places, cycle_s = self._master, self._received.places, 1e-3 * CYCLE_MS
        places.clear()
        self._beat -= CYCLE_MS
        if self._beat <= 0:
            master.send(HEARTBEAT + OWN_NODE, bytes([OPERATIONAL]))
            self._beat = BEAT_MS
        if word is not None:
            target = self._target.to_bytes(4, "little", signed=True)
            master.send(RPDO + self._node, word.to_bytes(2, "little") + target)
        master.send(SYNC)
        self.late_s = max(self.late_s, master.now - self._due)
        # Do not send missed cycles later.
        self._due = max(self._due + cycle_s, master.now + cycle_s / 2)
        master.wait(self._due - master.now)
        self._missed = 0 if places else self._missed + 1
        self._doubled = self._doubled + 1 if len(places) > 1 else 0
        if places:
            self._status = int.from_bytes(places[-1][:2], "little")
            self.position = int.from_bytes(places[-1][2:], "little", signed=True)

    def _run_bus_cycle(self, word: int, target: int) -> None:
        """Run one bus cycle, and check for faults. The drive must reach `target` [counts] at the
        end of the cycle."""
        reached, self._target = self._target, target
        self._exchange_frames(word)
        received, deviation = self._received, abs(self.position - reached) / abs(self.scale)
        enabled = self._status & OPERATION_MASK == OPERATION_ENABLED
        troubles = (
            (received.emergency, Trouble.EMERGENCY, *(received.emergency or (0, 0))[::-1]),
            (received.boots, Trouble.RESET, 0, 0),
            (received.state != OPERATIONAL, Trouble.NOT_OPERATIONAL, 0, received.state or 0),
            (self._master.now - received.beat_at > 1e-3 * TIMEOUT_MS, Trouble.SILENT, 0, 0),
            (self._missed == MISSED, Trouble.NO_POSITION, 0, 0),
            (self._doubled == MISSED, Trouble.TWICE, 0, 0),
            (is_in_fault(self._status), Trouble.FAULT, 0, self._status),
            (self._commanded and not enabled, Trouble.LEFT, 0, self._status),
        )  # fmt: skip
        for so, kind, index, code in troubles:
            if so:
                raise PlateError(trouble_text(self._motor, kind, index, code))
        if self._master.other_master:
            raise PlateError(trouble_text(0, Trouble.OTHER_MASTER))
        self._deviates = has_current(self._status) and deviation > self._allowed
        if self._deviates:
            raise PlateError(
                f"motor_{self._motor}: does not follow; following error is {1e3 * deviation:.2g} "
                f"mm, allowed: {1e3 * self._allowed:g} mm"
            )

    def enable(self, amplitude: float, ends: tuple[int, int]) -> None:
        """Enable the drive at its position, after the motor has come to rest.

        Parameters
        ----------
        amplitude : float
            Distance by which the motor will move to either side [m].
        ends : (int, int)
            Ends of the drive's range [counts].
        """
        end, stands, rest = self._master.now + READY_S, 0, self.position
        while stands < STILL_CYCLES:
            self._run_bus_cycle(DISABLE, self.position)
            moved = abs(self.position - rest) > STILL_M * abs(self.scale)
            stands, rest = (0, self.position) if moved else (stands + 1, rest)
            if self._master.now > end:
                raise PlateError(f"motor_{self._motor}: does not come to rest within {READY_S:g} s")
        counts = amplitude * abs(self.scale)
        if not ends[0] + counts <= self.position <= ends[1] - counts:
            raise PlateError(
                f"motor_{self._motor}: position is {self.position}, allowed: at least "
                f"{counts:.0f} counts from the ends of its range, {ends[0]} and {ends[1]}"
            )
        end = self._master.now + READY_S
        while self._status & 0x6F != 0x27:
            if self._master.now > end:
                raise PlateError(trouble_text(self._motor, Trouble.NOT_ENABLED, 0, self._status))
            known = {0x21: SWITCH_ON, 0x23: OPERATE}
            # whether the drive is in the state "switch on disabled"
            ready = self._status & 0x4F == 0x40
            self._run_bus_cycle(
                SHUTDOWN if ready else known.get(self._status & 0x6F, 0), self.position
            )
        self.start, self._commanded = self._target, True

    def hold(self) -> None:
        """Keep the motor at its present target for one bus cycle."""
        self._run_bus_cycle(OPERATE, self._target)

    def follow(self, path: Callable[[float], float], seconds: float) -> np.ndarray:
        """Move the motor along a path for the time `seconds` [s]. Return an array (2, n) of
        displacements since the drive was enabled [m]. The first row contains the targets, the
        second row the positions measured one bus cycle later.

        `path` is a function from time [s] to displacement since the drive was enabled [m]."""
        rows = []
        for k in range(1, round(1e3 * seconds / CYCLE_MS) + 1):
            reached = self._target
            self._run_bus_cycle(OPERATE, self.start + round(path(1e-3 * k * CYCLE_MS) * self.scale))
            rows.append((reached - self.start, self.position - self.start))
        return np.transpose(rows) / self.scale
