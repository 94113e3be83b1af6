"""Steering of parts that are to turn: displacement and turn over one cycle, together (3.1.2).

An error of turn counts as the arc that it makes at the part's rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle

from .disc_map import POINTS, end_disc, end_disc_gradient


@dataclass(frozen=True)
class Turns:
    """What one cycle is to do with the angles of M round parts.

    Attributes
    ----------
    spin : (M,)
        At the start of the cycle [rad/s].
    wanted : (M,)
        Turn over the cycle [rad]; NaN where any will do.
    radius : float
        Of the parts [m].
    """

    spin: np.ndarray
    wanted: np.ndarray
    radius: float

    @property
    def asked(self) -> np.ndarray:
        """Which parts (M,) are to turn."""
        return np.isfinite(self.wanted)

    @property
    def count(self) -> int:
        """How many are to turn."""
        return int(np.count_nonzero(self.asked))

    @property
    def points(self) -> np.ndarray:
        """Points (k, 2) of a part [m]."""
        return np.asarray(self.radius * POINTS)

    @property
    def arc(self) -> np.ndarray:
        """What is asked, as ways of the rims (Q,) [m]."""
        return np.asarray(self.radius * self.wanted[self.asked])

    def times(self, share: float) -> Turns:
        """Return a share of what is asked."""
        return Turns(self.spin, share * self.wanted, self.radius)

    def rows(self) -> np.ndarray:
        """Rows of `end_disc_gradient` that count: all places, then the turns that are asked."""
        first = 3 * np.arange(len(self.wanted))
        places = np.column_stack([first, first + 1]).ravel()
        return np.concatenate([places, first[self.asked] + 2])


State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Position, velocity, pose, twist, dt (n,) and friction's acceleration, as of `end_disc`."""


def ends(turns: Turns, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return end places (M, 2) [m] and errors of turn (Q,) [m] after a sampled motion."""
    position, velocity, pose, twist, dt, accel = state
    end, _, turn, _ = end_disc(position, velocity, turns.spin, pose, twist, dt, accel, turns.points)
    return end, turns.radius * (turns.wanted - turn)[turns.asked]


def slopes(turns: Turns, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of end places and of the turns asked, as ways of the rims.

    Returns
    -------
    by_pose, by_twist : (2 M + Q, n, 3)
    by_dt : (2 M + Q, n)
    """
    rows = turns.rows()
    scale = np.where(np.arange(len(rows)) < 2 * len(turns.wanted), 1.0, turns.radius)
    position, velocity, pose, twist, dt, accel = state
    every = end_disc_gradient(position, velocity, turns.spin, pose, twist, dt, accel, turns.points)
    by_pose, by_twist, by_dt = (array[rows] for array in every)
    return by_pose * scale[:, None, None], by_twist * scale[:, None, None], by_dt * scale[:, None]


def after_discs(
    cycle: PlateCycle,
    position: np.ndarray,
    velocity: np.ndarray,
    spin: np.ndarray,
    radius: float,
    friction_accel: np.ndarray,
    step: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Predict position, velocity (M, 2), turn and spin (M,) after a cycle, in steps of `step`."""
    steps = max(1, round(cycle.period / step))
    dt = cycle.period / steps
    t = (np.arange(steps) + 0.5) * dt
    return end_disc(
        position, velocity, spin, cycle.pose(t), cycle.twist(t), np.full(steps, dt), friction_accel,
        radius * POINTS,
    )  # fmt: skip
