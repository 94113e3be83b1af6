"""Simulation of parts on the vibrating plate, of the camera and of the motor controller. The
subpackages are `world`, `plate`, `friction`, `contacts`, `camera` and `device`. This package
exports their most frequently used names."""

from .camera import Camera, part_greys
from .contacts import Contacts
from .friction import Trajectory, simulate
from .plate import Ground, PlateMotion, PlateState, motor_record, realise
from .world import (
    BodyTrajectory,
    Disturbances,
    Grip,
    Move,
    Simulation,
    WorldState,
    record_cycle,
    run_cycle,
    simulate_bodies,
)

__all__ = [
    "BodyTrajectory",
    "Camera",
    "Contacts",
    "Disturbances",
    "Grip",
    "Ground",
    "Move",
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
]
