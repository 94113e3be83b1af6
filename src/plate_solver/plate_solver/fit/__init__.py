"""Least squares with few errors and many parameters: Levenberg-Marquardt and basin hopping.

Both take the problem as functions: Python functions here, kernel functions in C++.
"""

from .basin_hopping import basin_hopping
from .levenberg_marquardt import Fit, condition_of, fit, least_norm_step

__all__ = ["Fit", "basin_hopping", "condition_of", "fit", "least_norm_step"]
