"""Friction between plate and parts. The package contains footprints, integration steps of a part,
and the event-driven simulation of point parts. All names that the package exports are public. The
function `simulate` is the accurate reference for all other integrators."""

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
