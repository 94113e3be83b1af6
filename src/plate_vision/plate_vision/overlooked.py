"""Things that the detector sees on the plate and does not take for parts, each with its reason."""

from __future__ import annotations

import numpy as np

REASONS = (
    "too small",
    "too large",
    "too faint",
    "misfit",
    "at the edge",
    "beyond the plate",
    "group",
)
"""Why a thing is not a part: its size is below or above that of the rig's parts; its contrast to
the plate is too low; its shape is not a part's; the plate's edge cuts it; its centre is not on the
plate; it seems to be several parts that could not be told apart."""

OVERLOOKED = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("x", "f8"),
        ("y", "f8"),
        ("reason", "U16"),
    ]
)
"""One thing that is not taken for a part: centre and radius [px] of the disc of the same area;
centre [m, plate_home]; one of `REASONS`."""

NONE_OVERLOOKED = np.empty(0, OVERLOOKED)
"""No such thing, (0,) `OVERLOOKED`."""
NONE_OVERLOOKED.setflags(write=False)
