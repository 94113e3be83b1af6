"""Parts of the detector node other than detection: the view for aiming the camera."""

from .aiming import AimingView

__all__ = ["AimingView"]
