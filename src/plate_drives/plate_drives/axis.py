"""One drive, led by the host: set up as the board does it, current, small smooth motions, off.

Setpoints are counted by bus cycles, not by the clock: a host that is late makes a motion slower,
never a jump. A host that is gone is missed by the drive itself, after `SILENT_MS`.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator

import numpy as np

from plate_core import PlateError
from plate_core.rig import Limits
from plate_core.serial_protocol import Trouble

from .master import HEARTBEAT, NMT, OWN_NODE, RPDO, SYNC, TPDO, Master, Refused, words
from .survey import enabled, in_fault

CYCLE_MS, BEAT_MS, SILENT_MS = 10, 50, 300
"""Bus cycle, over which the drive interpolates; heartbeats; how long they may be missing [ms]."""

READY_S, OFF_S = 5.0, 0.5
"""Longest waits until it has current, and until it has none [s]."""
STILL_CYCLES, STILL_M = 30, 5e-4
"""How long, and how closely, a motor must stand before it gets current."""
MISSED = 3
"""SYNCs on end that are not answered, or answered twice, that are a fault."""
ASTRAY_M = 1e-3
"""Following error that is a fault where the rig file has none [m]."""

START, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 0x01, 0x80, 0x81, 0x82
OPERATIONAL, PDO_OFF, NO_RTR, LED, LEADABLE = 5, 1 << 31, 1 << 30, 0x227, 0x26F
DISABLE, QUICK_STOP, SHUTDOWN, SWITCH_ON, OPERATE = 0x00, 0x02, 0x06, 0x07, 0x0F

STEPS = (
    (0x6040, 0, DISABLE, 2),  # whatever it did before
    (0x1017, 0, BEAT_MS, 2), (0x1016, 1, OWN_NODE << 16 | SILENT_MS, 4),
    (0x6007, 0, 3, 2), (0x605A, 0, 2, 2),  # quick stop where we are gone, then without current
    (0x60C2, 1, CYCLE_MS, 1), (0x60C2, 2, -3, 1), (0x6060, 0, 8, 1),  # cyclic synchronous position
    (0x1400, 1, PDO_OFF | RPDO, 4), (0x1600, 0, 0, 1), (0x1600, 1, 0x60400010, 4),
    (0x1600, 2, 0x607A0020, 4), (0x1600, 0, 2, 1), (0x1400, 2, 1, 1),
    (0x1800, 1, PDO_OFF | NO_RTR | TPDO, 4), (0x1A00, 0, 0, 1), (0x1A00, 1, 0x60410010, 4),
    (0x1A00, 2, 0x60640020, 4), (0x1A00, 0, 2, 1), (0x1800, 2, 1, 1),
    (0x1400, 1, RPDO, 4), (0x1800, 1, NO_RTR | TPDO, 4),
)  # fmt: skip
"""Object, subindex, value, bytes; as in firmware/drives/cia402.c, but for the times, and PDOs that
nobody uses here. To values of 1400h:01 and 1800h:01 the number of the node is added."""


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no signal of a person end what takes the current away."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(each, signal.SIG_IGN) for each in signals]
    try:
        yield
    finally:
        for each, handler in zip(signals, before, strict=True):
            signal.signal(each, handler)


def switch_off(master: Master, motor: int, node: int) -> None:
    """Take a drive's current away, and see that it has none; a PlateError if nobody knows."""
    end = master.now + OFF_S
    try:
        master.write(node, 0x6040, 0, DISABLE, 2)
        while enabled(status := master.read(node, 0x6041)) and master.now < end:
            master.wait(0.02)
        if not enabled(status):
            return
        why = words(motor, Trouble.KEEPS, 0, status)
    except PlateError as error:
        why = (
            f"{error}: motor_{motor} may have current. Its drive stops it by itself "
            f"{1e-3 * SILENT_MS:g} s after our last word; look, or cut the power by hand"
        )
    with contextlib.suppress(PlateError):
        master.send(NMT, bytes([RESET_NODE, node]))
    raise PlateError(why)


