"""Effects of the plate's surface that one friction coefficient does not describe. The effects are
static friction, friction that depends on the slip speed, tilt, and heave. `Ground` describes these
effects. `Ground.effect` returns the numbers that the kernels use."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite, sin
from typing import NamedTuple

from plate_core import PlateError

STATIC = (1.0, 10.0)
"""Allowed range of the ratio of static to dynamic friction."""

SLOPE = (-5.0, 5.0)
"""Allowed range of the relative change of friction with the slip speed [1/(m/s)]."""

HEAVE = (-0.1, 0.1)
"""Allowed range of the ratio of vertical to horizontal motion of the plate. With a larger ratio,
the plate would throw parts up."""

TILT = 0.5
"""Maximum tilt of the plate [rad], about 29 degrees."""


class GroundEffect(NamedTuple):
    """Numbers by which compiled code describes the effects of the surface on parts.

    - gravity along the plate [m/s2, plate_home]
    - ratio of static to dynamic friction
    - relative change of friction with the slip [1/(m/s)]
    - relative change of the weight with the plate's acceleration along x [1/(m/s2)]
    """

    gravity_x: float
    gravity_y: float
    static_ratio: float
    slope: float
    heave: float


@dataclass(frozen=True)
class Ground:
    """Surface of the plate.

    Attributes
    ----------
    static_ratio : float
        Ratio of static to dynamic friction. A sticking part begins to slip if the acceleration that
        is required to hold it exceeds `static_ratio` mu g.
    tilt : (2,)
        Tilt of the plate along x and y [rad]. With positive values, gravity pulls parts along +x
        and +y.
    friction_slope : float
        Relative change of dynamic friction with the slip speed s [1/(m/s)]. Friction is multiplied
        by 1 + slope s if the slope is positive, and by 1/(1 - slope s) if the slope is negative. If
        a part also rotates, s is the root mean square of the slip over the part.
    heave : float
        Ratio of the plate's upward motion to its motion along x. If the plate has the acceleration
        a along x, the weight of parts and the friction are multiplied by 1 + heave a/g. Parts never
        leave the plate.
    """

    static_ratio: float = 1.0
    tilt: tuple[float, float] = (0.0, 0.0)
    friction_slope: float = 0.0
    heave: float = 0.0

    def __post_init__(self) -> None:
        if not STATIC[0] <= self.static_ratio <= STATIC[1]:
            raise PlateError(
                f"static_ratio is {self.static_ratio!r}, allowed: {STATIC[0]:g} to {STATIC[1]:g}"
            )
        if not SLOPE[0] <= self.friction_slope <= SLOPE[1]:
            raise PlateError(
                f"friction_slope is {self.friction_slope!r}, allowed: {SLOPE[0]:g} to {SLOPE[1]:g}"
            )
        if not HEAVE[0] <= self.heave <= HEAVE[1]:
            raise PlateError(f"heave is {self.heave!r}, allowed: {HEAVE[0]:g} to {HEAVE[1]:g}")
        tilt = tuple(self.tilt)
        if len(tilt) != 2 or not all(isfinite(t) for t in tilt) or hypot(*tilt) > TILT:
            raise PlateError(f"tilt is {self.tilt!r} rad, allowed: two angles, up to {TILT:g}")

    def effect(self, gravity: float) -> GroundEffect:
        """Convert this surface to the numbers for compiled code. `gravity` is in m/s2."""
        x, y = (gravity * sin(angle) for angle in self.tilt)
        return GroundEffect(
            float(x), float(y), float(self.static_ratio), float(self.friction_slope),
            self.heave / gravity if self.heave else 0.0,
        )  # fmt: skip


LEVEL = Ground()
"""Level plate whose static and dynamic friction are equal."""
