"""Functions for objects on the plate that do not belong to the task, or that the detector cannot
classify.

The detector publishes some of these objects as parts of the classes `unknown` and `group`. The
planner treats them like all parts without a goal. The planner keeps such objects on the plate and
away from the parts of the task. The detector publishes other objects only in its list of overlooked
objects. Parts may collide with these objects, so the planner reports them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from plate_core import (
    MAX_PARTS,
    NAMELESS,
    PLAUSIBLE_AREA,
    OverlookedThing,
    Parts,
    Rig,
    part_class,
)

SEVERAL = 5
"""Number of last images in which overlooked objects are counted. An object counts only if the
majority of these images shows it. This rejects short reflections."""

LISTED = 3
"""Maximum number of objects that a message lists with their positions. Further objects are only
counted."""


def is_bystander(part_id: str, labels: tuple[str, ...]) -> bool:
    """Whether a part is an object whose class the detector does not know. The result is False if
    this class is one of the task's classes `labels`."""
    label = part_class(part_id)
    return label in NAMELESS and label not in labels


def bystanders_text(parts: Parts, labels: tuple[str, ...]) -> str:
    """Return a text that lists the parts for which `is_bystander` is True. The text is empty if
    there are no such parts."""
    rows = [row for row, name in enumerate(parts.ids) if is_bystander(name, labels)]
    if not rows:
        return ""
    places = [f"{parts.ids[row]} {_place_text(*parts.position[row])}" for row in rows]
    is_ = "1 unknown object is" if len(rows) == 1 else f"{len(rows)} unknown objects are"
    return f"{is_} on the plate ({_join_texts(places)})"


def without_surplus(parts: Parts, labels: tuple[str, ...]) -> Parts:
    """Return at most `MAX_PARTS` of the parts, because the solver accepts no more. Unknown objects
    are removed first."""
    if len(parts) <= MAX_PARTS:
        return parts
    last = [is_bystander(name, labels) for name in parts.ids]
    return parts.take(np.sort(np.argsort(last, kind="stable")[:MAX_PARTS]))


@dataclass
class Overlooked:
    """Objects in the last images that may be parts, although the detector does not publish them as
    parts.

    Attributes
    ----------
    rig : Rig
    images : deque of tuple of OverlookedThing
        Overlooked objects in each of the last images.
    """

    rig: Rig
    images: deque[tuple[OverlookedThing, ...]] = field(
        default_factory=lambda: deque(maxlen=SEVERAL)
    )

    def add(self, things: tuple[OverlookedThing, ...], parts: Parts) -> None:
        """Record the overlooked objects and the parts of an image."""
        areas = [part.area_m2 for part in self.rig.types.values()]
        areas = areas or [np.pi * self.rig.parts.radius_m**2]
        low = np.sqrt(PLAUSIBLE_AREA[0] * min(areas) / np.pi)
        high = np.sqrt(PLAUSIBLE_AREA[1] * max(areas) / np.pi)
        # An object that extends beyond `inner` may be the plate's edge.
        inner = self.rig.plate.half - self.rig.limits.stroke_m
        candidates = []
        for thing in things:
            position = np.array([thing.x, thing.y])
            is_inside = bool(np.all(np.abs(position) + thing.radius <= inner))
            distance = np.hypot(*(parts.position - position).T)  # distance from the published parts
            if low <= thing.radius <= high and is_inside and not np.any(distance < thing.radius):
                candidates.append(thing)
        self.images.append(tuple(candidates))

    @property
    def count(self) -> int:
        """Median of the number of overlooked objects in the last images."""
        return int(np.median([len(image) for image in self.images])) if self.images else 0

    @property
    def text(self) -> str:
        """Text with the number and the positions of overlooked objects. Empty if there are no such
        objects."""
        count = self.count
        if not count:
            return ""
        shown = next(image for image in reversed(self.images) if len(image) >= count)
        places = [f"{thing.reason} {_place_text(thing.x, thing.y)}" for thing in shown[:count]]
        more = "1 undetected object"
        if count > 1:
            more = f"{count} undetected objects"
        return (
            f"the image shows {more} ({_join_texts(places)}), which may be parts: other parts may "
            "hit them (see the detector's diagnostics)"
        )


def _place_text(x: float, y: float) -> str:
    return f"at ({x:.3f}, {y:.3f}) m"


def _join_texts(texts: list[str]) -> str:
    more = len(texts) - LISTED
    return ", ".join(texts[:LISTED]) + (f" and {more} more" if more > 0 else "")
