"""The parts of the detector node that are not needed for detection: the view that helps to aim the
camera, and the conversion of camera_info."""

from .aiming import AimingView
from .lens import lens_of

__all__ = ["AimingView", "lens_of"]
