"""The parts of the detector node that are not needed for detection: the view that helps to aim the
camera."""

from .aiming import AimingView

__all__ = ["AimingView"]
