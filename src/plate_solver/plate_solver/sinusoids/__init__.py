"""Method B (section 3.2): sinusoidal motions, fitted on the averaged map and on the cycle map.

Public: the basis, its families, the inversion of averages and a descent on the cycle map;
`plate_solver.SinusoidSolver` is the door.
"""

from .average import invert
from .basis import SinusoidBasis, SinusoidFamily, sinusoid_basis
from .descent import BIN, Motions, Problem, descend
from .steer import limited_sinusoids

__all__ = [
    "BIN",
    "Motions",
    "Problem",
    "SinusoidBasis",
    "SinusoidFamily",
    "descend",
    "invert",
    "limited_sinusoids",
    "sinusoid_basis",
]
