"""All measured data of one rig, and values that are computed from several sections of these
data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import read_only
from .fiducials import Fiducials
from .motors import Reach, compute_motor_levers, compute_motor_loads, compute_reach
from .part_types import PartType
from .sections import Camera, Friction, Limits, Motor, PartFacts, Plate
from .suspension import Suspension, mass_matrix

MIN_RADII, WALL_RADII = 0.5, 1.25
"""Required distances of a part's centre from the plate's edges [part radii]. The motors' stroke is
added to both values. A part nearer than `MIN_RADII` is lost. Parts should stay at least
`WALL_RADII` from the edges. See `EdgeMargin`."""


class EdgeMargin(NamedTuple):
    """Required distance of a part's centre from the plate's edges [m].

    A part at a shorter distance than `min_m` is lost, because it overhangs the edge, or because
    the plate can move away under it by the motors' stroke. At the distance `wall_m` from the edges
    there is a virtual wall. A part farther from the edges than this wall is safe.
    """

    min_m: float
    wall_m: float


@dataclass(frozen=True)
class Rig:
    """All data of one rig.

    If the rig has no suspension, the plate is rigid and follows its commands exactly. If the rig
    has no fiducials, vision detects the plate only by its edges. If the rig has no types, all parts
    are identical discs.
    """

    plate: Plate
    friction: Friction
    parts: PartFacts
    limits: Limits
    motors: tuple[Motor, ...]
    camera: Camera
    suspension: Suspension | None = None
    fiducials: Fiducials | None = None
    types: Mapping[str, PartType] = field(default_factory=dict, hash=False)

    def part_type(self, name: str) -> PartType:
        """Return a part type, with the rig's default mass and friction if the type has no own
        values. A part of an unknown type is a disc with the data of `parts`."""
        if name not in self._part_types:
            known = self.types.get(name) or PartType(
                name, radius_m=self.parts.radius_m, symmetry=0, height_m=self.parts.height_m
            )
            self._part_types[name] = replace(
                known,
                mass_kg=self.parts.mass_kg if known.mass_kg is None else known.mass_kg,
                mu=self.friction.mu if known.mu is None else known.mu,
            )
        return self._part_types[name]

    def edge_margin(self, name: str) -> EdgeMargin:
        """Return the required distance of the centre of a part of this type from the plate's edges
        [m]."""
        stroke, reach = self.limits.stroke_m, self.part_type(name).reach_m
        return EdgeMargin(max(stroke + MIN_RADII * reach, reach), stroke + WALL_RADII * reach)

    @cached_property
    def _part_types(self) -> dict[str, PartType]:
        return {}

    @cached_property
    def motor_levers(self) -> np.ndarray:
        """Derivatives B^T (4, 3) of the motors' travel with respect to the pose x, y, theta of the
        plate at home [1, 1, m]. Read-only. See `motors.compute_motor_levers`."""
        return read_only(compute_motor_levers(self.motors))

    @cached_property
    def plate_mass(self) -> np.ndarray:
        """Mass matrix M (3, 3) of the suspension, or of a uniform plate if the rig has no
        suspension. Read-only."""
        if self.suspension is not None:
            return read_only(np.array(self.suspension.mass))
        return read_only(np.array(mass_matrix(self.plate.mass_kg, self.plate.inertia_kgm2)))

    @cached_property
    def motor_loads(self) -> np.ndarray:
        """Matrices (3, 4, 3) that convert pose, twist and acceleration of the plate to motor forces
        [N]. Read-only."""
        suspension, zero = self.suspension, np.zeros((3, 3))
        stiffness = zero if suspension is None else np.array(suspension.stiffness)
        damping = zero if suspension is None else np.array(suspension.damping)
        return read_only(
            compute_motor_loads(self.motor_levers, stiffness, damping, self.plate_mass)
        )

    @cached_property
    def motor_reach(self) -> Reach:
        """Maximum acceleration [m/s2] that the motors can continuously give any point of the plate.
        See `motors.compute_reach`."""
        return compute_reach(self.motors, self.motor_loads[2], self.plate.half, self.limits)

    @property
    def reach(self) -> Reach:
        """Maximum continuous acceleration of any point of the plate in any direction [m/s2], and
        the key of the limit that determines it."""
        allowed = Reach(self.limits.accel, "accel_mps2")
        return min(allowed, self.motor_reach, key=lambda each: each.accel)

    @property
    def gamma(self) -> float:
        """Shaking ratio a_max/(mu g) [-]. a_max is the acceleration of `reach`. With a
        higher ratio, the plate moves parts faster and more accurately."""
        return self.reach.accel / self.friction.accel

    @property
    def force_unit(self) -> float:
        """Sliding friction force of one part, mu m g [N]. The solvers use this force as the unit of
        force."""
        return self.parts.mass_kg * self.friction.accel
