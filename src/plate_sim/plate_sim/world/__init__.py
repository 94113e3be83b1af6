"""Simulated world: the state of the parts, its steps, disturbances, and a run with a camera. The
names below are public."""

from .bodies import STEP, BodyTrajectory, simulate_bodies
from .disturbances import NONE, RANGES, Disturbances
from .robot import Grip, Move
from .sight import Shot, Sight
from .simulation import WORLD_RANGES, Simulation
from .state import WorldState
from .step import record_cycle, run_cycle

__all__ = [
    "NONE",
    "RANGES",
    "STEP",
    "WORLD_RANGES",
    "BodyTrajectory",
    "Disturbances",
    "Grip",
    "Move",
    "Shot",
    "Sight",
    "Simulation",
    "WorldState",
    "record_cycle",
    "run_cycle",
    "simulate_bodies",
]
