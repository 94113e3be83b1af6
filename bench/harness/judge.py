"""An independent judge of what a device commands: all limits, at every tick."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import Rig
from plate_core.motion import plate_state

ROUNDING = 2e-3
"""Share by which a limit may be passed: what the motors' splines may differ from the plate's."""

JUMP_M = 2e-6
"""A setpoint may miss what those around it promise by this much [m]: rounding of the wire."""


@dataclass(frozen=True)
class Verdict:
    """Greatest shares of the rig's limits in any setpoint that was commanded.

    Attributes
    ----------
    stroke, speed, force : float
        Of the motors.
    accel : float
        Of the motors, and of the plate's corners.
    jump : float
        Greatest difference of two setpoints from what their speeds say [m].
    travel : float
        Of the stroke, by the plate as it really moved, without current too.
    """

    stroke: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    force: float = 0.0
    jump: float = 0.0
    travel: float = 0.0

    @property
    def worst(self) -> float:
        """Greatest share of any limit."""
        return max(self.stroke, self.speed, self.accel, self.force, self.travel)

    @property
    def kept(self) -> bool:
        """Whether all limits were kept, and nothing jumped."""
        return bool(self.worst <= 1 + ROUNDING and self.jump < JUMP_M)


@dataclass
class Watch:
    """Notes every setpoint; the verdict comes at the end."""

    rig: Rig
    _seen: list[tuple[float, np.ndarray]] = field(default_factory=list)
    _travel: float = 0.0

    def see(self, now: float, at: np.ndarray | None) -> None:
        """Note a setpoint (3, 4) at a time [s]: position, speed, acceleration; None: no current."""
        if at is not None:
            self._seen.append((now, at))

    def moved(self, travel: np.ndarray) -> None:
        """Note where the motors (4,) really are [m]."""
        self._travel = max(self._travel, float(np.max(np.abs(travel))))

    def verdict(self) -> Verdict:
        """Judge what was seen."""
        limits = self.rig.limits
        travel = self._travel / limits.stroke_m
        if not self._seen:
            return Verdict(travel=travel)
        times = np.array([now for now, _ in self._seen])
        q, qd, qdd = np.array([at for _, at in self._seen], float).transpose(1, 0, 2)
        # With infinite tolerance: whether the four agree is not asked here.
        pose, twist, accel = plate_state(self.rig, q, qd, qdd, np.inf)
        return Verdict(
            float(np.max(np.abs(q))) / limits.stroke_m,
            float(np.max(np.abs(qd))) / limits.speed,
            max(float(np.max(np.abs(qdd))), self._corners(pose, twist, accel)) / limits.accel,
            float(np.max(np.abs(self._forces(accel)))) / limits.force,
            _jump(times, q, qd, qdd),
            travel,
        )

    def _corners(self, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray) -> float:
        """Greatest acceleration of the plate's corners [m/s2]."""
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        worst = 0.0
        for x, y in self.rig.plate.half * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]):
            ax, ay = cos * x - sin * y, sin * x + cos * y
            size = np.hypot(
                accel[:, 0] - accel[:, 2] * ay - twist[:, 2] ** 2 * ax,
                accel[:, 1] + accel[:, 2] * ax - twist[:, 2] ** 2 * ay,
            )
            worst = max(worst, float(np.max(size)))
        return worst

    def _forces(self, accel: np.ndarray) -> np.ndarray:
        """Forces (n, 4) [N] of least norm that accelerate the plate."""
        plate = self.rig.plate
        inertia = plate.mass_kg * (plate.length_m**2 + plate.width_m**2) / 12
        pushes = []
        for motor in self.rig.motors:
            (x, y), (dx, dy) = motor.point, motor.direction
            pushes.append([dx, dy, x * dy - y * dx])
        need = accel * [plate.mass_kg, plate.mass_kg, inertia]
        return np.linalg.lstsq(np.array(pushes).T, need.T, rcond=None)[0].T


def _jump(times: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> float:
    """Greatest miss [m] of Hermite's rule from a tick to the next; pauses without current aside."""
    dt = np.diff(times)
    step = dt[:, None] * (qd[1:] + qd[:-1]) / 2 - dt[:, None] ** 2 * (qdd[1:] - qdd[:-1]) / 12
    miss = np.abs(np.diff(q, axis=0) - step)[dt < 1.5 * np.min(dt, initial=np.inf)]
    return float(np.max(miss, initial=0.0))
