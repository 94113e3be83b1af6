"""The simulator's other peer: the same scenes in MuJoCo.

A plate moved as a mocap body drags nothing. So the scene is the plate's frame, under a gravity that
shakes. Parts on a plane err by several percent at every step, as a contact that slides also lifts
them. Best of what was tried is the dry friction of two slide joints in each part: as good as pymunk
where the plate moves along one joint, else too strong across, by up to a root of two.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plate_core import PlateCycle

MASS, GRAVITY = 0.02, 9.81
"""Of a part [kg], which drops out of the motion; [m/s2]."""

POINT_M = 1e-3
"""Radius of parts that never meet [m]: of no effect."""

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
    """Parts in the plate's frame; the plate does not turn.

    Parameters
    ----------
    cycle : PlateCycle
        Motion of the plate, repeated. Steps need not fit the period: the scene runs freely.
    dt, span : float
        Step and time that one `run` simulates [s].
    position, velocity : (M, 2)
        At the start [m], [m/s], plate_home; at rest if no velocity is given.
    mu : float
        Friction coefficient.
    radius : float
        Of the parts [m]; 0 means that they never touch.
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
        # The stiffest that MuJoCo takes is a time constant of two steps.
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
        # The mean over a step: at its middle, errors are larger.
        self.shake = -np.diff(twist, axis=0) / dt
        self.moved = (cycle.pose(span % cycle.period) - cycle.pose(0.0))[0, :2]

    def run(self) -> np.ndarray:
        """Advance; returns positions (M, 2) [m], plate_home."""
        for place in self.steps():
            end = place
        return np.asarray(self.start + end + self.moved)

    def trace(self) -> np.ndarray:
        """Advance; returns places after every step (k, M, 2), in the plate."""
        return np.array([self.start + place for place in self.steps()])

    def steps(self) -> Iterator[np.ndarray]:
        """Advance; yields how far the parts are in the plate (M, 2) [m] after every step."""
        for accel in self.shake:
            self.model.opt.gravity[:2] = accel
            self.advance(self.model, self.data)
            yield self.data.qpos.reshape(-1, 2)
