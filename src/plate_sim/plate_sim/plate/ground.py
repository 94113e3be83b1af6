"""How the plate carries parts, beyond one friction coefficient: static, fast slip, tilt, heave."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite, sin
from typing import NamedTuple

from plate_core import PlateError

STATIC = (1.0, 10.0)
"""Allowed ratio of static to dynamic friction."""

SLOPE = (-5.0, 5.0)
"""Allowed change of friction with the slip [1/(m/s)]."""

HEAVE = (-0.1, 0.1)
"""Allowed vertical over horizontal motion of the plate: by more it would throw parts up."""

TILT = 0.5
"""Greatest tilt [rad]: about 29 degrees."""


class GroundEffect(NamedTuple):
    """What the ground does to parts, for compiled code: gravity along the plate [m/s2, plate_home],
    static over dynamic friction, the change of that with the slip [1/(m/s)], and that of the weight
    with the plate's acceleration along x [1/(m/s2)]."""

    gravity_x: float
    gravity_y: float
    static_ratio: float
    slope: float
    heave: float


@dataclass(frozen=True)
class Ground:
    """The plate under all parts.

    Attributes
    ----------
    static_ratio : float
        Static over dynamic friction: a part that sticks comes loose only when holding it would
        take more than `static_ratio` mu g.
    tilt : (2,)
        How far the plate leans [rad]: parts are pulled down it, along +x and +y if positive.
    friction_slope : float
        How dynamic friction changes with the slip s [1/(m/s)]: by 1 + slope s if positive, by
        1/(1 - slope s) if negative. Of a part that turns too, s is the root mean square over it.
    heave : float
        The plate moves up by this share of its motion along x: parts weigh, and friction grows, by
        1 + heave a/g at an acceleration a. Parts never leave the plate.
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
        """Return what it does under a gravity [m/s2]."""
        x, y = (gravity * sin(angle) for angle in self.tilt)
        return GroundEffect(
            float(x), float(y), float(self.static_ratio), float(self.friction_slope),
            self.heave / gravity if self.heave else 0.0,
        )  # fmt: skip


LEVEL = Ground()
"""A level plate, as hard to leave as to slide on."""
