"""Where the parts are, how fast, how slippery, and where the planner's answer will find them.

`Estimator` is the door: it takes in the images' parts and the cycles sent to the plate.
"""

from .cycle_log import SNAP, check_start
from .estimator import COAST, SETTLE_S, DriftBias, Estimator, LastRequest, rows_of, warm_up
from .filter import Coast

__all__ = [
    "COAST",
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
