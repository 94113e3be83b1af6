"""The project's detector with taught types. The detector gets at most five examples of each class,
and must find and classify the other parts.

A class such as `coin` can contain several types. If the examples of a class differ too much for one
type, each example is taught as a separate type.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from photographs.finders import FINDING, as_findings
from plate_core import NAMELESS, PlateError
from plate_vision import calibrate_by_scale, find_parts
from plate_vision.shapes import Example, model_background, teach

MAX_EXAMPLES = 5
"""Maximum number of examples of a class."""

SCALE = 1000.0
"""Assumed scale of the pictures [px/m], 1 mm per pixel. The actual scale is unknown."""


def teach_examples(
    image: np.ndarray, parts: np.ndarray
) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray, list[str]]:
    """Teach the classes of a picture by examples in it.

    Parameters
    ----------
    image : (H, W, 3) uint8
        Blue, green, red.
    parts : (n,) TRUTH
        At most `MAX_EXAMPLES` parts of a class are used as examples. Parts that touch no other part
        are preferred.

    Returns
    -------
    finder, shown, refused
        `find_taught` is the taught detector, a function from an image to (m,) FINDING. `shown` (n,)
        bool is True for the parts that were used as examples. `refused` contains the refused
        examples and the reasons.
    """
    calibration = calibrate_by_scale(SCALE)
    bare = model_background(image)
    types: dict[str, Any] = {}
    class_of: dict[str, str] = {}
    refused = []
    shown = np.zeros(len(parts), bool)
    for label in sorted(set(parts["label"])):
        those = np.flatnonzero(parts["label"] == label)
        those = those[np.argsort(parts["touching"][those], kind="stable")][:MAX_EXAMPLES]
        together = {label: those}
        apart = {f"{label}_{letter}": [i] for letter, i in zip("vwxyz", those, strict=False)}
        for lessons in (together, apart):
            for name, indices in lessons.items():
                examples = [Example(image, _example_box(parts[i])) for i in indices]
                try:
                    types |= teach({name: examples}, calibration, bare)
                except PlateError as problem:
                    refused.append(str(problem))
                else:
                    shown[indices] = True
                    class_of[name] = label
            if label in types:
                break

    def find_taught(picture: np.ndarray) -> np.ndarray:
        if not types:
            return np.zeros(0, FINDING)
        seen = find_parts(picture, types, scale=SCALE)
        seen = seen[~np.isin(seen["label"], NAMELESS)]
        return as_findings(seen, [class_of[label] for label in seen["label"]])

    return find_taught, shown, refused


def _example_box(part: np.ndarray) -> tuple[float, float, float, float]:
    """Return the box x0, y0, x1, y1 that contains the centre of an example [px]."""
    reach = 0.5 * float(part["radius_px"])
    x, y = float(part["x_px"]), float(part["y_px"])
    return x - reach, y - reach, x + reach, y + reach
