"""Minimising few errors over many parameters: one descent, and one loop of restarts around it.

Both are made of functions: here of Python's, in C++ of those of a kernel.
"""

from .basin_hopping import basin_hopping
from .levenberg_marquardt import Fit, condition_of, fit, least_norm_step

__all__ = ["Fit", "basin_hopping", "condition_of", "fit", "least_norm_step"]
