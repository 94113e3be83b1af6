"""How parts touch each other and the walls."""

from __future__ import annotations

from dataclasses import dataclass

from plate_core import PlateError

from ..friction.checks import LARGEST


@dataclass(frozen=True)
class Contacts:
    """How parts touch.

    Attributes
    ----------
    restitution : float
        Speed after over speed before along the normal: 0 to 1.
    friction : float
        Coulomb friction coefficient between rims: at least 0.
    walls : bool
        Whether walls around the plate, of the same restitution and friction, keep parts on it.

    Raises
    ------
    PlateError
        If a coefficient is out of range.
    """

    restitution: float = 0.0
    friction: float = 0.0
    walls: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise PlateError(f"contacts: restitution is {self.restitution!r}, allowed: 0 to 1")
        if not 0 <= self.friction <= LARGEST:
            raise PlateError(f"contacts: friction is {self.friction!r}, allowed: at least 0")


INELASTIC = Contacts()
"""Parts stop each other, rims do not rub, no walls."""
