"""The parts' world: its state, and pure steps from one plate cycle to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.scenario import Scenario, start_positions

from .contacts import INELASTIC, Contacts, check_found, motion_of, run_discs
from .friction import STEP, Trajectory, default_steps, friction_accel, pairs
from .ground import LEVEL


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
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
) -> WorldState:
    """Return the state after a plate cycle.

    Parameters
    ----------
    mu : float or (M,), optional
        True friction coefficient, of all parts or of each; the rig's if missing.
    step : float
        Longest integration step [s].
    contacts : Contacts
        How parts touch each other, and whether walls keep them on the plate.
    cycles : int
        How often the cycle is run.

    Raises
    ------
    PlateError
        If a state is not finite, parts overlap at the start, or a coefficient or count is out of
        range.
    """
    return _advance(state, cycle, rig, mu, step, contacts, cycles, record=False)[0]


def record_cycle(
    state: WorldState,
    cycle: PlateCycle,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float = STEP,
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
) -> tuple[WorldState, Trajectory]:
    """Return what `run_cycle` does, and the motion at every step."""
    return _advance(state, cycle, rig, mu, step, contacts, cycles, record=True)


def _advance(
    state: WorldState,
    cycle: PlateCycle,
    rig: Rig,
    mu: float | np.ndarray | None,
    step: float,
    contacts: Contacts,
    cycles: int,
    record: bool,
) -> tuple[WorldState, Trajectory]:
    count = len(state.ids)
    if not step > 0:
        raise PlateError(f"step is {step!r} s, allowed: more than 0")
    if cycles < 1:
        raise PlateError(f"cycles is {cycles!r}, allowed: at least 1")
    steps = default_steps(cycle, step)
    limit = friction_accel(rig.friction.mu if mu is None else mu, rig.friction.gravity, count)
    position, velocity = (_rows(name, getattr(state, name), count) for name in _MOVING)
    on_plate = np.array(state.on_plate, dtype=bool)
    if on_plate.shape != (count,):
        raise PlateError(f"on_plate has shape {on_plate.shape}, allowed: ({count},)")
    samples = cycles * steps + 1 if record else 0
    path, speed = np.empty((samples, count, 2)), np.empty((samples, count, 2))
    found = run_discs(
        *motion_of(cycle), steps, cycles, limit, LEVEL.pull(rig.friction.gravity),
        LEVEL.static_ratio, rig.parts.radius_m, rig.plate.half, contacts.restitution,
        contacts.friction, contacts.walls, position, velocity, on_plate, path, speed,
    )  # fmt: skip
    check_found(found, state.ids, rig.parts.radius_m)
    time = np.arange(samples) * (cycle.period / steps)
    return WorldState(state.ids, position, velocity, on_plate), Trajectory(time, path, speed)


_MOVING = ("position", "velocity")


def _rows(name: str, array: np.ndarray, count: int) -> np.ndarray:
    """Return a float copy (count, 2); its values are checked where they are used."""
    array = np.array(array, dtype=float, order="C")
    if array.shape != (count, 2):
        raise PlateError(f"{name} has shape {array.shape}, allowed: ({count}, 2)")
    return array
