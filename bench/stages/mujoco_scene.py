"""Baseline of the simulator: the same scenes in MuJoCo.

A plate that moves as a mocap body does not drag parts. Therefore the scene is in the plate's frame,
and gravity contains the negative acceleration of the plate. With contacts between parts and a
plane, the error is several percent at every time step, because a sliding contact also lifts a part.
The best tested model is the dry friction of two slide joints per part, along x and y. This model is
as accurate as pymunk if the plate moves along one of these axes. In other directions friction is
too strong, by up to sqrt(2).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plate_core import PlateCycle

MASS, GRAVITY = 0.02, 9.81
"""Mass of a part [kg], which has no effect on the motion, and gravity [m/s2]."""

POINT_M = 1e-3
"""Radius of parts without collisions [m]. It has no effect."""

SCENE = """<mujoco>
<option timestep="{dt}" gravity="0 0 0" tolerance="1e-12" iterations="50"/>
<default>
<joint type="slide" frictionloss="{loss}" solreffriction="{soft} 1"
  solimpfriction="0.99 0.99 0.001"/>
<geom condim="1" solref="{stiffness} {damping}" solimp="0.99 0.99 0.001" mass="{mass}"/>
</default>
<worldbody>{parts}{walls}</worldbody>
</mujoco>"""

PART = (
    '<body pos="{x} {y} 0"><joint axis="1 0 0"/><joint axis="0 1 0"/>'
    '<geom size="{radius}" contype="{meets}" conaffinity="{meets}"/></body>'
)

WALL = '<geom type="plane" size="1 1 1" pos="{x} {y} 0" zaxis="{i} {j} 0"/>'


class MujocoScene:
    """Parts in the frame of a plate that does not rotate.

    Parameters
    ----------
    cycle : PlateCycle
        Motion of the plate, repeated. The period need not be a multiple of the time step.
    dt, span : float
        Step and time that one `run` simulates [s].
    position, velocity : (M, 2)
        State at the start [m], [m/s], plate_home. Without a velocity, the parts are at rest.
    mu : float
        Friction coefficient.
    radius : float
        Radius of the parts [m]. 0: parts never touch.
    half : (2,), optional
        Half sides of a plate with walls [m]. Contacts stop parts.
    """

    def __init__(
        self, cycle: PlateCycle, dt: float, span: float, position: np.ndarray,
        mu: float, velocity: np.ndarray | None = None, radius: float = 0.0,
        half: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        import mujoco

        meets, size = int(radius > 0), radius or POINT_M
        parts = [PART.format(x=x, y=y, radius=size, meets=meets) for x, y in position]
        walls = []
        if half is not None:
            sides = ((1, 0), (-1, 0), (0, 1), (0, -1))
            walls = [WALL.format(x=-i * half[0], y=-j * half[1], i=i, j=j) for i, j in sides]
        # The stiffest contact that MuJoCo permits has a time constant of two steps.
        text = SCENE.format(
            dt=dt, soft=2 * dt, loss=MASS * GRAVITY * mu, mass=MASS,
            stiffness=-1 / (2 * dt) ** 2, damping=-2 / (2 * dt),
            parts="".join(parts), walls="".join(walls),
        )  # fmt: skip
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.advance = mujoco.mj_step
        self.start = np.array(position, dtype=float)
        twist = cycle.twist((np.arange(round(span / dt) + 1) * dt) % cycle.period)[:, :2]
        self.data.qvel[:] = (np.zeros_like(position) if velocity is None else velocity).ravel()
        self.data.qvel.reshape(-1, 2)[:] -= twist[0]
        # Use the mean acceleration of the plate over each step. The acceleration in the middle of a
        # step causes larger errors.
        self.shake = -np.diff(twist, axis=0) / dt
        self.moved = (cycle.pose(span % cycle.period) - cycle.pose(0.0))[0, :2]

    def run(self) -> np.ndarray:
        """Simulate `span`. Return positions (M, 2) [m], plate_home."""
        for position in self.steps():
            end = position
        return np.asarray(self.start + end + self.moved)

    def trace(self) -> np.ndarray:
        """Simulate `span`. Return positions in the plate's frame after every step (k, M, 2) [m]."""
        return np.array([self.start + position for position in self.steps()])

    def steps(self) -> Iterator[np.ndarray]:
        """Simulate `span`. Yield positions in the plate's frame (M, 2) [m] after every step."""
        for accel in self.shake:
            self.model.opt.gravity[:2] = accel
            self.advance(self.model, self.data)
            yield self.data.qpos.reshape(-1, 2)
