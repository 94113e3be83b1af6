"""Whether an image has light enough to find anything in it, and not too much."""

from __future__ import annotations

import numpy as np

STEP = 8
"""Of the image every eighth row and column is looked at."""

BRIGHT_PERCENTILE = 95
"""Brightness below which almost all of the image is: a twentieth may be lamps and glare."""

DARK_PERCENTILE = 50
"""A plate that is burnt out fills more than half of the image."""

BURNT_GREY = 254
"""Grey level from which a pixel may have been any brighter."""


def light_problem(image: np.ndarray, min_grey: float) -> str | None:
    """Return what is wrong with the light of an image (H, W) or (H, W, 3) uint8, or None.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels.
    min_grey : float
        Darkest plate that is believed [grey levels].
    """
    sample = image[::STEP, ::STEP]
    grey = sample if sample.ndim == 2 else sample[:, :, 1]
    bright, middle = np.percentile(grey, (BRIGHT_PERCENTILE, DARK_PERCENTILE))
    if bright < min_grey:
        return (
            f"{BRIGHT_PERCENTILE} % of the image is darker than {bright:.0f} grey levels, allowed: "
            f"a plate of {min_grey:g} at least (is the light on, the lens open?)"
        )
    if middle >= BURNT_GREY:
        return (
            f"half of the image is burnt out ({middle:.0f} grey levels), allowed: less than "
            f"{BURNT_GREY} (expose for a shorter time)"
        )
    return None
