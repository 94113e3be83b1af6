"""The parts' world: its state, and pure steps from one plate cycle to the next."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PlateCycle, PlateError, Rig
from plate_core.tasks import Scenario, start_positions

from .contacts import INELASTIC, Contacts
from .friction import Trajectory, friction_accel, pairs
from .ground import LEVEL, Ground
from .ladder import Choice, check_model, climb
from .models import AUTO, Outcome, Scene, run_model
from .plate_motion import PlateMotion


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
    angle, spin : (M,)
        [rad] (not wrapped), [rad/s]; counter-clockwise, zero if left out.
    choice : Choice or None
        Model by which the last cycle was run, and why; None before the first.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    on_plate: np.ndarray
    angle: np.ndarray = field(default_factory=lambda: np.zeros(0))
    spin: np.ndarray = field(default_factory=lambda: np.zeros(0))
    choice: Choice | None = None

    def __post_init__(self) -> None:
        for name in ("angle", "spin"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(len(self.ids)))

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
        state = cls.at_rest(ids, position)
        if not scenario.marked:
            return state
        return replace(state, angle=rng.uniform(-np.pi, np.pi, len(ids)))

    @property
    def dropped(self) -> int:
        """How many parts have left the plate."""
        return int(np.count_nonzero(~self.on_plate))


def run_cycle(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float | None = None,
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
    ground: Ground = LEVEL,
    model: str = AUTO,
) -> WorldState:
    """Return the state after a plate cycle.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate; only a PlateCycle can be repeated.
    mu : float or (M,), optional
        True friction coefficient, of all parts or of each; the rig's if missing.
    step : float, optional
        Longest integration step [s]; if missing, the model's own.
    contacts : Contacts
        How parts touch each other, and whether walls keep them on the plate.
    cycles : int
        How often the cycle is run.
    ground : Ground
        Static friction and tilt.
    model : str
        `points`, `discs`, `bodies`, or `auto`: the cheapest of them that will do (`ladder`), chosen
        anew for each cycle. Points and discs keep their angles; with `auto` these turn as far as
        friction turns a disc.

    Raises
    ------
    PlateError
        If a state is not finite, parts overlap at the start, or a coefficient, count or name is out
        of range.
    """
    return _advance(state, cycle, rig, mu, step, contacts, cycles, ground, model, False)[0]


def record_cycle(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float | None = None,
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
    ground: Ground = LEVEL,
    model: str = AUTO,
) -> tuple[WorldState, Trajectory]:
    """Return what `run_cycle` does, and the motion at every step of the model used."""
    state, runs = _advance(state, cycle, rig, mu, step, contacts, cycles, ground, model, True)
    starts = [k * cycle.period for k in range(cycles)]
    # A cycle's last sample is the next one's first.
    time, position, velocity = (
        np.concatenate([part[:-1] for part in parts] + [parts[-1][-1:]])
        for parts in (
            [run.time + start for run, start in zip(runs, starts, strict=True)],
            [run.position for run in runs],
            [run.velocity for run in runs],
        )
    )
    return state, Trajectory(time, position, velocity)


def _advance(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None,
    step: float | None,
    contacts: Contacts,
    cycles: int,
    ground: Ground,
    model: str,
    record: bool,
) -> tuple[WorldState, list[Trajectory]]:
    if step is not None and not step > 0:
        raise PlateError(f"step is {step!r} s, allowed: more than 0")
    if cycles < 1:
        raise PlateError(f"cycles is {cycles!r}, allowed: at least 1")
    if cycles > 1 and not isinstance(cycle, PlateCycle):
        raise PlateError(f"cycles is {cycles!r}, allowed: 1 for a PlateMotion: it need not close")
    check_model(model)
    count, gravity = len(state.ids), rig.friction.gravity
    limit = friction_accel(rig.friction.mu if mu is None else mu, gravity, count)
    pull, half = ground.pull(gravity), rig.plate.half
    runs = []
    for _ in range(cycles):
        scene = Scene(
            state.ids, cycle, limit, pull, ground.static_ratio, rig.parts.radius_m, half, contacts,
            step, **{name: _checked(name, getattr(state, name), count) for name in _MOVING},
            on_plate=_on_plate(state.on_plate, count),
        )  # fmt: skip
        outcome, choice = _run(scene, model, record)
        state = WorldState(
            state.ids, outcome.position, outcome.velocity, outcome.on_plate, outcome.angle,
            outcome.spin, choice,
        )  # fmt: skip
        runs.append(outcome.run)
    return state, runs


def _run(scene: Scene, model: str, record: bool) -> tuple[Outcome, Choice]:
    if model == AUTO:
        return climb(scene, record)
    return run_model(scene, model, 0.0 if record else None), Choice(model, "as asked for")


_MOVING = {"position": (2,), "velocity": (2,), "angle": (), "spin": ()}
"""What moves, and its shape for one part."""


def _checked(name: str, array: np.ndarray, count: int) -> np.ndarray:
    """Return a float copy; values of position and velocity are checked where they are used."""
    array = np.array(array, dtype=float, order="C")
    shape = (count, *_MOVING[name])
    if array.shape != shape:
        raise PlateError(f"{name} has shape {array.shape}, allowed: {shape}")
    if array.ndim == 1 and not np.isfinite(array).all():
        raise PlateError(f"{name} has values that are not finite: {array.tolist()}")
    return array


def _on_plate(array: np.ndarray, count: int) -> np.ndarray:
    array = np.array(array, dtype=bool)
    if array.shape != (count,):
        raise PlateError(f"on_plate has shape {array.shape}, allowed: ({count},)")
    return array
