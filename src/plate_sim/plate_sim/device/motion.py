"""What the device's motors do: along tables, braking, on their way home (firmware/motion.c)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core.serial_protocol import Fault, State
from plate_core.serial_protocol.messages import MOTORS

from .changed import changed
from .stream import Stream
from .table import Table

BRAKE_S = 0.2
"""Longest brake [s]: short, but gentle against the plate's 10 g."""

HOMEWARD_S = 0.5
"""Of the way home [s]: for a stroke 0.04 m/s, 0.25 m/s2."""

REST = np.zeros((3, MOTORS), np.float32)
REST.setflags(write=False)


@dataclass(frozen=True)
class Motion:
    """Where the motors are in what they do.

    Attributes
    ----------
    state : State
    faults : Fault
    playing : Table or None
        The one that plays, or did last.
    repeats, played : int
        How often it is to be played (0: until another one comes), and has been.
    waiting : Table or None
        The one that is taken over at the next boundary, ...
    next_repeats : int
        ... and its repeats.
    time : float
        Into the table [s].
    brake, brake_s : float
        Since the brake began, and its length [s].
    homeward : float or None
        Since the way home began [s]; None if it has not.
    start : (3, 4)
        Setpoint that was commanded last, or from which the way home begins.
    """

    state: State = State.OFF
    faults: Fault = Fault.NO_HOME
    playing: Table | None = None
    repeats: int = 0
    played: int = 0
    waiting: Table | None = None
    next_repeats: int = 0
    time: float = 0.0
    brake: float = 0.0
    brake_s: float = 0.0
    homeward: float | None = None
    start: np.ndarray = field(default_factory=lambda: REST)

    def off(self, faults: Fault) -> Motion:
        """Return the motion with current off, for the reasons given."""
        faults = self.faults | faults
        return changed(self, state=State.OFF, faults=faults, waiting=None, homeward=None)

    def braked(self, faults: Fault) -> Motion:
        """Slow down along the table and go home; off at once where nothing plays."""
        motion = changed(self, faults=self.faults | faults, waiting=None)
        if motion.state is State.PLAYING and motion.playing is not None:
            endless = isinstance(motion.playing, Stream)
            length = BRAKE_S if endless else min(motion.playing.period, BRAKE_S)
            return changed(motion, state=State.BRAKING, brake=0.0, brake_s=length)
        return motion if motion.state is State.BRAKING else motion.off(faults)

    def going_home(self, state: State) -> Motion:
        """From `start`, at rest, to home; HOMING ends in READY, BRAKING in OFF."""
        return changed(self, state=state, homeward=0.0)

    def stepped(self, dt: float, home_found: bool) -> tuple[Motion, np.ndarray | None]:
        """Let `dt` [s] pass; returns the setpoint (3, 4) too, if there is one to command."""
        motion = self
        if motion.state is State.READY and motion.waiting is not None:
            motion = changed(motion._taken_over(), state=State.PLAYING, time=-dt)  # it begins now
        if motion.homeward is not None:
            return motion._homeward(motion.homeward + dt)
        if motion.state in (State.PLAYING, State.BRAKING):
            return motion._played(dt)
        if motion.state is State.READY:
            return motion, np.stack([motion.start[0], REST[1], REST[2]])
        if motion.state is State.HOMING and home_found:
            motion = motion.off(Fault.NONE)
            motion = changed(motion, faults=motion.faults & ~Fault.NO_HOME)
        return motion, None

    def _taken_over(self) -> Motion:
        return changed(
            self, playing=self.waiting, repeats=self.next_repeats, waiting=None, played=0
        )

    def _played(self, dt: float) -> tuple[Motion, np.ndarray | None]:
        """Along the table, slower and slower when braking."""
        dry = self.state is State.PLAYING and self._runs_dry(dt)
        motion = self.braked(Fault.HOST_SILENT) if dry else self
        rate, slowing, step, brake = 1.0, 0.0, dt, motion.brake
        if motion.state is State.BRAKING:
            begin = brake / motion.brake_s
            u = min(begin + dt / motion.brake_s, 1.0)
            brake = u * motion.brake_s
            rate = 1 - u * u * (3 - 2 * u)
            slowing = 6 * u * (u - 1) / motion.brake_s
            step = motion.brake_s * (_brake_path(u) - _brake_path(begin))
        motion = changed(motion, time=motion.time + step, brake=brake)._wrapped()
        assert motion.playing is not None  # PLAYING and BRAKING always have one
        along = np.float32(0 if motion.state is State.READY else rate)
        position, speed, accel = motion.playing.at(motion.time)
        accel = accel * (along * along)
        accel += np.float32(slowing) * speed
        at = np.stack([position, speed * along, accel])
        motion = changed(motion, start=at)
        if motion.state is State.BRAKING and motion.brake >= motion.brake_s:
            motion = motion.going_home(State.BRAKING)
        return motion, at

    def _runs_dry(self, dt: float) -> bool:
        """Whether a stream's last knots are needed for a brake."""
        stream = self.playing
        if not isinstance(stream, Stream) or stream.rests:
            return False
        return self.time + dt + BRAKE_S / 2 > stream.period

    def _wrapped(self) -> Motion:
        """Take over, begin again or end where the table's time is beyond its end."""
        motion = self
        if isinstance(motion.playing, Stream):  # it ends at rest
            if motion.time < motion.playing.period:
                return motion
            state = State.READY if motion.state is State.PLAYING else motion.state
            return changed(motion, time=motion.playing.period, state=state)
        while motion.playing is not None and motion.time >= motion.playing.period:
            time, played = motion.time - motion.playing.period, motion.played + 1
            motion = changed(motion, time=time, played=played)
            if motion.waiting is not None:
                motion = motion._taken_over()
            elif motion.state is State.PLAYING and 0 < motion.repeats <= played:
                # All tables begin and end at rest, since the first one does.
                return changed(motion, state=State.READY, time=0.0)
        return motion

    def _homeward(self, homeward: float) -> tuple[Motion, np.ndarray | None]:
        """From where the plate stands to home, from rest to rest."""
        u = np.array([homeward / HOMEWARD_S if homeward < HOMEWARD_S else 1.0], np.float32)
        left = 1 - u * u * u * (10 - u * (15 - 6 * u))
        slope = -30 * u * u * (1 - u) * (1 - u) / np.float32(HOMEWARD_S)
        bend = -60 * u * (1 - u) * (1 - 2 * u) / np.float32(HOMEWARD_S * HOMEWARD_S)
        at = np.stack([left * self.start[0], slope * self.start[0], bend * self.start[0]])
        if u[0] < 1:
            return changed(self, homeward=homeward), at
        home = np.stack([REST[0], self.start[1], self.start[2]])
        motion = changed(self, homeward=None, start=home)
        if motion.state is State.BRAKING:
            return motion.off(Fault.NONE), None
        return changed(motion, state=State.READY), at


def _brake_path(u: float) -> float:
    """Integral of the brake's rate 1 - 3 u^2 + 2 u^3."""
    return u - u * u * u * (1 - u / 2)
