"""Minimising few errors over many parameters: one descent, and one loop of restarts around it.

Both are made of functions: plain ones, or compiled ones for a compiled search.
"""

from .basin_hopping import FIRST, basin_hopping
from .levenberg_marquardt import (
    Damping,
    Fit,
    condition_of,
    fit,
    least_norm_step,
    levenberg_marquardt,
)

__all__ = [
    "FIRST",
    "Damping",
    "Fit",
    "basin_hopping",
    "condition_of",
    "fit",
    "least_norm_step",
    "levenberg_marquardt",
]
