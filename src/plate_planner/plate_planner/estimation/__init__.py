"""Estimates position, velocity and friction of the parts. Also predicts the state of the parts at
the start of the cycle that results from the next request.

`Estimator` is the interface. The inputs are the parts in the images and the cycles sent to the
plate.
"""

from .cycle_log import SNAP, check_start
from .estimator import MISSED_IMAGES, SETTLE_S, DriftBias, Estimator, LastRequest, rows_of, warm_up
from .filter import Coast

__all__ = [
    "MISSED_IMAGES",
    "SETTLE_S",
    "SNAP",
    "Coast",
    "DriftBias",
    "Estimator",
    "LastRequest",
    "check_start",
    "rows_of",
    "warm_up",
]  # fmt: skip
