"""What the detector knows of the bare plate, and how it comes to know it: for rigs with types."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plate_core.status import Finding, Level

from .plate import Region
from .recognition import model_plate
from .shapes import Background, find_patches, learn_plate
from .shapes.lighting import Light
from .vision import Vision

__all__ = ["BARE_IMAGES", "MODELLED", "BarePlate", "know_plate", "learn_next"]

BARE_IMAGES = 5
"""From which the bare plate is learned: their noise averages out."""

MODELLED = "the bare plate is modelled from an image with parts: call ~/learn_plate when it is bare"
"""What to know when nobody has shown the bare plate."""


@dataclass(frozen=True, eq=False)
class BarePlate:
    """What is known of the bare plate.

    Attributes
    ----------
    learned : bool
        From images of it: else it is modelled.
    first : Background, optional
        As it was learned or modelled.
    light : Light, optional
        That of the last image, relative to `first`.
    wanted : int
        Images of the bare plate that are waited for; 0: none.
    images : tuple of (H, W) or (H, W, 3) uint8
        Those that came.
    """

    learned: bool = False
    first: Background | None = None
    light: Light | None = None
    wanted: int = 0
    images: tuple[np.ndarray, ...] = ()


def learn_next(plate: BarePlate, image: np.ndarray | None, region: Region) -> tuple[BarePlate, str]:
    """Begin to learn: the next images show the bare plate. Returns also what a user should know, by
    the last image (H, W) or (H, W, 3)."""
    text = f"the next {BARE_IMAGES} images are taken for the bare plate"
    things = "" if image is None else lying(image, region)
    if things:
        text += f"; {things} now: if these are parts, take them off, and call again"
    return replace(plate, wanted=BARE_IMAGES, images=()), text


def know_plate(
    plate: BarePlate, vision: Vision, image: np.ndarray
) -> tuple[BarePlate, Vision, Finding | None]:
    """Process one image (H, W) or (H, W, 3): learn the bare plate if requested, model it if it is
    unknown, otherwise follow its light and focus.

    Return the new state of the bare plate, a vision with the background in this light, and a
    finding for the user.

    Raises
    ------
    ImageError
        If too little of the plate is seen: it is too dark, or the camera was moved.
    """
    if plate.wanted:
        alike = [one for one in plate.images if one.shape == image.shape]  # grey, or in colours
        images = (*alike, image)
        if len(images) < plate.wanted:
            return replace(plate, images=images), vision, None
        vision = replace(vision, background=learn_plate(np.stack(images)))
        text, things = f"bare plate learned from {len(images)} images", lying(image, vision.region)
        found = Finding(Level.OK, text)
        if things:
            found = Finding(Level.WARN, f"{text}; {things}: if these are parts, learn it again")
        return BarePlate(True, vision.background), vision, found
    if vision.background is None:
        vision = replace(vision, background=model_plate(image, vision.region))
        return BarePlate(False, vision.background), vision, Finding(Level.WARN, MODELLED)
    first = plate.first or vision.background
    light = first.light_of(image, vision.region, plate.light)
    lit = first.under(light, vision.region).softened(image, vision.region)
    vision = replace(vision, background=lit)
    return replace(plate, first=first, light=light), vision, None


def lying(image: np.ndarray, region: Region) -> str:
    """Say what seems to lie on a plate that should be bare; nothing if it seems to be bare."""
    count = len(find_patches(image, model_plate(image, region), region))
    return f"{count} thing{'s lie' if count > 1 else ' lies'} on it" if count else ""
