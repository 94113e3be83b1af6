"""Method B (section 3.2): sinusoidal motions that are fitted on the cycle map.

This package exports the basis, its families and the descent. `SinusoidCycles`, the solver that the
controller uses, is in `solver.py`.
"""

from .basis import SinusoidBasis, SinusoidFamily, sinusoid_basis
from .descent import BIN, Motions, Problem, descend
from .solver import family_on_grid

__all__ = [
    "BIN",
    "Motions",
    "Problem",
    "SinusoidBasis",
    "SinusoidFamily",
    "descend",
    "family_on_grid",
    "sinusoid_basis",
]
