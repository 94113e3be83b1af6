"""Learning the plate: what it makes of a command at each frequency, from three known motions.

`Calibration` and `Experiment` are the procedure, `Response` is what it finds and keeps in a file.
"""

from .calibration import (
    COUNT,
    PERIOD_S,
    Calibration,
    Experiment,
    check_writable,
    save_response,
    saved_response,
)
from .response import Response, closed_at_rest, harmonics

__all__ = [
    "COUNT",
    "PERIOD_S",
    "Calibration",
    "Experiment",
    "Response",
    "check_writable",
    "closed_at_rest",
    "harmonics",
    "save_response",
    "saved_response",
]
