"""The plate in the image: its region, its outline, the light on it, and its pose determined by
markers.

Other packages use the names below. A `Region` is made once and used for many images.
"""

from .contrast import brightness, channels_of, contrast_image
from .home import PlateLocation, find_home, locate_plate
from .light import LitPlate, fit_light, light_problem
from .outline import OutlineCheck
from .region import Region, make_region

__all__ = [
    "LitPlate",
    "OutlineCheck",
    "PlateLocation",
    "Region",
    "brightness",
    "channels_of",
    "contrast_image",
    "find_home",
    "fit_light",
    "light_problem",
    "locate_plate",
    "make_region",
]
