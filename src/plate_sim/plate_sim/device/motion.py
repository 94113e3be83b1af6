"""How the device's motors move: along tables, braking, on the way home (firmware/motion.c)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core.serial_protocol import MOTORS, Fault, State

from .piece import TICK_S
from .table import Stream, Table, changed

BRAKE_TICKS = 20_000_000
"""Longest brake [TICK_S]: 0.2 s, short, but gentle against the plate's 10 g."""

RETURN_US, RETURN_S = 500_000, 0.5
"""Duration of the way home [us], [s]: for a stroke 0.04 m/s, 0.25 m/s2."""

SEARCH_US = 5_000_000
"""Longest search for home [us]."""

TICKS_PER_US = 100
"""Of TICK_S."""

REST = np.zeros((3, MOTORS), np.float32)
REST.setflags(write=False)
ZERO = REST[0]


@dataclass(frozen=True)
class Motion:
    """What the motors are doing.

    Attributes
    ----------
    state : State
    faults : Fault
    stops : int
        Number of the present stop, or of the last one, modulo 65536.
    playing : Table or None
        The one that plays, or did last.
    repeats, played : int
        How often it is to be played, and has been.
    waiting : Table or None
        The one that is taken over at the next boundary, ...
    next_repeats : int
        ... and its repeats.
    time : int
        Into the table [TICK_S].
    brake, brake_length : int
        Since the brake began, and its length [TICK_S].
    enabled_us : int
        When current was switched on last [us].
    return_us : int or None
        Since the way home began [us]; None if it has not.
    start : (4,)
        Where the way home begins [m].
    commanded : (3, 4)
        Last setpoint; of rest, where the motors were when they were enabled.
    """

    state: State = State.OFF
    faults: Fault = Fault.NO_HOME
    stops: int = 0
    playing: Table | None = None
    repeats: int = 0
    played: int = 0
    waiting: Table | None = None
    next_repeats: int = 0
    time: int = 0
    brake: int = 0
    brake_length: int = 0
    enabled_us: int = 0
    return_us: int | None = None
    start: np.ndarray = field(default_factory=lambda: ZERO)
    commanded: np.ndarray = field(default_factory=lambda: REST)

    @property
    def searches(self) -> bool:
        """Whether home is being searched for."""
        return self.state is State.HOMING and Fault.NO_HOME in self.faults

    def off(self, faults: Fault) -> Motion:
        """Return the motion with current off, for the reasons given: a stop, if it flowed."""
        stopped = faults and self.state is not State.OFF
        return changed(
            self, state=State.OFF, faults=self.faults | faults, waiting=None, return_us=None,
            stops=(self.stops + 1) % 2**16 if stopped else self.stops,
        )  # fmt: skip

    def braked(self, faults: Fault) -> Motion:
        """Slow down along the table and its tail and go home; off at once where nothing plays.

        A stop, unless the plate brakes for these reasons already.
        """
        stops = (self.stops + 1) % 2**16
        if self.state is State.PLAYING and self.playing is not None:
            length = BRAKE_TICKS
            if not isinstance(self.playing, Stream) and self.playing.begins_home:
                length = min(self.playing.period_ticks, BRAKE_TICKS)
            return changed(
                self, state=State.BRAKING, faults=self.faults | faults, waiting=None, stops=stops,
                brake=0, brake_length=length,
            )  # fmt: skip
        if self.state is not State.BRAKING:
            return self.off(faults)
        if faults & ~self.faults:
            return changed(self, faults=self.faults | faults, stops=stops)
        return self

    def stopped(self, now: bool, faults: Fault) -> Motion:
        """Brake, or current off at once; counted also where no current flows."""
        motion = self.off(faults) if now else self.braked(faults)
        if motion.stops == self.stops:
            motion = changed(motion, stops=(self.stops + 1) % 2**16)
        return motion

    def enabled(self, now_us: int) -> Motion:
        """Current on: find home if it is not known, then go there."""
        kept = self.faults & Fault.NO_HOME
        return changed(self, state=State.HOMING, faults=kept, enabled_us=now_us)

    def stepped(
        self, now_us: int, dt_us: int, home_found: bool, measured: np.ndarray
    ) -> tuple[Motion, np.ndarray | None]:
        """Let `dt_us` pass; returns the setpoint (3, 4) too, if there is one to command."""
        motion, dt = self, dt_us * TICKS_PER_US
        if motion.state is State.READY and motion.waiting is not None:
            motion, dt = changed(motion._taken_over(), state=State.PLAYING), 0  # it begins now
        if motion.searches:
            return motion._searched(now_us, home_found), None
        if motion.state is State.HOMING and motion.return_us is None:
            rest = np.stack([measured, ZERO, ZERO])
            motion = changed(motion, commanded=rest, start=measured, return_us=0)
        braking = motion.state is State.BRAKING
        if braking and motion.return_us is None and motion.brake == motion.brake_length:
            motion = changed(motion, start=motion.commanded[0], return_us=0)
        if motion.return_us is not None:
            return motion._returned(min(motion.return_us + dt_us, RETURN_US))
        if braking or motion.state is State.PLAYING:
            return motion._played(dt)
        if motion.state is State.READY:
            return motion, np.stack([motion.commanded[0], ZERO, ZERO])
        return motion, None

    def _searched(self, now_us: int, found: bool) -> Motion:
        """Find home; the way there begins in the tick after, from what is then measured."""
        if found:
            return changed(self, faults=self.faults & ~Fault.NO_HOME)
        late = now_us - self.enabled_us >= SEARCH_US
        return self.off(Fault.HARDWARE) if late else self

    def _taken_over(self) -> Motion:
        return changed(
            self, playing=self.waiting, repeats=self.next_repeats, waiting=None, played=0, time=0
        )

    def _played(self, dt: int) -> tuple[Motion, np.ndarray | None]:
        """Along the table, slower and slower when braking."""
        dry = self.state is State.PLAYING and self._underruns(dt)
        motion = self.braked(Fault.HOST_SILENT) if dry else self
        rate: np.ndarray | None = None
        slowing, step = ZERO[:1], dt
        if motion.state is State.BRAKING:
            end, length = min(motion.brake + dt, motion.brake_length), motion.brake_length
            u = np.array([end], np.float32) / np.float32(length)
            before = np.array([motion.brake], np.float32) / np.float32(length)
            # Simpson's rule is exact for a cubic.
            mean = (_rate(before) + 4 * _rate((before + u) / 2) + _rate(u)) / 6
            step = int((np.float32(end - motion.brake) * mean + np.float32(0.5))[0])
            rate, slowing = _rate(u), 6 * u * (u - 1) / np.array([np.float32(length) * TICK_S])
            motion = changed(motion, brake=end)
        motion = motion._passed(step)
        assert motion.playing is not None  # PLAYING and BRAKING always have one
        at = motion.playing.at(motion.time)
        if rate is not None:
            position, speed, accel = at
            at = np.stack([position, speed * rate, accel * (rate * rate) + slowing * speed])
        return motion, at

    def _underruns(self, dt: int) -> bool:
        """Whether a stream's last knots are needed for a brake."""
        stream = self.playing
        if not isinstance(stream, Stream) or stream.rests:
            return False
        return self.time + dt + BRAKE_TICKS // 2 > stream.period_ticks

    def joins(self, table: Table) -> bool:
        """Tell whether a table goes on where the one that plays is spliced, and that is ahead."""
        playing = self.playing if self.state is State.PLAYING else None
        return playing is not None and self.time < playing.splice and table.follows(playing)

    def _passed(self, step: int) -> Motion:
        """Let the table's time pass: take over at its splice or its end, begin again, or rest at
        its end.

        Its cycle and its tail are longer than any tick, so that this happens once at most.
        """
        playing, waiting = self.playing, self.waiting
        assert playing is not None
        time, period = self.time + step, playing.period_ticks
        if waiting is not None and time >= playing.splice and self.joins(waiting):
            return changed(self._taken_over(), time=time - playing.splice)
        if time < period:
            return changed(self, time=time)
        if waiting is not None:
            return changed(self._taken_over(), time=time - period)
        plays = self.state is State.PLAYING
        if plays and not isinstance(playing, Stream) and self.played + 1 < self.repeats:
            return changed(self, time=time - period, played=self.played + 1)
        return changed(self, time=period, state=State.READY if plays else self.state)

    def _returned(self, return_us: int) -> tuple[Motion, np.ndarray | None]:
        """From where the plate stands to home, from rest to rest."""
        u = np.array([return_us], np.float32) / np.float32(RETURN_US)
        left = 1 - u * u * u * (10 - u * (15 - 6 * u))
        slope = -30 * u * u * (1 - u) * (1 - u) / np.float32(RETURN_S)
        bend = -60 * u * (1 - u) * (1 - 2 * u) / np.float32(RETURN_S * RETURN_S)
        at = np.stack([left * self.start, slope * self.start, bend * self.start])
        if return_us < RETURN_US:
            return changed(self, return_us=return_us), at
        motion = changed(self, return_us=None)
        if motion.state is State.BRAKING:
            return motion.off(Fault.NONE), None
        return changed(motion, state=State.READY), at


def _rate(u: np.ndarray) -> np.ndarray:
    """Rate of the table's time while braking."""
    return np.asarray(1 - u * u * (3 - 2 * u))
