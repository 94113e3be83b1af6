"""Friction between plate and parts: footprints, one step of a part, and points event by event.
Public: the names below; `simulate` is the judge of all other integrators."""

from .footprint import Footprint, bar, disc, polygon, union
from .outline import footprint_of
from .point_events import TOLERANCE, Trajectory, simulate

__all__ = [
    "TOLERANCE",
    "Footprint",
    "Trajectory",
    "bar",
    "disc",
    "footprint_of",
    "polygon",
    "simulate",
    "union",
]
