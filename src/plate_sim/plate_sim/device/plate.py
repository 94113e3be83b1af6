"""Plate of the simulated device. `Recorder` records the motion of the motors in segments, one per
image. `SuspendedPlate` simulates the plate on its flexures in steps of one tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import Rig
from plate_core.motion import quintic_pieces
from plate_core.serial_protocol import MOTORS, TICK_S

from .._kernels import Device
from ..plate import PlateMotion, PlateState, realise

SEGMENT_S = 0.1
"""Length of a segment of motion while no table is played [s]. The simulator takes one image per
segment."""

COAST_RATE = 60.0
"""Rate at which the plate returns to home while the motors have no current [1/s]. The motion is
critically damped."""

EVERY = 4
"""Number of ticks between two knots of a segment, unless the segment is a whole table."""

STATE = 10
"""Number of components of the plate's state: pose (3), twist (3), motor forces (4)."""

INPUT = 9
"""Number of components of the setpoint: pose (3), twist (3), acceleration (3)."""

SCALE = 1e-6
"""Size of the test inputs and test states from which the columns of the matrix are computed [SI
units]. The size is so small that every plate stays within its limits."""


@dataclass(frozen=True)
class Segment:
    """Motion of the motors from one image to the next.

    Attributes
    ----------
    start : float
        Start of the segment on the device's clock [s].
    times : (k + 1,)
        Times of the knots since the start of the segment [s].
    motors : (k + 1, 3, 4)
        Travel [m], speed [m/s] and acceleration [m/s2] of the motors at the knots. Between the
        knots, the motion is a quintic polynomial.
    table : int
        Number of the motor table if the segment is a whole table, otherwise 0.
    """

    start: float
    times: np.ndarray
    motors: np.ndarray
    table: int = 0

    @property
    def end(self) -> float:
        """End of the segment on the device's clock [s]."""
        return self.start + float(self.times[-1])


class Recorder:
    """Records the motion of a device's motors tick by tick.

    A segment ends when a table starts or repeats, when the camera is triggered, and after
    `SEGMENT_S` if no table is played. While the motors have no current, the flexures return the
    plate to home.
    """

    def __init__(self, now: float = 0.0) -> None:
        self._start = now
        self._ticks: list[tuple[float, np.ndarray]] = [(now, np.zeros((3, MOTORS)))]
        # Segment that contains a whole table. The start time of the segment is the start time of
        # the table.
        self._whole: Segment | None = None
        self._play: tuple[int, int] | None = None

    @property
    def plate(self) -> np.ndarray:
        """Current position, speed and acceleration of the motors (3, 4)."""
        return self._ticks[-1][1]

    def coasted(self, dt: float) -> np.ndarray:
        """Return position, speed and acceleration of the motors (3, 4) after they had no current
        for the time `dt` [s].

        With the rate r = COAST_RATE and the initial position x_0 and speed v_0 of a motor, the
        critically damped motion x'' + 2 r x' + r^2 x = 0 is

            x(t) = (x_0 + (v_0 + r x_0) t) exp(-r t).
        """
        position, speed, _ = self.plate
        push = speed + COAST_RATE * position
        fade = np.exp(-COAST_RATE * dt)
        position, speed = (position + push * dt) * fade, (speed - COAST_RATE * push * dt) * fade
        return np.stack([position, speed, -(COAST_RATE**2) * position - 2 * COAST_RATE * speed])

    def followed(
        self,
        now: float,
        device: Device | None,
        setpoint: np.ndarray | None,
        triggered: bool = False,
    ) -> list[Segment]:
        """Record the state of the motors at the time `now` [s]. Return the segments that have ended
        since the last call.

        `setpoint` is the setpoint at the time `now`, or None while the motors have no current.
        `triggered` states whether the camera was triggered. If `device` is None, the attribute
        `table` of all segments is 0.
        """
        done = []
        play = None if device is None else device.play
        if play is None or device is None:
            self._whole = self._play = None
        elif play[:2] != self._play:
            ticks, states, _ = device.table()
            start = now - play[2] * TICK_S
            segment = Segment(start, ticks * TICK_S, states.astype(float), device.playing)
            done = self._end_segment(start, segment.motors[0])
            self._whole, self._play = segment, play[:2]
        state = (
            self.coasted(now - self._ticks[-1][0]) if setpoint is None else setpoint.astype(float)
        )
        self._ticks.append((now, state))
        if triggered or (self._whole is None and now - self._start >= SEGMENT_S):
            done += self._end_segment(now, state)
        return done

    def _end_segment(self, when: float, end: np.ndarray) -> list[Segment]:
        """End the present segment at the time `when` [s], and return it in a list. `end` (3, 4)
        contains position, speed and acceleration of the motors at this time."""
        start, ticks, last = self._start, self._ticks, self._whole
        self._start, self._ticks = when, [(when, end)]
        if when <= start:
            return []
        if last is not None and last.start == start and abs(when - last.end) < 1e-9:
            return [last]
        inner = [tick for tick in ticks[1:] if start + 1e-4 < tick[0] < when - 1e-4]
        kept = [ticks[0], *inner[EVERY - 1 :: EVERY], (when, end)]
        times = np.array([t - start for t, _ in kept])
        return [Segment(start, times, np.stack([state for _, state in kept]))]


class SuspendedPlate:
    """Plate on flexures with drives, in steps of one tick. `plate_sim.plate.drive` describes the
    model.

    Plate and drives are a linear system, so one tick is the multiplication of the state and the
    setpoints by a matrix. The function `realise` computes the columns of this matrix. The lever
    arms of the motors are assumed to be constant and equal to those at home.

    Parameters
    ----------
    rig : Rig
        Rig with a suspension.
    tick_s : float
        Length of a tick [s].
    """

    def __init__(self, rig: Rig, tick_s: float) -> None:
        self._state = np.zeros(STATE)
        self._last = np.zeros(INPUT)
        columns = np.eye(STATE + 2 * INPUT) * SCALE
        self._tick = (
            np.stack([_state_after_tick(rig, tick_s, column) for column in columns], 1) / SCALE
        )
        self._levers = rig.motor_levers
        self._inverse = np.linalg.pinv(self._levers)

    def moved(self, setpoint: np.ndarray) -> np.ndarray:
        """Simulate one tick, at whose end the motors' setpoint is `setpoint` (3, 4).

        Returns
        -------
        (2, 4)
            Travel [m] and acceleration [m/s2] that the sensors of the motors measure at the end of
            the tick.
        """
        requested = (setpoint @ self._inverse.T).ravel()
        after = self._tick @ np.concatenate([self._state, self._last, requested])
        self._state, self._last = after[:STATE], requested
        missed = after[[0, 1, 2, -3, -2, -1]] - requested[[0, 1, 2, 6, 7, 8]]
        return np.asarray(setpoint[::2] + missed.reshape(2, 3) @ self._levers.T)


def _state_after_tick(rig: Rig, tick_s: float, before: np.ndarray) -> np.ndarray:
    """Return the state of the plate (10,) one tick later, followed by its acceleration (3,).
    `before` contains the present state, and the setpoints at the start and the end of the tick."""
    pose, twist, force = before[:3], before[3:6], before[6:STATE]
    ends = before[STATE:].reshape(2, 3, 3)
    times = np.array([0.0, tick_s])
    command = PlateMotion(times, quintic_pieces(times, ends[:, 0], ends[:, 1], ends[:, 2]))
    motion, end = realise(rig, PlateState(pose, twist, force), command)
    return np.concatenate([end.pose, end.twist, end.force, motion.accel(tick_s)[0]])
