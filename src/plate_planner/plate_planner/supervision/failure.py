"""Texts for failed tasks. The texts describe the cause, the measured values and a remedy.

`loss_of` explains a lost part by its last position and by objects near this position.
`shortfall_text` compares the requested drift with the actual drift of a part. `outlook` warns of a
low shaking ratio before a task starts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import NAMELESS, Parts, Rig, part_class
from plate_core.rig import MIN_GAMMA

from ..estimation import LastRequest
from .phase import CHECK_IMAGE, Failure, Reason

NEAR_EDGE = 3.0
"""If a lost part was last detected within this distance of an edge, it counts as having left the
plate [part radii]."""

SAME_PLACE = 3.0
"""If an unknown object is within this distance of the last position of a lost part, it counts as
this part [part radii]."""

NOBODY = Parts.make((), np.zeros((0, 2)))

FEW = 5
"""Number of parts that the plate can move independently. With more parts, only few cycles move all
parts as requested."""

AT_REST_MPS = 0.5e-3
"""If the requested drift of a part is below this value, no motion of the part is expected [m/s]."""


class LastSeen(NamedTuple):
    """Position (x, y) [m, plate_home] and stamp [s] of a part's last detection."""

    position: tuple[float, float]
    stamp: float


def loss_of(
    name: str, last: LastSeen | None, began: float, rig: Rig, count: int, parts: Parts = NOBODY
) -> Failure:
    """Return the failure of a task in which a part is no longer detected. The text of the failure
    contains a remedy.

    `last` is the last detection of the part, or None if it was never detected. `began` is the start
    of the task [s], `count` is the number of parts, and `parts` are the parts in the image.
    """
    if last is None:
        return Failure(Reason.PART_UNSEEN, f"{name} was not detected; {CHECK_IMAGE}")
    x, y = last.position
    where = f"at ({x:.3f}, {y:.3f}) m, {last.stamp - began:.1f} s after the start"
    distance = np.hypot(*(parts.position - last.position).T)
    for row in np.flatnonzero(distance < SAME_PLACE * rig.parts.radius_m):
        if part_class(parts.ids[row]) in NAMELESS:
            text = f"{name} was last detected {where}, where {parts.ids[row]} is now"
            return Failure(
                Reason.PART_UNSEEN, f"{text}: its class is no longer recognised; {CHECK_IMAGE}"
            )
    edge = float(np.min(rig.plate.half - np.abs(last.position)))
    if edge > NEAR_EDGE * rig.parts.radius_m:
        text = f"{name} was last detected {where}, {1e3 * edge:.0f} mm from the edge; {CHECK_IMAGE}"
        return Failure(Reason.PART_UNSEEN, text)
    more = " or fewer parts" if count > FEW else ""
    return Failure(
        Reason.PART_LEFT,
        f"{name} left the plate {where}; starts and goals farther from the edges{more} would "
        "keep it on the plate",
    )


def shortfall_text(
    request: LastRequest, rig: Rig, parts: Parts, distance: np.ndarray, count: int
) -> str:
    """Return a text about the part that has the largest distance from its goal. `distance` (M,) [m]
    contains the distances of all parts. The text states the requested and the actual drift of the
    part, and a remedy."""
    if not len(distance):
        return ""
    worst = int(np.argmax(distance))
    name, (x, y) = parts.ids[worst], parts.position[worst]
    text = f"{name} at ({x:.3f}, {y:.3f}) m has {distance[worst] * 1e3:.1f} mm to go"
    if name not in request.ids:
        return text
    row = request.ids.index(name)
    drift, got = request.drift[row], parts.velocity[worst]
    part = rig.part_type(part_class(name))
    bound = 1e3 * (part.mass_kg or 0.0) * (part.mu or 0.0) * rig.friction.gravity
    force = 1e3 * float(np.hypot(*request.force[row]))
    text += (
        f": its requested drift was ({1e3 * drift[0]:.1f}, {1e3 * drift[1]:.1f}) mm/s (which needs "
        f"{force:.1f} of {bound:.1f} mN of friction), its actual drift was ({1e3 * got[0]:.1f}, "
        f"{1e3 * got[1]:.1f}) mm/s"
    )
    size = float(np.hypot(*drift))
    if size < AT_REST_MPS or float(drift @ got) > 0.5 * size**2:
        return text
    return f"{text}; {remedy_text(rig, count)}"


def outlook(rig: Rig, count: int, time_limit_s: float) -> str:
    """Return a warning if the shaking ratio is too low for the task. The text is empty if the ratio
    is high enough."""
    if rig.gamma >= MIN_GAMMA:
        return ""
    expect = "longer"
    if count > FEW:
        expect = "several times as long"
        if np.isfinite(time_limit_s):
            expect += f", and some runs may exceed time_limit_s, {time_limit_s:g} s"
    return f"{remedy_text(rig, count)}; expect the task to take {expect}"


def remedy_text(rig: Rig, count: int) -> str:
    """Return a text that proposes a remedy if parts do not move as requested."""
    if rig.gamma < MIN_GAMMA:
        return weak_plate_text(rig)
    if count > FEW:
        return f"{count} parts at once are hard to control: use fewer parts or more space"
    return (
        "friction.mu or the motors may differ from the rig file, or an obstacle blocks "
        "the part (calibrate the rig)"
    )


def weak_plate_text(rig: Rig) -> str:
    """Return a text that describes a shaking ratio below `MIN_GAMMA`."""
    return (
        f"the plate shakes too little: shaking ratio {rig.gamma:.1f}, limited by "
        f"{rig.reach.limit}, advised: {MIN_GAMMA:g} or more (see check_rig)"
    )
