"""Simulates parts on the vibrating plate, its camera and its motor controller."""

from .bodies import simulate_bodies
from .camera import Camera, part_greys
from .contacts import Contacts
from .drive import PlateState
from .friction import Trajectory
from .plate_motion import PlateMotion
from .points import simulate, simulate_many
from .suspension import motor_record, realise
from .world import WorldState, record_cycle, run_cycle

__all__ = [
    "Camera",
    "Contacts",
    "PlateMotion",
    "PlateState",
    "Trajectory",
    "WorldState",
    "motor_record",
    "part_greys",
    "realise",
    "record_cycle",
    "run_cycle",
    "simulate",
    "simulate_bodies",
    "simulate_many",
]
