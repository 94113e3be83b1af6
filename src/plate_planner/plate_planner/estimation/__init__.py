"""Where the parts are, how fast, how slippery, and where the planner's answer will find them.

`Estimator` is the door: it takes in the images' parts and the cycles sent to the plate.
"""

from .estimator import DriftBias, Estimator, LastRequest, rows_of, warm_up

__all__ = ["DriftBias", "Estimator", "LastRequest", "rows_of", "warm_up"]
