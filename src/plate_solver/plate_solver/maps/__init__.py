"""What a plate motion does to parts: mean friction over a cycle, and their stick-slip motion.

Public: the average force of a cycle and of sinusoids, and where parts end after a motion.
"""

from .blocks import LANES, TRACE, adjoint, blocks_of, trace
from .mean_force import average_force, step_force_gradient, step_forces
from .sinusoid_force import force_rules, sinusoid_forces
from .stick_slip import PREDICTION_STEP, after, end_state, end_state_gradient, finely_sampled
from .triangular_waves import intervals, triangular_forces
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
    "average_force",
    "blocks_of",
    "end_state",
    "end_state_gradient",
    "end_turning",
    "end_turning_gradient",
    "finely_sampled",
    "force_rules",
    "intervals",
    "room_spread",
    "sinusoid_forces",
    "step_force_gradient",
    "step_forces",
    "trace",
    "trace_turning",
    "triangular_forces",
    "turning_blocks_of",
]
