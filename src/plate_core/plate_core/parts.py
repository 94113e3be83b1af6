"""The parts on the plate, and what is wanted of them, as they travel from stage to stage."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from .errors import PlateError

CYCLE_S = 0.1
"""Length of a cycle where none is given [s]."""

MOST_PARTS = 100
"""In a scenario, and in one request: a thousand keep the solver busy for three seconds."""


class OverlookedThing(NamedTuple):
    """A thing that vision sees and does not take for a part: centre x, y [m, plate_home], radius
    of the disc of the same area [m], and the reason in words."""

    x: float
    y: float
    radius: float
    reason: str


@dataclass(frozen=True)
class Parts:
    """Parts in plate_home at one instant.

    Attributes
    ----------
    ids : tuple of str
        Such as `black_3`: class and number.
    position : (M, 2)
        Centres [m].
    velocity : (M, 2)
        Drift over the last cycles [m/s].
    angle : (M,)
        Orientation [rad], counter-clockwise.
    spin : (M,)
        Turning over the last cycles [rad/s].
    friction_limit : (M,)
        Greatest friction on it [N], mu m g; 0 where no more is known than the rig's facts.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    friction_limit: np.ndarray

    @classmethod
    def make(
        cls,
        ids: tuple[str, ...],
        position: np.ndarray,
        velocity: np.ndarray | None = None,
        angle: np.ndarray | None = None,
        spin: np.ndarray | None = None,
        friction_limit: np.ndarray | None = None,
    ) -> Parts:
        """Build it; what is missing is zero.

        Raises
        ------
        PlateError
            If an array has another shape, or the plate's state is not finite.
        """
        pair, single = (len(ids), 2), (len(ids),)
        return cls(
            tuple(ids),
            _filled("position", position, pair),
            _filled("velocity", velocity, pair),
            _filled("angle", angle, single),
            _filled("spin", spin, single),
            _filled("friction_limit", friction_limit, single),
        )

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, rows: np.ndarray | list[int]) -> Parts:
        """Return the parts in these rows (K,)."""
        index = np.array(rows, dtype=int)
        arrays = [getattr(self, field.name)[index] for field in fields(self)[1:]]
        return Parts(tuple(self.ids[i] for i in index), *arrays)


@dataclass(frozen=True)
class AngleTargets:
    """Which angles M parts are to come to, by one cycle or by many.

    Attributes
    ----------
    low, high : (M,)
        Anywhere between is as good [rad]; within half a turn of the angle that a part has.
    weight : (M,)
        What a radian of the way there counts [m]; 0: nothing is asked.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Targets:
    """Where M parts are to come, by one cycle or by many.

    Each cycle is to be the one that leaves least of the squared weighted ways to the targets.

    Attributes
    ----------
    low, high : (M, 2)
        Anywhere between, along x and y, is as good [m, plate_home].
    weight : (M, 2)
        What a metre of way counts, beside one by which a part is too near to an edge or to another
        part [-]; 0: nothing is asked.
    gap_m : float
        Least distance of the rims of any two parts, each taken for a disc about its centre [m].
    angles : AngleTargets or None
        And what is to become of their angles; None: nothing is asked.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    gap_m: float = 0.0
    angles: AngleTargets | None = None


@dataclass(frozen=True)
class Wanted:
    """What is wanted of parts over the next cycle.

    Attributes
    ----------
    parts : Parts
        The parts in question, M of them.
    force : (M, 2)
        Mean force over a cycle [N]; zero where nothing is asked.
    tolerance : (M, 2)
        Any force within +-tolerance [N] of `force` is as good.
    torque : (M,)
        Mean torque over a cycle [N m]; zero where any turning will do.
    period : float
        Length of that cycle, T [s]: a force F changes the drift of a part by F T/m.
    start : (M, 4) or None
        Where each part is when that cycle begins, and its velocity then [m, m/s]; None: not known,
        `parts` are as an image showed them, and the solver predicts it.
    targets : Targets or None
        Where the parts are to come: asked in place of the forces, which then say which way that
        leads them. None: forces are asked.
    plate : (3, 3) or None
        Pose, twist and acceleration of the plate when that cycle begins, as `PlateCycle.state`
        gives them; None: not known for certain, and the cycle is to begin at rest at home.
    """

    parts: Parts
    force: np.ndarray
    tolerance: np.ndarray
    torque: np.ndarray
    period: float
    start: np.ndarray | None = None
    targets: Targets | None = None
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
        """Build it; what is missing is zero, but for the period.

        Raises
        ------
        PlateError
            If an array has another shape, or the plate's state is not finite.
        """
        pair, single = (len(parts), 2), (len(parts),)
        return cls(
            parts,
            _filled("force", force, pair),
            _filled("tolerance", tolerance, pair),
            _filled("torque", torque, single),
            period,
            None if start is None else _filled("start", start, (len(parts), 4)),
            targets,
            None if plate is None else _state(plate),
        )


def _state(plate: np.ndarray) -> np.ndarray:
    state = np.array(plate, float)
    if state.shape != (3, 3) or not np.all(np.isfinite(state)):
        raise PlateError(f"plate is {state.tolist()}, allowed: (3, 3), finite")
    return state


def part_class(part_id: str) -> str:
    """Return the class of a part id: `black` of `black_3`."""
    return part_id.rsplit("_", 1)[0]


def _filled(name: str, array: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    if array is None:
        return np.zeros(shape)
    values = np.array(array, float)
    if values.shape[:1] != shape[:1] or values.size != np.prod(shape):
        raise PlateError(f"{name} has shape {values.shape}, allowed: {shape}, a row for each part")
    return values.reshape(shape)
