"""Simulated hand that places and removes parts.

The hand checks the id, class, position and angle of a part, and returns the new state of all parts.
`Simulation.place` checks for overlaps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plate_core import MAX_PARTS, PlateError, Rig, did_you_mean, part_class
from plate_core.tasks import CLASSES

from .state import WorldState


class Hand:
    """Simulated hand.

    Parameters
    ----------
    rig : Rig
    rng : Generator
        Random number generator for the friction of new parts.
    """

    def __init__(self, rig: Rig, rng: np.random.Generator) -> None:
        self._rig, self._rng = rig, rng

    def put(
        self,
        state: WorldState,
        part_id: str,
        label: str,
        position: np.ndarray,
        angle: float,
        number: Callable[[str], int],
    ) -> tuple[WorldState, str, float | None]:
        """Place a part at rest on the plate. `Simulation.place` describes the parameters that are
        not described here.

        `number` is a function that returns the number for the id of the next part of a class.

        Returns
        -------
        state : WorldState
            State with the placed part. The part may overlap other parts.
        part_id : str
        unit : float or None
            Relative friction of a new part (see `FrictionField.unit`). None for an existing part.

        Raises
        ------
        PlateError
            If there is no part with this id or no such type, no more parts are allowed, or the part
            would be outside the plate.
        """
        label = self._check_part(state, part_id, label, position, angle)
        unit = None
        if not part_id:
            part_id, unit = f"{label}_{number(label)}", self._rng.uniform(-1, 1)
            state = state.joined(part_id, position, 0.0)
        row = np.array([name == part_id for name in state.ids])
        state = replace(
            state,
            position=np.where(row[:, None], position, state.position),
            velocity=np.where(row[:, None], 0.0, state.velocity),
            on_plate=state.on_plate | row,
            angle=np.where(row, np.remainder(angle, 2 * np.pi), state.angle),
            spin=np.where(row, 0.0, state.spin),
        )
        return state, part_id, unit

    def _check_part(
        self, state: WorldState, part_id: str, label: str, position: np.ndarray, angle: float
    ) -> str:
        """Check the id, class, place and angle of a part, and return its class."""
        if part_id:
            check_id(state, part_id)
        kinds = tuple(self._rig.types) or CLASSES
        label = part_class(part_id) if part_id else label
        if label not in kinds:
            hint = did_you_mean(label[:50], kinds)
            raise PlateError(f"type is {label[:50]!r}{hint}, allowed: {', '.join(kinds)}")
        if not part_id and len(state.ids) >= MAX_PARTS:
            raise PlateError(
                f"no part can be added: {len(state.ids)} parts exist, allowed: fewer than "
                f"{MAX_PARTS}"
            )
        limit = self._rig.plate.half - self._rig.part_type(label).reach_m
        if not np.all(np.abs(position) <= limit + 1e-9):  # this condition also refuses NaN
            raise PlateError(
                f"place is ({position[0]:g}, {position[1]:g}) m, allowed for {label}: |x| up to "
                f"{limit[0]:g}, |y| up to {limit[1]:g} m"
            )
        if not np.isfinite(angle):
            raise PlateError(f"angle is {angle:g}, allowed: finite")
        return label


def check_id(state: WorldState, part_id: str) -> None:
    """Raise a PlateError if the state contains no part with the id `part_id`."""
    if part_id not in state.ids:
        hint = did_you_mean(part_id[:50], state.ids)
        known = ", ".join(state.ids) or "none"
        raise PlateError(f"id is {part_id[:50]!r}{hint}, allowed: {known}")
