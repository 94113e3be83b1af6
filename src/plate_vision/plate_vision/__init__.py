"""Finds parts in camera images and measures their positions and drift.

The names below are public. The subpackages `camera`, `plate`, `discs`, `shapes` and `tracking`
implement the methods.
"""

from .camera import Calibration, Lens, calibrate, calibrate_by_matrix, calibrate_by_rig
from .detection import BRIGHT, CLASSES, DETECTION, METHODS, DetectorOptions, detect
from .errors import CalibrationError, ImageError, OptionError, TeachError, TrackError
from .overlooked import OVERLOOKED, REASONS
from .plate import Region, make_region
from .recognition import calibrate_by_scale, find_parts, find_types
from .tracking import Prediction, Tracker, TrackerOptions
from .vision import Vision, make_vision, observe

__all__ = [
    "BRIGHT",
    "CLASSES",
    "DETECTION",
    "METHODS",
    "OVERLOOKED",
    "REASONS",
    "Calibration",
    "CalibrationError",
    "DetectorOptions",
    "ImageError",
    "Lens",
    "OptionError",
    "Prediction",
    "Region",
    "TeachError",
    "TrackError",
    "Tracker",
    "TrackerOptions",
    "Vision",
    "calibrate",
    "calibrate_by_matrix",
    "calibrate_by_rig",
    "calibrate_by_scale",
    "detect",
    "find_parts",
    "find_types",
    "make_region",
    "make_vision",
    "observe",
]
