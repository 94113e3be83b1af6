"""Size check of a serialized plate cycle. The number of points is read from the first bytes of the
message (Common Data Representation, CDR), so a cycle that is too long is never deserialized."""

from __future__ import annotations

import struct

from plate_core import CycleError

POINT_BYTES = 256
"""Maximum size of a point with three joints [bytes]: 3 x (4 + 4 + 24) + 8 + 8 = 112, plus a
margin."""

HEAD_BYTES = 4096
"""Maximum size of the data before the points [bytes]: the names of a frame and of three joints."""

MAX_NAMES = 16


def check_length(data: bytes, size: int, max_points: int) -> None:
    """Refuse a trajectory_msgs/JointTrajectory (CDR) that has too many points.

    Parameters
    ----------
    data : bytes
        First bytes of the message. The first `HEAD_BYTES` bytes are enough.
    size : int
        Size of the whole message [bytes].

    Raises
    ------
    CycleError
        If the message is too long. The text states the actual and the allowed number.
    """
    points = _read_point_count(data)
    if points is not None and points > max_points:
        raise CycleError(f"plate_cycle: {points} points, allowed: at most {max_points}")
    max_size = HEAD_BYTES + POINT_BYTES * max_points
    if size > max_size:
        raise CycleError(
            f"plate_cycle: {size} bytes, allowed: at most {max_size} (for {max_points} points)"
        )


def _read_point_count(data: bytes) -> int | None:
    """Return the number of points. None if the number cannot be read from `data`."""
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        return None
    order = "<" if data[1] == 1 else ">"
    body, offset = memoryview(data)[4:], 8  # after the stamp

    def read_number() -> int:
        nonlocal offset
        offset += -offset % 4
        value: int = struct.unpack_from(order + "I", body, offset)[0]
        offset += 4
        return value

    def skip_text() -> None:
        nonlocal offset
        length = read_number()
        offset += length

    try:
        skip_text()  # frame_id
        names = read_number()
        if names > MAX_NAMES:
            return None
        for _ in range(names):
            skip_text()
        return read_number()
    except struct.error:
        return None
