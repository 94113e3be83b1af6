"""The camera over the plate: images of parts through a lens, with height, light, blur and noise.

`Camera` draws, in `Lighting`. `part_colours` and `part_greys` are grey values of parts; `PLATE` is
the plate's, `ROOM` that around it, `NOISE` the noise of a pixel.
"""

from .camera import (
    GREY_OF_CLASS,
    NOISE,
    PENUMBRA_M,
    PLATE,
    ROOM,
    SHADOW_DEG,
    SHADOW_M,
    SIDE_SHADE,
    Camera,
    Lighting,
    part_colours,
    part_greys,
)

__all__ = [
    "GREY_OF_CLASS",
    "NOISE",
    "PENUMBRA_M",
    "PLATE",
    "ROOM",
    "SHADOW_DEG",
    "SHADOW_M",
    "SIDE_SHADE",
    "Camera",
    "Lighting",
    "part_colours",
    "part_greys",
]
