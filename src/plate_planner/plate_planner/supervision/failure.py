"""What is said of a part for which a task does not get on: part of the failure's reason."""

from __future__ import annotations

import numpy as np

from plate_core import Parts, Rig

from ..estimation import LastRequest


def shortfall_text(request: LastRequest, rig: Rig, parts: Parts, distance: np.ndarray) -> str:
    """Say which part is furthest from where it should be (M,) [m], and what was asked of it."""
    if not len(distance):
        return ""
    worst = int(np.argmax(distance))
    name = parts.ids[worst]
    text = f"{name} is {distance[worst] * 1e3:.1f} mm short"
    if name not in request.ids:
        return text
    row = request.ids.index(name)
    drift, force = 1e3 * request.drift[row], 1e3 * request.force[row]
    got, most = 1e3 * parts.velocity[worst], 1e3 * rig.force_unit
    return (
        f"{text}, asked for ({drift[0]:.1f}, {drift[1]:.1f}) mm/s with ({force[0]:.2f}, "
        f"{force[1]:.2f}) mN of {most:.1f}, had ({got[0]:.1f}, {got[1]:.1f}) mm/s"
    )
