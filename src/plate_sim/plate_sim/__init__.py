"""Simulates parts on the vibrating plate, its camera and its motor controller."""

from .bodies import simulate_bodies
from .camera import Camera, part_greys
from .contacts import Contacts
from .dirt import Dirt
from .drive import PlateState
from .friction import Trajectory
from .ground import Ground
from .ladder import Choice
from .plate_motion import PlateMotion
from .points import simulate, simulate_many
from .simulation import Simulation
from .suspension import motor_record, realise
from .world import WorldState, record_cycle, run_cycle

__all__ = [
    "Camera",
    "Choice",
    "Contacts",
    "Dirt",
    "Ground",
    "PlateMotion",
    "PlateState",
    "Simulation",
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
