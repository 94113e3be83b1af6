"""Errors of this package that a user can act on."""

from collections.abc import Mapping

from plate_core import PlateError


class ImageError(PlateError):
    """An image, or where the plate is said to be in it, cannot be used."""


class CalibrationError(PlateError):
    """Image points and plate points do not give a mapping between image and plate."""


class OptionError(PlateError):
    """An option is out of range."""


class TrackError(PlateError):
    """Measurements cannot be followed: wrong shape, or values that are not finite."""


class TeachError(PlateError):
    """A type of part cannot be learned from these examples."""


def check_ranges(options: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Refuse options of which a value is out of its range."""
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        if not low <= value <= high:
            raise OptionError(f"{name} is {value}, allowed: {low:g} to {high:g}")
