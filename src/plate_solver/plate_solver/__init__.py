"""Plate motions that produce requested forces or displacements of many parts at once.

The public names are the names listed below and the names of the subpackages `averages`,
`cycle_map`, `fit`, `goal`, `library`, `rotations` and `sinusoids`.
"""

from typing import TYPE_CHECKING, Any

from .controller import DRIFT_TOLERANCE, EFFORT, EXACT_MISS, METHODS, Controller, CycleResult
from .goal import Goal, Solution, Status
from .limits import EQUAL_WEIGHT, Limits, limit_use, limit_uses

if TYPE_CHECKING:
    from .averages import RotationSolver, SinusoidSolver, average_force
    from .averages.manipulability import Manipulability, library_force, manipulability

__all__ = [
    "DRIFT_TOLERANCE",
    "EFFORT",
    "EQUAL_WEIGHT",
    "EXACT_MISS",
    "METHODS",
    "Controller",
    "CycleResult",
    "Goal",
    "Limits",
    "Manipulability",
    "RotationSolver",
    "SinusoidSolver",
    "Solution",
    "Status",
    "average_force",
    "library_force",
    "limit_use",
    "limit_uses",
    "manipulability",
]

# Type checkers must not see this function, because they would then accept any attribute name.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Import the subpackage `averages` when it is first used, because the controller does not
        need it."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from . import averages

        return getattr(averages, name)
