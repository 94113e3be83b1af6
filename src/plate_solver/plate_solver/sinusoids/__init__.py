"""Method B (section 3.2): sinusoidal motions that are fitted on the cycle map.

This package exports the basis, its families, the descent and the search. `SinusoidCycles`, the
solver that the controller uses, is in `solver.py`.
"""

from . import steer
from .basis import SinusoidBasis, SinusoidFamily, sinusoid_basis
from .descent import BIN, Motions, Problem, descend
from .limits import LimitedSinusoids
from .steer import AT_ONCE, BEYOND, PLAYS, ROUGH, SPREAD, SinusoidSteering, limited_sinusoids

__all__ = [
    "AT_ONCE",
    "BEYOND",
    "BIN",
    "PLAYS",
    "ROUGH",
    "SPREAD",
    "LimitedSinusoids",
    "Motions",
    "Problem",
    "SinusoidBasis",
    "SinusoidFamily",
    "SinusoidSteering",
    "descend",
    "limited_sinusoids",
    "sinusoid_basis",
    "steer",
]
