"""Arrays that several users share."""

from __future__ import annotations

import numpy as np


def read_only(array: np.ndarray) -> np.ndarray:
    """Make an array read-only and return it. A cached array is shared by all its users, so a change
    by one of them would change the values of the others."""
    array.setflags(write=False)
    return array
