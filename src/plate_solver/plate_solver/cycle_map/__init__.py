"""The cycle map: the state of the parts after a plate motion, computed with stick-slip friction,
and its derivatives.

Parts are modelled as points (`stick_slip`, `blocks`) or as bodies that rotate (`turning`). Searches
use versions that process parts in blocks and in single precision.
"""

from .blocks import LANES, TRACE, adjoint, blocks_of, trace
from .stick_slip import PREDICTION_STEP, after, end_state, end_state_gradient, finely_sampled
from .turning import (
    TURNING_TRACE,
    adjoint_turning,
    end_turning,
    end_turning_gradient,
    room_spread,
    trace_turning,
    turning_blocks_of,
)

__all__ = [
    "LANES",
    "PREDICTION_STEP",
    "TRACE",
    "TURNING_TRACE",
    "adjoint",
    "adjoint_turning",
    "after",
    "blocks_of",
    "end_state",
    "end_state_gradient",
    "end_turning",
    "end_turning_gradient",
    "finely_sampled",
    "room_spread",
    "trace",
    "trace_turning",
    "turning_blocks_of",
]
