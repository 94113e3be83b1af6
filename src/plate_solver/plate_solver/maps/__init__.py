"""What a plate motion does to parts: mean friction over a cycle, and their stick-slip motion.

Public: the average force of a cycle and of sinusoids, and where parts and discs end after a motion.
"""

from .blocks import LANES, TRACE, adjoint, blocks_of, trace
from .disc import end_disc, end_disc_gradient
from .mean_force import average_force, step_force_gradient, step_forces
from .sinusoid_force import force_rules, sinusoid_forces
from .stick_slip import PREDICTION_STEP, after, end_state, end_state_gradient, finely_sampled
from .triangular_waves import intervals, triangular_forces

__all__ = [
    "LANES",
    "PREDICTION_STEP",
    "TRACE",
    "adjoint",
    "after",
    "average_force",
    "blocks_of",
    "end_disc",
    "end_disc_gradient",
    "end_state",
    "end_state_gradient",
    "finely_sampled",
    "force_rules",
    "intervals",
    "sinusoid_forces",
    "step_force_gradient",
    "step_forces",
    "trace",
    "triangular_forces",
]
