"""Part of the detector node besides detection: the view for aiming the camera."""

from .aiming import AimingView

__all__ = ["AimingView"]
