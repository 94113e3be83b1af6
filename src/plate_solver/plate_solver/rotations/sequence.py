"""A sequence of rotations as one closed motion in time, from rest to rest.

Rotation j has a constant twist u_j during its hold. A smooth ramp connects rotation j to the next
rotation. The acceleration limit a determines the length h of the ramp. A smooth correction over the
whole period T removes the gap between end and start. Therefore every sequence closes exactly:

    twist on a ramp   u_j + (u_{j+1} - u_j) x^2 (3 - 2 x),    x from 0 to 1,
    length            h = 1.5 (velocity change of the fastest corner) / a,
    pose              integral of the twist - gap y^3 (10 - 15 y + 6 y^2),    y = t/T.

The derivatives are exact. One backward pass over the knots computes the derivatives (sequence.hpp).

Knots of J rotations: knot 0 is the start at rest. Knots 2 j + 1 and 2 j + 2 are the start and the
end of rotation j (counted from 0). At knot 2 J + 1 the plate comes to rest. Knot 2 J + 2 is the end
of the period.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels


def knot_poses(times: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the pose (K, 3) at every knot, without the correction that closes the motion."""
    return _kernels.knot_poses(times, knots)


def motion(
    times: np.ndarray, knots: np.ndarray, counts: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return pose, twist and acceleration (n, 3) at the middles of the steps, the step lengths (n,)
    [s], and the gap (3,) between end and start. The gap is measured before the correction that
    closes the motion. The returned motion includes this correction.

    Each ramp has `counts[0]` equal steps, and each hold has `counts[1]` equal steps. No step
    crosses the end of a ramp or hold. Therefore the results depend on the parameters as smoothly as
    the friction model permits.
    """
    return _kernels.motion(times, knots, counts)
