"""Errors of this package whose cause the user can remove."""

from collections.abc import Mapping

import numpy as np

from plate_core import PlateError


class ImageError(PlateError):
    """An image cannot be used, or the given place of the plate in the image cannot be used."""


class CalibrationError(PlateError):
    """Image points and plate points do not determine a mapping between image and plate."""


class OptionError(PlateError):
    """An option is out of range."""


class TrackError(PlateError):
    """Measurements cannot be tracked because they have a wrong shape or values that are not
    finite."""


class TeachError(PlateError):
    """A type of part cannot be learned from these examples."""


def check_image(image: np.ndarray) -> None:
    """Raise ImageError if the array is not an image (H, W) or (H, W, 3) uint8."""
    if image.dtype != np.uint8:
        raise ImageError(f"image: values are {image.dtype}, allowed: uint8")
    if image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise ImageError(f"image: shape is {image.shape}, allowed: (H, W) or (H, W, 3), not empty")


def check_size(
    what: str,
    size_px: tuple[int, ...],
    allowed_px: tuple[int, ...],
    error: type[PlateError] = ImageError,
    why: str = "",
) -> None:
    """Raise an error if the width and height of an image [px] differ from the allowed ones. The
    message begins with `what` and ends with `why`."""
    if size_px != allowed_px:
        seen, allowed = (" x ".join(map(str, size)) for size in (size_px, allowed_px))
        turned = ""
        if size_px == allowed_px[::-1]:
            turned = "; width and height are exchanged, as by a rotation of 90 degrees"
        raise error(f"{what} {seen} px, allowed: {allowed} px{why}{turned}")


def check_ranges(options: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raise OptionError if a value of the options is out of its range."""
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        if not low <= value <= high:
            raise OptionError(f"{name} is {value}, allowed: {low:g} to {high:g}")
