"""The cycle map: where a plate motion takes parts, which stick and slip, with its derivatives.

Parts are points or turn; one by one, or in blocks for searches. And how fast a part can be at most.
"""

from .blocks import LANES, TRACE, adjoint, blocks_of, trace
from .bounds import SpeedBounds, rest_to_rest_s, shift_accel, speed_bounds
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
    "SpeedBounds",
    "adjoint",
    "adjoint_turning",
    "after",
    "blocks_of",
    "end_state",
    "end_state_gradient",
    "end_turning",
    "end_turning_gradient",
    "finely_sampled",
    "rest_to_rest_s",
    "room_spread",
    "shift_accel",
    "speed_bounds",
    "trace",
    "trace_turning",
    "turning_blocks_of",
]
