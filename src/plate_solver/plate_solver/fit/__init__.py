"""Least squares with few errors and many parameters, by the Levenberg-Marquardt method and basin
hopping.

Both methods take the problem as functions. These are Python functions here and kernel functions in
C++.
"""

from .basin_hopping import basin_hopping
from .levenberg_marquardt import Fit, condition_of, fit

__all__ = ["Fit", "basin_hopping", "condition_of", "fit"]
