"""Parameters of the contacts between parts, and of the contacts of parts with walls."""

from __future__ import annotations

from dataclasses import dataclass

from plate_core import PlateError

from ..friction.checks import MAX_ABS


@dataclass(frozen=True)
class Contacts:
    """Parameters of contacts.

    Attributes
    ----------
    restitution : float
        Ratio of the normal speed after the collision to the normal speed before it, 0 to 1.
    friction : float
        Coulomb friction coefficient between the edges of two parts, at least 0.
    walls : bool
        Whether walls around the plate keep parts on it. The walls have the same restitution and
        friction.

    Raises
    ------
    PlateError
        If a coefficient is outside its allowed range.
    """

    restitution: float = 0.0
    friction: float = 0.0
    walls: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise PlateError(f"contacts: restitution is {self.restitution!r}, allowed: 0 to 1")
        if not 0 <= self.friction <= MAX_ABS:
            raise PlateError(f"contacts: friction is {self.friction!r}, allowed: 0 to {MAX_ABS:g}")


INELASTIC = Contacts()
"""Inelastic contacts without friction and without walls."""
