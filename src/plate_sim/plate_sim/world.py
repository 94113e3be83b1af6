"""The parts' world: its state, and pure steps from one plate cycle to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.scenario import Scenario, start_positions

from .contacts import run_discs
from .friction import STEP, Trajectory, default_steps, friction_accel, pairs, surface_samples


@dataclass(frozen=True)
class WorldState:
    """All parts of a run at the start of a plate cycle.

    Attributes
    ----------
    ids : tuple of str
        True names of the M parts, such as `black_3`.
    position : (M, 2)
        Centres [m], plate_home; of a part that is gone, where it left the plate.
    velocity : (M, 2)
        [m/s], plate_home.
    on_plate : (M,)
        Whether the part is still there.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    on_plate: np.ndarray

    @classmethod
    def at_rest(cls, ids: tuple[str, ...], position: np.ndarray) -> WorldState:
        """Return parts at rest at given places (M, 2) [m, plate_home].

        Raises
        ------
        PlateError
            If there are not as many places as names, a name is given twice, or a place is not
            finite.
        """
        if len(set(ids)) != len(ids):
            raise PlateError(f"part ids are {', '.join(ids)}, allowed: each once")
        position = pairs("position", np.reshape(position, (-1, 2)), len(ids))
        return cls(tuple(ids), position, np.zeros_like(position), np.ones(len(ids), bool))

    @classmethod
    def of_scenario(cls, scenario: Scenario, rig: Rig, rng: np.random.Generator) -> WorldState:
        """Return a scenario's parts at rest, where it says or scattered: black_1, black_2, ..."""
        labels, position = start_positions(scenario, rig, rng)
        ids = tuple(f"{label}_{labels[:i].count(label) + 1}" for i, label in enumerate(labels))
        return cls.at_rest(ids, position)

    @property
    def dropped(self) -> int:
        """How many parts have left the plate."""
        return int(np.count_nonzero(~self.on_plate))


def run_cycle(
    state: WorldState,
    cycle: PlateCycle,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float = STEP,
) -> WorldState:
    """Return the state after one plate cycle.

    Parameters
    ----------
    mu : float or (M,), optional
        True friction coefficient, of all parts or of each; the rig's if missing.
    step : float
        Longest integration step [s].
    """
    return _advance(state, cycle, rig, mu, step, record=False)[0]


def record_cycle(
    state: WorldState,
    cycle: PlateCycle,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float = STEP,
) -> tuple[WorldState, Trajectory]:
    """Return what `run_cycle` does, and the motion at every step of the cycle."""
    return _advance(state, cycle, rig, mu, step, record=True)


def _advance(
    state: WorldState,
    cycle: PlateCycle,
    rig: Rig,
    mu: float | np.ndarray | None,
    step: float,
    record: bool,
) -> tuple[WorldState, Trajectory]:
    count = len(state.ids)
    steps = default_steps(cycle, step)
    pose, twist = surface_samples(cycle, steps)
    limit = friction_accel(rig.friction.mu if mu is None else mu, rig.friction.gravity, count)
    position, velocity = state.position.copy(), state.velocity.copy()
    on_plate = state.on_plate.copy()
    path, speed = (np.empty((steps + 1 if record else 0, count, 2)) for _ in range(2))
    run_discs(
        pose, twist, cycle.period / steps, limit, rig.parts.radius_m, rig.plate.half,
        position, velocity, on_plate, path, speed,
    )  # fmt: skip
    time = np.linspace(0, cycle.period, steps + 1)[: len(path)]
    return WorldState(state.ids, position, velocity, on_plate), Trajectory(time, path, speed)
