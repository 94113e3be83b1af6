"""Baseline of the simulator: the same scene in pymunk."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

MASS = 0.02
"""Mass of a part [kg]. The mass has no effect on the motion."""


class PymunkScene:
    """Parts on a kinematic plate. Friction is modelled by a PivotJoint with limited force, which is
    usual for scenes seen from above.

    Parameters
    ----------
    cycle : PlateCycle
        Motion of the plate, repeated. The period need not be a multiple of the time step.
    dt, span : float
        Step and time that one `run` simulates [s].
    friction_accel : float
        mu g [m/s2].
    radius : float
        Radius of the parts [m]. 0: parts never touch.
    offset : float
        Time within a step, 0 to 1, at which the plate's velocity is evaluated.
    """

    def __init__(
        self, cycle: PlateCycle, dt: float, span: float, position: np.ndarray,
        friction_accel: float, velocity: np.ndarray | None = None, radius: float = 0.0,
        offset: float = 0.5,
    ) -> None:  # fmt: skip
        import pymunk

        self.dt = dt
        self.space = pymunk.Space()
        self.plate = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self.space.add(self.plate)
        self.parts = []
        for i, (x, y) in enumerate(position):
            part = pymunk.Body(MASS, MASS * 1e-4)
            part.position = float(x), float(y)
            if velocity is not None:
                part.velocity = float(velocity[i, 0]), float(velocity[i, 1])
            grip = pymunk.PivotJoint(self.plate, part, (0, 0), (0, 0))
            grip.max_bias, grip.max_force = 0, MASS * friction_accel
            self.space.add(part, grip)
            if radius:
                shape = pymunk.Circle(part, radius)
                shape.friction = shape.elasticity = 0.0
                self.space.add(shape)
            self.parts.append(part)
        t = (np.arange(round(span / dt)) + offset) * dt
        self.twist = [(float(u), float(v)) for u, v in cycle.twist(t % cycle.period)[:, :2]]

    def run(self) -> np.ndarray:
        """Simulate `span`. Return positions (M, 2) [m]."""
        for velocity in self.twist:
            self.plate.velocity = velocity
            self.space.step(self.dt)
        return np.array([tuple(part.position) for part in self.parts])
