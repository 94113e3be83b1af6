"""Simulated world. The package contains the state of the parts, the simulation of this state,
disturbances, and a run with a camera."""

from .bodies import STEP, BodyTrajectory, simulate_bodies
from .camera_view import Shot, VisibleParts
from .disturbances import NONE, RANGES, Disturbances
from .robot import Grip, Move
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
    "Simulation",
    "VisibleParts",
    "WorldState",
    "record_cycle",
    "run_cycle",
    "simulate_bodies",
]
