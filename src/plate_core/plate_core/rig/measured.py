"""Detection of values in a rig file that were not measured. Such values are the same as in a
shipped rig file."""

from __future__ import annotations

import numpy as np

from .lens import Lens
from .rig import Rig
from .rig_file import load_rig, rig_names


def unmeasured(rig: Rig) -> list[str]:
    """Return one sentence for each value that must still be measured. The sentence contains the
    command for the measurement.

    A value counts as not measured if a shipped rig file has the same value. `rig_warnings` finds
    inconsistent values.
    """
    shipped = [load_rig(name) for name in ("", *rig_names())]
    corners = np.array(rig.camera.corners_px)
    copied = any(np.array_equal(corners, other.camera.corners_px) for other in shipped)
    lens = rig.camera.lens
    typical = any(_is_same_lens(lens, other.camera.lens) for other in shipped)
    found = []
    if lens is None or typical:
        found.append(
            "lens: not calibrated. Take pictures of a printed board, then: ros2 run plate_vision "
            "calibrate lens PICTURES --board 9x7 --square 0.03 --marker 0.022"
        )
    if copied and rig.fiducials is None:
        found.append(
            "corners: corners_px are unchanged from a shipped rig file. Put markers on the plate "
            "(ros2 run plate_vision calibrate markers), or measure the plate's corners in an image"
        )
    if any(rig.friction.mu == other.friction.mu for other in shipped):
        found.append(
            f"friction: mu is {rig.friction.mu:g}, unchanged from a shipped rig file. Put parts on "
            "the plate, enable the motors, then: plate friction"
        )
    return found


def _is_same_lens(a: Lens | None, b: Lens | None) -> bool:
    return (
        a is not None
        and b is not None
        and np.array_equal(a.matrix, b.matrix)
        and list(a.distortion) == list(b.distortion)
    )
