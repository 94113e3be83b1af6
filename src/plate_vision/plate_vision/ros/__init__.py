"""What the detector node has beside the detection: the view to aim by."""

from .aiming import AimingView

__all__ = ["AimingView"]
