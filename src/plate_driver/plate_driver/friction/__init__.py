"""Friction of the parts, measured by known pushes of the plate and the camera.

`FrictionMeasurement` is the procedure and `FrictionResult` its result. `make_push` computes the
motion of a push, and `slip` computes the slip of a part during the push.
"""

from .measurement import FrictionMeasurement, FrictionResult, PartFriction, Rest, Stage, rig_mu
from .push import Push, make_push, max_accel, slip

__all__ = [
    "FrictionMeasurement",
    "FrictionResult",
    "PartFriction",
    "Push",
    "Rest",
    "Stage",
    "make_push",
    "max_accel",
    "rig_mu",
    "slip",
]
