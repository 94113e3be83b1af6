"""The device's plate on flexures: what its sensors measure, tick by tick."""

from __future__ import annotations

import numpy as np

from plate_core import Rig
from plate_core.motion import quintic_pieces

from ..drive import PlateState
from ..plate_motion import PlateMotion
from ..suspension import realise

STATE, INPUT = 10, 9
"""Pose, twist and the motors' forces; a setpoint of the plate: pose, twist, acceleration."""

SCALE = 1e-6
"""Of the unit motions [m, m/s, ...]: far within what any plate can do."""


class HungPlate:
    """The plate of `plate_sim.drive` in steps of one tick.

    Plate and drive are linear, so a tick is one matrix: found from `realise`, column by column. The
    motors' levers are those at home.

    Parameters
    ----------
    rig : Rig
        With a suspension.
    tick_s : float
        [s].
    """

    def __init__(self, rig: Rig, tick_s: float) -> None:
        self._state = np.zeros(STATE)
        self._last = np.zeros(INPUT)
        columns = np.eye(STATE + 2 * INPUT) * SCALE
        self._tick = np.stack([_after(rig, tick_s, column) for column in columns], 1) / SCALE
        self._levers = np.array(
            [
                [dx, dy, x * dy - y * dx]
                for (x, y), (dx, dy) in ((motor.point, motor.direction) for motor in rig.motors)
            ]
        )
        self._share = np.linalg.pinv(self._levers)

    def moved(self, setpoint: np.ndarray) -> np.ndarray:
        """Let a tick pass, during which the motors are led to a setpoint (3, 4).

        Returns
        -------
        (2, 4)
            Travel [m] and acceleration [m/s2] that the motors' sensors tell at its end.
        """
        wanted = (setpoint @ self._share.T).ravel()
        after = self._tick @ np.concatenate([self._state, self._last, wanted])
        self._state, self._last = after[:STATE], wanted
        missed = after[[0, 1, 2, -3, -2, -1]] - wanted[[0, 1, 2, 6, 7, 8]]
        return np.asarray(setpoint[::2] + missed.reshape(2, 3) @ self._levers.T)


def _after(rig: Rig, tick_s: float, before: np.ndarray) -> np.ndarray:
    """State and acceleration (13,) of the plate a tick after a state, led between two setpoints."""
    pose, twist, force = before[:3], before[3:6], before[6:STATE]
    ends = before[STATE:].reshape(2, 3, 3)
    times = np.array([0.0, tick_s])
    command = PlateMotion(times, quintic_pieces(times, ends[:, 0], ends[:, 1], ends[:, 2]))
    motion, end = realise(rig, PlateState(pose, twist, force), command)
    return np.concatenate([end.pose, end.twist, end.force, motion.accel(tick_s)[0]])
