"""Method B (section 3.2): sinusoidal motions, fitted on the averaged map and on the cycle map.

Public: the basis, its families, the inversion of averages, a descent and the search on the
cycle map; `plate_solver.SinusoidSolver` is the door.
"""

from .average import invert
from .basis import SinusoidBasis, SinusoidFamily, sinusoid_basis
from .descent import BIN, Motions, Problem, descend
from .steer import BEYOND, ROUGH, SinusoidSteering, limited_sinusoids

__all__ = [
    "BEYOND",
    "BIN",
    "ROUGH",
    "Motions",
    "Problem",
    "SinusoidBasis",
    "SinusoidFamily",
    "SinusoidSteering",
    "descend",
    "invert",
    "limited_sinusoids",
    "sinusoid_basis",
]
