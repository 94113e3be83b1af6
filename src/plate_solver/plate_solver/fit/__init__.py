"""Solves least-squares problems with few errors and many parameters, by the Levenberg-Marquardt
method and basin hopping.

Both methods receive the problem as functions: Python functions in this package, and C++ functions
in the kernels.
"""

from .basin_hopping import basin_hopping
from .levenberg_marquardt import Fit, fit

__all__ = ["Fit", "basin_hopping", "fit"]
