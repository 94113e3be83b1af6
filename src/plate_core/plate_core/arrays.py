"""Read-only arrays, which several objects can share."""

from __future__ import annotations

import numpy as np


def read_only(array: np.ndarray) -> np.ndarray:
    """Make an array read-only and return it. Several objects can share a cached array. A change by
    one object would change the values of the others."""
    array.setflags(write=False)
    return array
