"""Pure steps of the parts' world from one plate cycle to the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plate_core import PlateCycle, PlateError, Rig, part_class

from .. import _kernels
from ..contacts import INELASTIC, Contacts
from ..friction.checks import friction_accel
from ..friction.footprint import Footprint
from ..friction.outline import footprint_of
from ..plate import LEVEL, Ground, PlateMotion
from .bodies import STEP, BodyTrajectory, equal_steps, job_of
from .state import WorldState


def run_cycle(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float = STEP,
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
    ground: Ground = LEVEL,
) -> WorldState:
    """Return the state after a plate cycle.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate; only a PlateCycle can be repeated.
    mu : float or (M,), optional
        True friction coefficient, of all parts or of each; that of their types if missing.
    step : float
        Longest integration step [s].
    contacts : Contacts
        How parts touch each other, and whether walls keep them on the plate.
    cycles : int
        How often the cycle is run.
    ground : Ground
        Static friction, friction that changes with the slip, and tilt.

    Raises
    ------
    PlateError
        If a state is not finite, parts overlap at the start, or a coefficient or count is out of
        range.
    """
    return _run(state, cycle, rig, mu, step, contacts, cycles, ground, 0)[0]


def record_cycle(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float = STEP,
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
    ground: Ground = LEVEL,
) -> tuple[WorldState, BodyTrajectory]:
    """Return what `run_cycle` does, and the motion at every step."""
    return _run(state, cycle, rig, mu, step, contacts, cycles, ground, 1)


def _run(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None,
    step: float,
    contacts: Contacts,
    cycles: int,
    ground: Ground,
    every: int,
) -> tuple[WorldState, BodyTrajectory]:
    if cycles < 1:
        raise PlateError(f"cycles is {cycles!r}, allowed: at least 1")
    count, gravity = len(state.ids), rig.friction.gravity
    labels = [part_class(name) for name in state.ids]
    types = {label: rig.part_type(label) for label in dict.fromkeys(labels)}
    footprints = {label: footprint_of(part) for label, part in types.items()}
    if mu is None:
        mu = np.array([types[label].mu for label in labels], dtype=float)
    limit = friction_accel(mu, gravity, count)
    if np.shape(state.on_plate) != (count,):
        raise PlateError(f"on_plate has shape {np.shape(state.on_plate)}, allowed: ({count},)")
    path = job_of(
        cycle, [footprints[label] for label in labels], limit,
        (state.position, state.angle, state.velocity, state.spin), state.on_plate, gravity,
        contacts, ground, rig.plate.half, equal_steps(cycle.period, step), cycles, every, state.ids,
    ).run()  # fmt: skip
    return moved(state, path), path


def moved(state: WorldState, path: BodyTrajectory) -> WorldState:
    """Return the parts at the end of their paths."""
    position, velocity, angle, spin = (
        getattr(path, name)[-1].copy() for name in ("position", "velocity", "angle", "spin")
    )
    return WorldState(state.ids, position, velocity, path.on_plate, angle, spin)


def run_together(
    states: Sequence[WorldState],
    motions: Sequence[PlateCycle | PlateMotion],
    footprints: Sequence[Sequence[Footprint]],
    limits: Sequence[np.ndarray],
    rig: Rig,
    contacts: Contacts,
    grounds: Sequence[Ground],
    threads: int,
) -> list[WorldState]:
    """Return what `run_cycle` does of the parts on many plates, in one call.

    Parameters
    ----------
    footprints, limits : sequences of M Footprints, and of arrays (M,)
        Of the parts on each plate; mu g [m/s2].
    threads : int
        Cores that may work at the same time.
    """
    gravity, half = rig.friction.gravity, rig.plate.half
    jobs = [
        job_of(
            motion, own, limit, (state.position, state.angle, state.velocity, state.spin),
            state.on_plate, gravity, contacts, ground, half, equal_steps(motion.period, STEP), 1, 0,
            state.ids,
        )
        for state, motion, own, limit, ground in zip(
            states, motions, footprints, limits, grounds, strict=True
        )
    ]  # fmt: skip
    found = _kernels.run_many([job.arguments for job in jobs], threads)
    paths = (job.outcome(overlap) for job, overlap in zip(jobs, found, strict=True))
    return [moved(state, path) for state, path in zip(states, paths, strict=True)]
