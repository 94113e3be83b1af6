"""The camera over the plate: images of parts through a lens, with shading, blur and noise.

Others use `Camera` and `part_greys`; `PLATE` is the plate's grey value and `NOISE` its noise.
"""

from .camera import NOISE, PLATE, Camera, part_greys
from .raster import Outline

__all__ = ["NOISE", "PLATE", "Camera", "Outline", "part_greys"]
