"""Pure functions that compute the state of the parts after a plate cycle.

`run_cycle` returns the next state, `record_cycle` also returns the motion of the parts, and
`run_together` returns the next states on several plates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plate_core import PlateCycle, PlateError, Rig, part_class

from ..contacts import INELASTIC, Contacts
from ..friction.checks import friction_accel
from ..friction.outline import footprint_of
from ..plate import LEVEL, Ground, PlateMotion
from .bodies import COLUMNS, STEP, BodyTrajectory, Shapes, check_starts, equal_steps, run_plates
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
) -> WorldState:
    """Return the state of the parts after a plate cycle.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate. Only a PlateCycle can be repeated.
    mu : float or (M,), optional
        True friction coefficient: one number for all parts, or one number for each part. Default:
        the coefficients of the parts' types.
    step : float
        Maximum integration step [s].
    contacts : Contacts
        Contact parameters of the parts, and whether walls keep the parts on the plate.
    cycles : int
        Number of cycles.

    Raises
    ------
    PlateError
        If a state is not finite, if parts overlap at the start, or if a coefficient or count is out
        of range.
    """
    return _run_cycles(state, cycle, rig, mu, step, contacts, cycles, 0)[0]


def record_cycle(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None = None,
    step: float = STEP,
    *,
    contacts: Contacts = INELASTIC,
    cycles: int = 1,
) -> tuple[WorldState, BodyTrajectory]:
    """Return the same state as `run_cycle`, and the motion of the parts with one sample per
    integration step."""
    after, (path,) = _run_cycles(state, cycle, rig, mu, step, contacts, cycles, 1)
    return after, path


def _run_cycles(
    state: WorldState,
    cycle: PlateCycle | PlateMotion,
    rig: Rig,
    mu: float | np.ndarray | None,
    step: float,
    contacts: Contacts,
    cycles: int,
    every: int,
) -> tuple[WorldState, list[BodyTrajectory]]:
    if cycles < 1:
        raise PlateError(f"cycles is {cycles!r}, allowed: at least 1")
    labels = [part_class(name) for name in state.ids]
    types = {label: rig.part_type(label) for label in dict.fromkeys(labels)}
    footprints = {label: footprint_of(part) for label, part in types.items()}
    if mu is None:
        mu = np.array([types[label].mu for label in labels], dtype=float)
    limit = friction_accel(mu, rig.friction.gravity, len(labels))
    (after,), paths = run_together(
        [state], [cycle], Shapes.of([footprints[label] for label in labels]), [limit], rig,
        contacts, [LEVEL], step=step, cycles=cycles, every=every,
    )  # fmt: skip
    return after, paths


def run_together(
    states: Sequence[WorldState],
    motions: Sequence[PlateCycle | PlateMotion],
    shapes: Shapes,
    limits: Sequence[np.ndarray],
    rig: Rig,
    contacts: Contacts,
    grounds: Sequence[Ground],
    threads: int = 1,
    *,
    step: float = STEP,
    cycles: int = 1,
    every: int = 0,
) -> tuple[list[WorldState], list[BodyTrajectory]]:
    """Compute `run_cycle` for the same parts on many plates in one call. Return the states and the
    motions of the parts. The motions contain one sample for each group of `every` integration
    steps. If `every` is 0, no motions are returned.

    Parameters
    ----------
    shapes : Shapes
        Shapes of the M parts on each plate.
    limits : sequence of (M,)
        mu g of the parts on each plate [m/s2].
    threads : int
        Number of threads.
    """
    ids, gravity = states[0].ids, rig.friction.gravity
    moved = check_starts([(s.position, s.angle, s.velocity, s.spin) for s in states])
    on_plates = np.array([s.on_plate for s in states], bool)
    if on_plates.shape != moved.shape[:2]:
        raise PlateError(f"on_plate has shape {on_plates.shape[1:]}, allowed: ({len(ids)},)")
    steps = [equal_steps(motion.period, step) for motion in motions]
    # Usually all plates refer to the same ground object. The effect of each object is computed
    # once. Comparing object identities is faster than comparing values.
    effect = {key: g.effect(gravity) for key, g in {id(g): g for g in grounds}.items()}
    records = run_plates(
        motions, steps, shapes, moved, on_plates, np.array(limits),
        [effect[id(g)] for g in grounds], contacts, rig.plate.half, cycles, every, ids, threads,
    )  # fmt: skip
    position, angle, velocity, spin = (
        np.ascontiguousarray(moved[..., columns]) for columns in COLUMNS
    )
    after = [
        WorldState(ids, *arrays)
        for arrays in zip(position, velocity, on_plates, angle, spin, strict=True)
    ]
    if not every:
        return after, []
    return after, [
        BodyTrajectory.recorded(record, motion.period / n * every, on_plate)
        for record, motion, n, on_plate in zip(records, motions, steps, on_plates, strict=True)
    ]
