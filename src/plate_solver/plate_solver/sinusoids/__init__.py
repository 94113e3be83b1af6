"""Method B (section 3.2): sinusoidal motions, fitted on the averaged map and on the cycle map.

Public: the basis, its families and the inversion of averages; `plate_solver.SinusoidSolver` is the
door.
"""

from .average import invert
from .basis import STEPS_PER_HARMONIC, SinusoidBasis, SinusoidFamily, sinusoid_basis
from .steer import limited_sinusoids

__all__ = [
    "STEPS_PER_HARMONIC",
    "SinusoidBasis",
    "SinusoidFamily",
    "invert",
    "limited_sinusoids",
    "sinusoid_basis",
]
