"""Simulated camera above the plate. The camera renders images of the parts with lens distortion,
part heights, light, blur and noise.

`Camera` renders an image in a given `Lighting`. The functions `part_colours` and `part_greys`
return the grey values of parts. The exported constants are default grey values, the default noise,
and default properties of the shadows.
"""

from .camera import (
    GREY_OF_CLASS,
    NOISE,
    PENUMBRA_M,
    PLATE,
    SHADOW_DEG,
    SHADOW_M,
    SIDE_SHADE,
    SURROUNDINGS,
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
    "SHADOW_DEG",
    "SHADOW_M",
    "SIDE_SHADE",
    "SURROUNDINGS",
    "Camera",
    "Lighting",
    "part_colours",
    "part_greys",
]
