"""The library of rotations about many centres, and the least time in which it gives forces.

Method A plans with it; the averages of both methods are bounded by it.
"""

from .condition import condition_number
from .library import (
    CURL_LENGTH_M,
    REACH,
    Library,
    grid,
    ring,
    rotation_matrix,
    solve_weights,
)
from .simplex import TimeFractions, least_time

__all__ = [
    "CURL_LENGTH_M",
    "REACH",
    "Library",
    "TimeFractions",
    "condition_number",
    "grid",
    "least_time",
    "ring",
    "rotation_matrix",
    "solve_weights",
]
