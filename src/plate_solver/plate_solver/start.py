"""Prediction of the state of parts and plate at the start of the requested cycle.

The inputs are the part positions in the image, the part velocities from the last prediction
(`Memory`), and the running cycle. The stick-slip motion is integrated until the running cycle ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from plate_core import CycleRequest, PlateCycle, Rig, part_class
from plate_core.motion import is_rest
from plate_core.rig import PartType

from .cycle_map import after, end_turning, finely_sampled, home_spread
from .sinusoids.basis import TAIL_PERIOD_S, TAIL_S


@dataclass(frozen=True)
class Memory:
    """Predicted velocities of parts at the start of the running cycle, by id.

    A part without an entry is assumed to be at rest. The memory is needed because a camera that
    takes one image per cycle measures positions, but no instantaneous velocities.

    Attributes
    ----------
    velocity : mapping of str to (2,)
        Velocity of each part [m/s, plate_home].
    spin : mapping of str to float
        Spin of each part [rad/s].
    """

    velocity: Mapping[str, np.ndarray] = field(default_factory=dict)
    spin: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StartState:
    """State of M parts and of the plate when the requested cycle begins.

    Attributes
    ----------
    ids : tuple of str
    position, velocity : (M, 2)
        Position [m] and velocity [m/s] of the parts, plate_home.
    friction_accel : (M,)
        mu g of each part [m/s2].
    rotation : (M,)
        Rotation of each part since the start of the running cycle [rad].
    spin : (M,) or None
        Spin of each part [rad/s]. None if no rotation is requested. Without a requested rotation,
        the parts are modelled as points.
    plate : (3, 3) or None
        State of the plate as in `PlateCycle.state`. None if the plate rests at home.
    """

    ids: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    friction_accel: np.ndarray
    rotation: np.ndarray
    spin: np.ndarray | None
    plate: np.ndarray | None

    @property
    def memory(self) -> Memory:
        """Velocities for the next prediction. These velocities are valid if the requested cycle is
        executed."""
        spin = {} if self.spin is None else dict(zip(self.ids, self.spin.tolist(), strict=True))
        return Memory(dict(zip(self.ids, self.velocity, strict=True)), spin)


def predict_start(
    rig: Rig,
    request: CycleRequest,
    memory: Memory,
    running: PlateCycle | None,
    rotates: bool,
    from_rest: bool,
) -> StartState:
    """Predict the state when the requested cycle begins.

    The stick-slip motion of the parts is integrated over the running cycle. The integration starts
    at the positions in the image, with the velocities of `memory`. If the request contains
    predicted positions and velocities (`CycleRequest.start`), these predictions are used instead.

    Parameters
    ----------
    rig : Rig
    request : CycleRequest
        The request, for M parts.
    memory : Memory
        Result of the last prediction (`StartState.memory`).
    running : PlateCycle, optional
        The running cycle; None if the plate is at rest.
    rotates : bool
        Whether a rotation is requested. If False, parts are modelled as points.
    from_rest : bool
        Whether the method's cycles begin at rest. If True and the running cycle ends in motion, the
        function predicts the state after the tail of this cycle.
    """
    parts, types = request.parts, part_types(rig, request.parts.ids)
    friction, rotation = friction_accel(rig, request), np.zeros(len(parts))
    velocity = np.array([memory.velocity.get(name, np.zeros(2)) for name in parts.ids])
    spin = np.array([memory.spin.get(name, 0.0) for name in parts.ids])
    position = parts.position
    if running is None:
        velocity = np.zeros_like(velocity)
    elif rotates:
        spread = contact_spread(types, parts.angle)
        position, velocity, rotation, spin = end_turning(
            position, velocity, spin, spread, *finely_sampled(running), friction
        )
    elif request.start is None:
        position, velocity = after(running, position, velocity, friction)
    if request.start is not None:
        position, velocity = request.start.reshape(-1, 2, 2).transpose(1, 0, 2)
    plate = request.plate
    if plate is not None and from_rest:
        if not is_rest(plate):
            tail = PlateCycle.stopping(plate, TAIL_S, TAIL_PERIOD_S)
            position, velocity = after(tail, position, velocity, friction)
        plate = None
    return StartState(
        parts.ids, position, velocity, friction, rotation, spin if rotates else None, plate
    )


def part_types(rig: Rig, ids: tuple[str, ...]) -> list[PartType]:
    """Return the type of each part."""
    return [rig.part_type(part_class(name)) for name in ids]


def friction_accel(rig: Rig, request: CycleRequest) -> np.ndarray:
    """Return mu g (M,) [m/s2] of the parts.

    mu g is the friction limit divided by the mass. If the friction limit is 0 (unknown), the value
    of the part's type is used.
    """
    types = part_types(rig, request.parts.ids)
    known = request.parts.friction_limit / np.array([t.mass_kg for t in types])
    of_type = np.array([t.mu for t in types]) * rig.friction.gravity
    return np.where(known > 0, known, of_type)


def contact_spread(types: list[PartType], angle: np.ndarray) -> np.ndarray:
    """Return the second moments xx, xy, yy (M, 3) [m2, plate_home] of the parts' contacts at angles
    (M,) [rad]."""
    return home_spread(np.array([t.spread_m2 for t in types]), angle)