class Axis:
    """A motor's drive; as a context it ends without current, whatever happens within.

    All of it raises a PlateError, in the words of `driver_status`, if something is wrong with the
    drive or the bus.

    Parameters
    ----------
    master : Master
    motor, node : int
        Numbers of the motor, 1 to 4, and of its drive.
    scale : float
        Counts for a metre along the motor's direction, as far as known; negative if against it.
    limits : Limits

    Attributes
    ----------
    position, start : int
        Of the motor, now and where it got current [counts].
    late_s : float
        By how much the host was late at most [s].
    """

    def __init__(self, master: Master, motor: int, node: int, scale: float, limits: Limits) -> None:
        self._master, self._told = master, master.told[node]
        self._motor, self._node, self.scale = motor, node, scale
        self._allowed = limits.following_error_m or ASTRAY_M
        self.position = self.start = self._target = 0
        self._status = self._missed = self._doubled = self._beat = 0
        self._due = self.late_s = 0.0
        self._led = self._astray = False

    def __enter__(self) -> Axis:
        """Set it up, without current."""
        try:
            self._set_up()
        except BaseException as error:
            self.__exit__(None, error)
            raise
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """Take the current away, after an error by the drive's quick stop; a drive that does not
        follow would not follow its ramp either."""
        master, end = self._master, self._master.now + OFF_S
        with uninterrupted():
            with contextlib.suppress(PlateError):  # of the bus: SDOs will tell
                brakes = error is not None and not self._astray
                while brakes and enabled(self._status) and master.now < end:
                    self._exchange(QUICK_STOP)
            try:
                switch_off(master, self._motor, self._node)
                master.write(self._node, 0x1016, 1, 0, 4)  # or it would miss us
                self._command(PRE_OPERATIONAL)
            except PlateError as more:
                if error is None or isinstance(error, PlateError):
                    raise PlateError(f"{error}; {more}" if error else str(more)) from None

    @property
    def travel(self) -> float:
        """How far it is from where it got current, by its own counts [m]."""
        return (self.position - self.start) / self.scale

    def _command(self, order: int) -> None:
        self._master.send(NMT, bytes([order, self._node]))

    def _set_up(self) -> None:
        master, told, node = self._master, self._told, self._node
        told.boots = 0
        self._command(RESET_COMMUNICATION)
        master.wait(READY_S, lambda: told.boots)
        for index, sub, value, size in STEPS:
            value += node if index in (0x1400, 0x1800) and sub == 1 else 0
            try:
                master.write(node, index, sub, value, size)
            except Refused:
                if index != 0x605A:
                    raise
                master.write(node, 0x6007, 0, 2, 2)  # or else without current at once
        mode = master.read(node, 0x6061, signed=True)
        if mode != 8:
            raise PlateError(words(self._motor, Trouble.WRONG_DRIVE, 0x6061, mode))
        self._command(START)
        master.wait(1e-3 * SILENT_MS, lambda: told.state == OPERATIONAL)
        told.boots, told.emergency, self._due = 0, None, master.now
        for _ in range(2):  # the first one answers no SYNC of ours
            self._exchange(None)
        self._missed = self._doubled = 0

    def _exchange(self, word: int | None) -> None:
        """Send a controlword with the target, and SYNC; take what comes in the cycle."""
        master, places, cycle_s = self._master, self._told.places, 1e-3 * CYCLE_MS
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
        self._due = max(self._due + cycle_s, master.now + cycle_s / 2)  # what is missed is missed
        master.wait(self._due - master.now)
        self._missed = 0 if places else self._missed + 1
        self._doubled = self._doubled + 1 if len(places) > 1 else 0
        if places:
            self._status = int.from_bytes(places[-1][:2], "little")
            self.position = int.from_bytes(places[-1][2:], "little", signed=True)

    def _cycle(self, word: int, target: int) -> None:
        """Let a bus cycle pass, at the end of which it is to be at a target [counts]."""
        reached, self._target = self._target, target
        self._exchange(word)
        told, astray = self._told, abs(self.position - reached) / abs(self.scale)
        troubles = (
            (told.emergency, Trouble.EMERGENCY, *(told.emergency or (0, 0))[::-1]),
            (told.boots, Trouble.RESET, 0, 0),
            (told.state != OPERATIONAL, Trouble.NOT_OPERATIONAL, 0, told.state or 0),
            (self._master.now - told.beat_at > 1e-3 * SILENT_MS, Trouble.SILENT, 0, 0),
            (self._missed == MISSED, Trouble.NO_POSITION, 0, 0),
            (self._doubled == MISSED, Trouble.TWICE, 0, 0),
            (in_fault(self._status), Trouble.FAULT, 0, self._status),
            (self._led and self._status & LEADABLE != LED, Trouble.LEFT, 0, self._status),
        )  # fmt: skip
        for so, kind, index, code in troubles:
            if so:
                raise PlateError(words(self._motor, kind, index, code))
        if self._master.rival:
            raise PlateError(words(0, Trouble.OTHER_MASTER))
        self._astray = enabled(self._status) and astray > self._allowed
        if self._astray:
            raise PlateError(
                f"motor_{self._motor}: does not follow: {1e3 * astray:.2g} mm from its setpoint, "
                f"allowed: {1e3 * self._allowed:g}"
            )

    def enable(self, room: float, ends: tuple[int, int]) -> None:
        """Give it current where it stands, once it does.

        Parameters
        ----------
        room : float
            How far it is to move to either side [m].
        ends : (int, int)
            Of its range [counts].
        """
        end, stands, rest = self._master.now + READY_S, 0, self.position
        while stands < STILL_CYCLES:
            self._cycle(DISABLE, self.position)
            moved = abs(self.position - rest) > STILL_M * abs(self.scale)
            stands, rest = (0, self.position) if moved else (stands + 1, rest)
            if self._master.now > end:
                raise PlateError(f"motor_{self._motor}: does not stand still")
        counts = room * abs(self.scale)
        if not ends[0] + counts <= self.position <= ends[1] - counts:
            raise PlateError(
                f"motor_{self._motor}: stands at {self.position}, allowed: {counts:.0f} counts or "
                f"more from the ends of its range, {ends[0]} and {ends[1]}"
            )
        end = self._master.now + READY_S
        while self._status & 0x6F != 0x27:
            if self._master.now > end:
                raise PlateError(words(self._motor, Trouble.NOT_ENABLED, 0, self._status))
            known = {0x21: SWITCH_ON, 0x23: OPERATE}
            ready = self._status & 0x4F == 0x40  # switch on disabled
            self._cycle(SHUTDOWN if ready else known.get(self._status & 0x6F, 0), self.position)
        self.start, self._led = self._target, True

    def hold(self) -> None:
        """Let a bus cycle pass where it is."""
        self._cycle(OPERATE, self._target)

    def follow(self, path: Callable[[float], float], seconds: float) -> np.ndarray:
        """Move along a path of time [s] to travel from where it got current [m], and stay at its
        end; returns targets, and positions a bus cycle later (2, n), from there [m]."""
        rows = []
        for k in range(1, round(1e3 * seconds / CYCLE_MS) + 1):
            reached = self._target
            self._cycle(OPERATE, self.start + round(path(1e-3 * k * CYCLE_MS) * self.scale))
            rows.append((reached - self.start, self.position - self.start))
        return np.transpose(rows) / self.scale
