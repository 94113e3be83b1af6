"""The planner's request for the next cycle: a mean force or a target for each part.

The solver computes a cycle from a `CycleRequest`. The request contains the parts and `Forces` or
`Targets`. If the planner knows the state of the parts and the plate at the start of the cycle, the
request also contains this state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import PlateError
from .parts import Parts, filled

CYCLE_S = 0.1
"""Default cycle length [s]."""


@dataclass(frozen=True)
class Forces:
    """Requested mean forces on M parts over one cycle. The paper also uses requested forces.

    A mean force F over a cycle of length T changes the drift of a part of mass m by F T/m. A mean
    torque N changes the spin of a part with the moment of inertia J by N T/J.

    Attributes
    ----------
    force : (M, 2)
        Centre of the accepted interval [N, plate_home].
    tolerance : (M, 2)
        Half width of the accepted interval [N]. All forces inside the interval are equally good.
    torque : (M,)
        Mean torque [N m]. 0: all rotations are equally good.
    period : float
        Length T of the cycle [s].
    """

    force: np.ndarray
    tolerance: np.ndarray
    torque: np.ndarray
    period: float


@dataclass(frozen=True)
class AngleTargets:
    """Requested angles of M parts at the end of this cycle or of a later cycle.

    Attributes
    ----------
    low, high : (M,)
        Bounds of the accepted interval [rad]. All angles inside the interval are equally good. The
        bounds differ from the part's angle by at most half a turn.
    weight : (M,)
        Position error that costs as much as an angle error of one radian [m]. 0: all angles are
        equally good.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Targets:
    """Requested positions of M parts at the end of this cycle or of a later cycle.

    Each cycle minimises the sum of the squared weighted distances to the targets.

    Attributes
    ----------
    low, high : (M, 2)
        Bounds of the accepted interval along x and y [m, plate_home]. All positions inside the
        interval are equally good.
    weight : (M, 2)
        Weight of the remaining distance along x and y [-]. 0: all positions along this axis are
        equally good. A violation of the clearance to an edge or to another part has the weight 1.
    gap_m : float
        Minimum clearance between any two parts, each modelled as a disc about its centre [m].
    angles : AngleTargets or None
        Requested angles. None if no angles are requested.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    gap_m: float = 0.0
    angles: AngleTargets | None = None


@dataclass(frozen=True)
class CycleRequest:
    """The planner's request for the next cycle.

    Attributes
    ----------
    parts : Parts
        The M parts for which forces or targets are requested.
    forces : Forces
        Requested forces, if `targets` is None. If `targets` is given, the solver ignores the
        forces. Forces of a request with targets point towards these targets, and are only displayed
        (markers, the page, recordings).
    targets : Targets or None
        Requested targets. None if forces are requested.
    start : (M, 4) or None
        Position and velocity of each part at the start of the cycle [m, m/s]. None if unknown. If
        `start` is None, `parts` is the state in an image, and the solver predicts the state at the
        start of the cycle.
    plate : (3, 3) or None
        Pose, twist and acceleration of the plate at the start of the cycle, in the form of
        `PlateCycle.state`. None if this state is uncertain. If `plate` is None, the cycle starts at
        rest at home.
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
    ) -> CycleRequest:
        """Build a request. Omitted forces, tolerances and torques are zero.

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
        return cls(parts, forces, targets, start, None if plate is None else _plate_state(plate))

    @property
    def forces_or_targets(self) -> Forces | Targets:
        """The targets of the request, or its forces if it has no targets."""
        return self.forces if self.targets is None else self.targets


def _plate_state(plate: np.ndarray) -> np.ndarray:
    state = np.array(plate, float)
    if state.shape != (3, 3) or not np.all(np.isfinite(state)):
        raise PlateError(
            f"plate is {state.tolist()}, allowed: 3 x 3 finite numbers (pose, twist, acceleration)"
        )
    return state
