"""The library of rotations about many centres, and the minimum time in which they produce forces.

Method A uses it for planning. It also gives the bound on the averaged forces of both methods.
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
