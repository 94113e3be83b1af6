"""How much of the rig's limits a cycle uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rig import Rig
from .cycle import PlateCycle
from .kinematics import motor_state

PIECES = 4
"""Pieces of a knot interval when bounding its peaks: with 6 knots to a sine wave they come out
0.2 % too high, with 3 knots 1 %."""


@dataclass(frozen=True)
class CycleUsage:
    """Peaks of a cycle: motor travel [m], motor speed [m/s], plate acceleration [m/s2], and
    `worst`, the greatest of the three as a share of its limit."""

    stroke_m: float
    speed: float
    accel: float
    worst: float


def usage(rig: Rig, cycle: PlateCycle) -> CycleUsage:
    """Return the peaks of a cycle against the rig's limits.

    They are peaks over the Bezier control points of the motion, which enclose it, so no peak
    between samples is missed (turning enters with its square, which may miss by 3e-4 in a wild
    cycle). The acceleration is that of the plate's corners: it is convex in the point, so no
    point of the plate has more.
    """
    pose, twist, accel = (cycle.control_points(order, PIECES) for order in range(3))
    q, qd, _ = motor_state(rig, pose, twist, accel)
    stroke = float(np.max(np.abs(q)))
    speed = float(np.max(np.abs(qd)))
    peak = float(np.max(corner_accel(rig, pose, twist, accel)))
    worst = max(stroke / rig.limits.stroke_m, speed / rig.limits.speed, peak / rig.limits.accel)
    return CycleUsage(stroke, speed, peak, worst)


def corner_accel(rig: Rig, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray) -> np.ndarray:
    """Magnitude (n, 4) [m/s2] of the acceleration of the plate's corners."""
    cos, sin = np.cos(pose[:, 2:]), np.sin(pose[:, 2:])
    x, y = rig.plate.corners.T
    arm_x, arm_y = cos * x - sin * y, sin * x + cos * y
    spin2, spin_rate = twist[:, 2:] ** 2, accel[:, 2:]
    ax = accel[:, :1] - spin_rate * arm_y - spin2 * arm_x
    ay = accel[:, 1:2] + spin_rate * arm_x - spin2 * arm_y
    return np.hypot(ax, ay)
