"""Calibration of the plate: its frequency response, measured with three known motions.

`Calibration` and `Experiment` define the procedure, and `CalibrationRun` executes it. The result is
a `Response`, which is stored in a file.
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
from .run import CalibrationRun

__all__ = [
    "COUNT",
    "PERIOD_S",
    "Calibration",
    "CalibrationRun",
    "Experiment",
    "Response",
    "check_writable",
    "closed_at_rest",
    "harmonics",
    "save_response",
    "saved_response",
]
