"""Finds parts in camera images and measures their positions and drift."""

from .calibration import Calibration, Lens, calibrate, calibrate_by_matrix, calibrate_by_rig
from .detection import BRIGHT, CLASSES, DETECTION, METHODS, detect
from .errors import CalibrationError, ImageError, OptionError, TrackError
from .options import DetectorOptions
from .tracking import Tracker, TrackerOptions
from .vision import Vision, look, make_vision

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
    "TrackError",
    "Tracker",
    "TrackerOptions",
    "Vision",
    "calibrate",
    "calibrate_by_matrix",
    "calibrate_by_rig",
    "detect",
    "look",
    "make_vision",
]
