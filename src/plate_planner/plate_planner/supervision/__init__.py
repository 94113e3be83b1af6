"""Supervision of a task: its phase, the reason of its end, its progress, and the planner's inputs.

The functions `begin`, `evaluate` and `stopped` change the phase of a task. `Inputs` is the state of
the planner's inputs. `InputMonitor` decides whether a task can continue with these inputs.
"""

from .agreement import Agreement
from .bystanders import Overlooked, bystanders_text, is_bystander, without_surplus
from .failure import LastSeen, loss_of, outlook, shortfall_text, weak_plate_text
from .inputs import Inputs
from .monitor import InputMonitor
from .phase import (
    STOP,
    Failure,
    Findings,
    Phase,
    Reason,
    TaskLimits,
    TaskState,
    begin,
    evaluate,
    missing_parts,
    started,
    stopped,
)
from .progress import Progress
from .units import check_positions

__all__ = [
    "STOP",
    "Agreement",
    "Failure",
    "Findings",
    "InputMonitor",
    "Inputs",
    "LastSeen",
    "Overlooked",
    "Phase",
    "Progress",
    "Reason",
    "TaskLimits",
    "TaskState",
    "begin",
    "bystanders_text",
    "check_positions",
    "evaluate",
    "is_bystander",
    "loss_of",
    "missing_parts",
    "outlook",
    "shortfall_text",
    "started",
    "stopped",
    "weak_plate_text",
    "without_surplus",
]
