"""Measurement of the parts' friction. The plate makes known pushes, and the camera measures the
displacements of the parts.

`FrictionMeasurement` is the procedure, and `FrictionResult` is its result. `make_push` computes the
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
