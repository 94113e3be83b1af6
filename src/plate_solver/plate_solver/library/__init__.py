"""The library of rotations of the plate about many centres. The package also computes the minimum
time in which these rotations produce requested forces.

Method A uses the library for planning. The library also bounds the averaged forces of both methods.
"""

from .condition import condition_number
from .library import CURL_LENGTH_M, REACH, Library, grid, rotation_matrix
from .simplex import TimeFractions, min_time

__all__ = [
    "CURL_LENGTH_M",
    "REACH",
    "Library",
    "TimeFractions",
    "condition_number",
    "grid",
    "min_time",
    "rotation_matrix",
]
