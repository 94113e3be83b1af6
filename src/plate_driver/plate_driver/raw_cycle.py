"""How long a plate cycle is, from its bytes alone: one that is too long is never unpacked."""

from __future__ import annotations

import struct

from plate_core import CycleError

POINT_BYTES = 256
"""Of a point with three joints, however it is written: 3 x (4 + 4 + 24) + 8 + 8, and room."""

HEAD_BYTES = 4096
"""Of all that comes before the points: a frame's and three joints' names."""

MOST_NAMES = 16


def check_length(data: bytes, size: int, most_points: int) -> None:
    """Refuse a trajectory_msgs/JointTrajectory (CDR) that has too many points.

    Parameters
    ----------
    data : bytes
        How it begins: `HEAD_BYTES` are enough.
    size : int
        Bytes of the whole.

    Raises
    ------
    CycleError
        Naming both numbers.
    """
    points = _points(data)
    if points is not None and points > most_points:
        raise CycleError(f"plate_cycle: {points} points, allowed: at most {most_points}")
    most = HEAD_BYTES + POINT_BYTES * most_points
    if size > most:
        raise CycleError(
            f"plate_cycle: {size} bytes, allowed: at most {most} (of {most_points} points)"
        )


def _points(data: bytes) -> int | None:
    """Number of points, as far as the beginning tells; None if it does not."""
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        return None
    order = "<" if data[1] == 1 else ">"
    body, at = memoryview(data)[4:], 8  # after the stamp

    def number() -> int:
        nonlocal at
        at += -at % 4
        value: int = struct.unpack_from(order + "I", body, at)[0]
        at += 4
        return value

    def text() -> None:
        nonlocal at
        length = number()
        at += length

    try:
        text()  # frame_id
        names = number()
        if names > MOST_NAMES:
            return None
        for _ in range(names):
            text()
        return number()
    except struct.error:
        return None
