"""The planner's request for the next cycle: of each part a mean force, or a target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import PlateError
from .parts import Parts, filled

CYCLE_S = 0.1
"""Length of a cycle where none is given [s]."""


@dataclass(frozen=True)
class Forces:
    """Requested mean forces on M parts over one cycle, the request of the paper.

    A mean force F over a cycle of length T changes the drift of a part of mass m by F T/m, and a
    mean torque N that of its spin by N T/J, with its moment of inertia J.

    Attributes
    ----------
    force : (M, 2)
        Middle of the interval [N, plate_home].
    tolerance : (M, 2)
        Half width of the interval: every force within it is as good [N].
    torque : (M,)
        Mean torque [N m]; 0: any rotation is as good.
    period : float
        Length T of that cycle [s].
    """

    force: np.ndarray
    tolerance: np.ndarray
    torque: np.ndarray
    period: float


@dataclass(frozen=True)
class AngleTargets:
    """Requested angles of M parts, for the end of this cycle or of a later one.

    Attributes
    ----------
    low, high : (M,)
        Interval: every angle within it is as good [rad]. Within half a turn of the part's angle.
    weight : (M,)
        Error that counts as much as one radian of missing rotation [m]; 0: any angle is as good.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Targets:
    """Requested places of M parts, for the end of this cycle or of a later one.

    Each cycle minimises the sum of the squared weighted distances to the targets.

    Attributes
    ----------
    low, high : (M, 2)
        Interval along x and y: every place within it is as good [m, plate_home].
    weight : (M, 2)
        Weight of a metre to go along x and y [-]; a metre by which a part is too near to an edge
        or to another part has weight 1. 0: any place along this axis is as good.
    gap_m : float
        Minimum clearance of any two parts, each taken for a disc about its centre [m].
    angles : AngleTargets or None
        Requested angles; None: no angle is requested.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    gap_m: float = 0.0
    angles: AngleTargets | None = None


@dataclass(frozen=True)
class Wanted:
    """The planner's request for the next cycle.

    Attributes
    ----------
    parts : Parts
        The M parts of the request.
    forces : Forces
        The request, if `targets` is None. Else information for people (markers, the page,
        recordings): forces that lead the parts towards their targets.
    targets : Targets or None
        The request; None: forces are requested.
    start : (M, 4) or None
        Position and velocity of each part when the cycle begins [m, m/s]. None: unknown; then
        `parts` are as an image showed them, and the solver predicts their state.
    plate : (3, 3) or None
        Pose, twist and acceleration of the plate when the cycle begins, as `PlateCycle.state`
        returns them. None: not known for certain; then the cycle begins at rest at home.
    """

    parts: Parts
    forces: Forces
    targets: Targets | None = None
    start: np.ndarray | None = None
    plate: np.ndarray | None = None

    @classmethod
    def make(
        cls,
        parts: Parts,
        force: np.ndarray | None = None,
        tolerance: np.ndarray | None = None,
        torque: np.ndarray | None = None,
        period: float = CYCLE_S,
        start: np.ndarray | None = None,
        targets: Targets | None = None,
        plate: np.ndarray | None = None,
    ) -> Wanted:
        """Build a request; missing forces, tolerances and torques are zero.

        Raises
        ------
        PlateError
            If an array has another shape, or the plate's state is not finite.
        """
        pair, single = (len(parts), 2), (len(parts),)
        forces = Forces(
            filled("force", force, pair),
            filled("tolerance", tolerance, pair),
            filled("torque", torque, single),
            period,
        )
        start = None if start is None else filled("start", start, (len(parts), 4))
        return cls(parts, forces, targets, start, None if plate is None else _state(plate))

    @property
    def request(self) -> Forces | Targets:
        """The request: targets if there are any, else forces."""
        return self.forces if self.targets is None else self.targets


def _state(plate: np.ndarray) -> np.ndarray:
    state = np.array(plate, float)
    if state.shape != (3, 3) or not np.all(np.isfinite(state)):
        raise PlateError(f"plate is {state.tolist()}, allowed: (3, 3), finite")
    return state
