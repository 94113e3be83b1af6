"""Teaching of part types while the detector runs. Each call of ~/teach adds one picture.

`Teaching` collects the pictures of one type. `learn_shown` learns the type from these pictures,
writes the type to a file, and returns a `Vision` that recognises the type.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from plate_core.rig import PartType

from .errors import TeachError
from .recognition import model_plate
from .shapes.catalogue import make_catalogue
from .shapes.part_files import add_type, lesson_text
from .shapes.teaching import MAX_PICTURES, Example
from .vision import Vision


@dataclass(frozen=True, eq=False)
class Teaching:
    """A type that is being taught: its name and its pictures."""

    name: str = ""
    examples: tuple[Example, ...] = ()

    def shown(self, name: str, image: np.ndarray) -> Teaching:
        """Return a copy with one more picture (H, W) or (H, W, 3). If the name differs from the
        last one, a new type starts with this picture.

        Raises
        ------
        TeachError
            If no name is given.
        """
        if not name:
            raise TeachError("teach_name is empty, allowed: the name of the type, such as nut")
        before = self.examples if name == self.name else ()
        example = Example(image, name=f"image {len(before) + 1}")
        return Teaching(name, (*before, example)[-MAX_PICTURES:])


def learn_shown(teaching: Teaching, vision: Vision, path: Path) -> tuple[PartType, Vision, str]:
    """Learn a type, and write it to a file of types.

    Return the type, a `Vision` that recognises the type, and a summary for the user.

    Raises
    ------
    TeachError
        If the type cannot be learned (see `learn_type`), or if it is too similar to another type
        (see `check_alike`).
    """
    image = teaching.examples[-1].image
    bare = vision.background or model_plate(image, vision.region)
    lesson = add_type(
        path, teaching.name, teaching.examples, vision.calibration, bare, vision.region
    )
    known = () if vision.catalogue is None else vision.catalogue.templates
    types = {template.part.name: template.part for template in known}
    catalogue = make_catalogue({**types, lesson.part.name: lesson.part})
    vision = replace(vision, catalogue=catalogue)
    text = "; ".join([lesson_text(lesson), f"written to {path}", *lesson.warnings])
    return lesson.part, vision, text
