"""The cycle map. The map computes the state of the parts after a motion of the plate with
stick-slip friction, and the derivatives of this state.

Parts are modelled as points (`stick_slip`, `blocks`) or as bodies that rotate (`turning`). Searches
use versions of the map that process parts in blocks and in single precision.
"""

from .blocks import LANES, blocks_of
from .stick_slip import PREDICTION_STEP, after, end_state, end_state_gradient, finely_sampled
from .turning import (
    end_turning,
    end_turning_gradient,
    home_spread,
    turning_blocks_of,
)

__all__ = [
    "LANES",
    "PREDICTION_STEP",
    "after",
    "blocks_of",
    "end_state",
    "end_state_gradient",
    "end_turning",
    "end_turning_gradient",
    "finely_sampled",
    "home_spread",
    "turning_blocks_of",
]
