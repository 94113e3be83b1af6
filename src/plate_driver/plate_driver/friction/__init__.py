"""Friction of parts at the rig, from known pushes of the plate and where the camera sees them.

`FrictionMeasurement` is the procedure and `FrictionFound` its result; `make_push` makes a motion,
`slip` is the model of what it does.
"""

from .measurement import FrictionFound, FrictionMeasurement, PartFriction, Rest, Stage, rig_mu
from .push import Push, make_push, most_accel, slip

__all__ = [
    "FrictionFound",
    "FrictionMeasurement",
    "PartFriction",
    "Push",
    "Rest",
    "Stage",
    "make_push",
    "most_accel",
    "rig_mu",
    "slip",
]
