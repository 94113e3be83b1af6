"""State of all parts of a run at the start of a plate cycle. A state is never modified. Each change
returns a new state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PlateError, Rig
from plate_core.tasks import Scenario, start_positions

from ..friction.checks import pairs


@dataclass(frozen=True)
class WorldState:
    """State of all parts of a run at the start of a plate cycle.

    Attributes
    ----------
    ids : tuple of str
        True names of the M parts, such as `black_3`.
    position : (M, 2)
        Positions of the centres [m, plate_home]. For a part that left the plate, the position at
        which it left.
    velocity : (M, 2)
        Velocities of the centres [m/s], plate_home.
    on_plate : (M,)
        Whether each part is still on the plate.
    angle, spin : (M,)
        Angles [rad] (not wrapped) and spins [rad/s], counter-clockwise. Default: 0.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    on_plate: np.ndarray
    angle: np.ndarray = field(default_factory=lambda: np.zeros(0))
    spin: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.angle):
            object.__setattr__(self, "angle", np.zeros(len(self.ids)))
        if not len(self.spin):
            object.__setattr__(self, "spin", np.zeros(len(self.ids)))

    @classmethod
    def at_rest(cls, ids: tuple[str, ...], position: np.ndarray) -> WorldState:
        """Return parts at rest at the positions (M, 2) [m, plate_home].

        Raises
        ------
        PlateError
            If the numbers of positions and ids differ, if an id is given twice, or if a position is
            not finite.
        """
        if len(set(ids)) != len(ids):
            raise PlateError(f"part ids are {', '.join(ids)}, allowed: each once")
        position = pairs("position", np.reshape(position, (-1, 2)), len(ids))
        return cls(tuple(ids), position, np.zeros_like(position), np.ones(len(ids), bool))

    @classmethod
    def of_scenario(cls, scenario: Scenario, rig: Rig, rng: np.random.Generator) -> WorldState:
        """Return the parts of a scenario at rest. Their ids are, for example, black_1, black_2 and
        grey_1.

        If the scenario contains no places, the positions are random. The angles are random too,
        unless all parts are round and have no marks.
        """
        labels, position = start_positions(scenario, rig, rng)
        ids = tuple(f"{label}_{labels[:i].count(label) + 1}" for i, label in enumerate(labels))
        state = cls.at_rest(ids, position)
        round_ = all(rig.part_type(label).symmetry == 0 for label in set(labels))
        if round_ and not scenario.marked:
            return state
        return replace(state, angle=rng.uniform(-np.pi, np.pi, len(ids)))

    def take(self, rows: np.ndarray) -> WorldState:
        """Return the state of those parts for which the mask `rows` (M,) is True."""
        ids = tuple(name for name, kept in zip(self.ids, rows, strict=True) if kept)
        return WorldState(
            ids, self.position[rows], self.velocity[rows], self.on_plate[rows], self.angle[rows],
            self.spin[rows],
        )  # fmt: skip

    def joined(self, part_id: str, position: np.ndarray, angle: float) -> WorldState:
        """Return the state with one more part. The new part is at rest at the position `position`
        (2,) [m, plate_home]."""
        return WorldState(
            (*self.ids, part_id), np.vstack([self.position, position]),
            np.vstack([self.velocity, np.zeros(2)]), np.append(self.on_plate, True),
            np.append(self.angle, angle), np.append(self.spin, 0.0),
        )  # fmt: skip

    @property
    def dropped(self) -> int:
        """Number of parts that have left the plate."""
        return int(np.count_nonzero(~self.on_plate))
