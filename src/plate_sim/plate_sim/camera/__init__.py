"""The camera over the plate: images of parts through a lens, with shading, blur and noise.

Others use `Camera`, `part_colours` and `part_greys`; `PLATE` is the plate's grey value and `NOISE`
its noise.
"""

from .camera import NOISE, PLATE, Camera, Lighting, part_colours, part_greys

__all__ = ["NOISE", "PLATE", "Camera", "Lighting", "part_colours", "part_greys"]
