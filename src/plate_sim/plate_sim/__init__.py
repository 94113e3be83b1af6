"""Simulates parts on the vibrating plate, its camera and its motor controller."""

from .bodies import simulate_bodies
from .camera import Camera, part_greys
from .contacts import Contacts
from .friction import Trajectory
from .points import simulate, simulate_many
from .world import WorldState, record_cycle, run_cycle

__all__ = [
    "Camera",
    "Contacts",
    "Trajectory",
    "WorldState",
    "part_greys",
    "record_cycle",
    "run_cycle",
    "simulate",
    "simulate_bodies",
    "simulate_many",
]
