"""Detection of parts with any outline. Such parts are patches that differ from the bare plate or
from a photograph's background.

`learn_plate` and `model_background` return a background, and `find_patches` returns the patches
that differ from it. `teach` learns part types, and `plate_vision.find_parts` determines the types
of patches. `teach_parts` is the program `teach`.
"""

from .background import Background, learn_plate, model_background
from .catalogue import make_catalogue
from .classes import GROUP, UNKNOWN, recognise, to_lab
from .patch import Patch
from .photograph import OUTLINE, find_outlines
from .segmentation import find_patches
from .teaching import Example, Lesson, learn_type, teach

__all__ = [
    "GROUP",
    "OUTLINE",
    "UNKNOWN",
    "Background",
    "Example",
    "Lesson",
    "Patch",
    "find_outlines",
    "find_patches",
    "learn_plate",
    "learn_type",
    "make_catalogue",
    "model_background",
    "recognise",
    "teach",
    "to_lab",
]
