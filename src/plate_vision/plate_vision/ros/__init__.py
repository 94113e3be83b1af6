"""The parts of the detector node that are not needed for detection: its parameters, the view that
helps to aim the camera, and the conversion of camera_info."""

from .aiming import AimingView
from .image_topics import silence_advice
from .lens import lens_of
from .parameters import DetectorParameters

__all__ = ["AimingView", "DetectorParameters", "lens_of", "silence_advice"]
