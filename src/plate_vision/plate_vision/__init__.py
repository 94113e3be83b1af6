"""Finds parts in camera images and measures their positions and drift.

The names below are for all; the chapters `camera`, `plate`, `discs` and `shapes` have the rest.
"""

from .camera import Calibration, Lens, calibrate, calibrate_by_matrix, calibrate_by_rig
from .detection import BRIGHT, CLASSES, DETECTION, METHODS, DetectorOptions, detect
from .errors import CalibrationError, ImageError, OptionError, TrackError
from .plate import Region, make_region
from .tracking import Tracker, TrackerOptions
from .vision import Vision, make_vision, observe

__all__ = [
    "BRIGHT",
    "CLASSES",
    "DETECTION",
    "METHODS",
    "Calibration",
    "CalibrationError",
    "DetectorOptions",
    "ImageError",
    "Lens",
    "OptionError",
    "Region",
    "TrackError",
    "Tracker",
    "TrackerOptions",
    "Vision",
    "calibrate",
    "calibrate_by_matrix",
    "calibrate_by_rig",
    "detect",
    "make_region",
    "make_vision",
    "observe",
]
