"""The detector's model of the bare plate, for rigs with part types.

On request, the bare plate is learned from images. Without a request, the bare plate is modelled
from an image with parts. This model is then adapted to the light and the blur of each image. The
inputs are images and the plate's region. The output is the background that recognition subtracts.
"""

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
"""Number of images from which the bare plate is learned. The detector averages these images to
reduce the noise."""

MODELLED = "the bare plate is estimated from an image; remove all parts, then call ~/learn_plate"
"""Warning until the bare plate is learned."""


@dataclass(frozen=True, eq=False)
class BarePlate:
    """State of the bare plate.

    Attributes
    ----------
    learned : bool
        Whether the bare plate was learned from images. If False, the bare plate is modelled.
    first : Background, optional
        The background (image of the bare plate) when it was learned or modelled.
    light : Light, optional
        Change of the light from `first` to the last image.
    requested : int
        Number of images of the bare plate that are requested. 0 if none is requested.
    images : tuple of (H, W) or (H, W, 3) uint8
        Images received for the request.
    """

    learned: bool = False
    first: Background | None = None
    light: Light | None = None
    requested: int = 0
    images: tuple[np.ndarray, ...] = ()


def learn_next(plate: BarePlate, image: np.ndarray | None, region: Region) -> tuple[BarePlate, str]:
    """Request the next `BARE_IMAGES` images for learning. These images must show the bare plate.

    Return the new state, and a message for the user. If the last image (H, W) or (H, W, 3) shows
    objects on the plate, the message states the number of objects."""
    text = f"the next {BARE_IMAGES} images are used for the bare plate"
    things = "" if image is None else unexpected_objects_text(image, region)
    if things:
        text += f"; now {things}; if these are parts, remove them and call again"
    return replace(plate, requested=BARE_IMAGES, images=()), text


def know_plate(
    plate: BarePlate, vision: Vision, image: np.ndarray
) -> tuple[BarePlate, Vision, Finding | None]:
    """Process one image (H, W) or (H, W, 3). If requested, learn the bare plate from the image. If
    the bare plate is unknown, model it. If the bare plate is known, adapt its model to the light
    and blur of the image.

    Return the new state of the bare plate, a vision with the adapted background, and a finding for
    the user or None.

    Raises
    ------
    ImageError
        If too little of the plate is visible, because the image is too dark or the camera was
        moved.
    """
    if plate.requested:
        # `np.stack` requires equal shapes, so grey images and colour images cannot be mixed.
        alike = [earlier for earlier in plate.images if earlier.shape == image.shape]
        images = (*alike, image)
        if len(images) < plate.requested:
            return replace(plate, images=images), vision, None
        vision = replace(vision, background=learn_plate(np.stack(images)))
        text = f"bare plate learned from {len(images)} images"
        things, found = unexpected_objects_text(image, vision.region), Finding(Level.OK, text)
        if things:
            found = Finding(
                Level.WARN, f"{text}; {things}; if these are parts, remove them, and learn again"
            )
        return BarePlate(True, vision.background), vision, found
    if vision.background is None:
        vision = replace(vision, background=model_plate(image, vision.region))
        return BarePlate(False, vision.background), vision, Finding(Level.WARN, MODELLED)
    first = plate.first or vision.background
    light = first.light_of(image, vision.region, plate.light)
    lit = first.under(light, vision.region).softened(image, vision.region)
    vision = replace(vision, background=lit)
    return replace(plate, first=first, light=light), vision, None


def unexpected_objects_text(image: np.ndarray, region: Region) -> str:
    """Return a text with the number of objects on a plate that should be bare. The text is empty if
    no objects are detected."""
    count = len(find_patches(image, model_plate(image, region), region))
    return f"{count} object{'s are' if count > 1 else ' is'} on the plate" if count else ""
