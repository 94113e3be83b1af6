"""What equal steps miss where the surface almost stands still under a part: a closed correction.

The slip's direction w/|w| is an analytic function of time but for branch points where
wx^2 + wy^2 = 0. A dip is a pair of them, a + i b and a - i b, near the real axis. The mean over n
equal steps less the true mean is, exactly, a sum of integrals around the cuts that go up from the
branch points: with t = a + i b cosh u

    -2/pi Re integral of w / sqrt(Q) q / (1 + q) du from 0 to infinity,   q = exp(i n t)
    Q = (wx^2 + wy^2) / (-(b sinh u)^2)

The integrand is even, falls like exp(-n b cosh u), and has its poles at Im u = pi/2 whatever b is.
So a few equal steps of u give it, for deep dips as for shallow ones: a contour instead of a grid.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels


def find_dips(square: np.ndarray, n: int, found: np.ndarray) -> int:
    """Write the indices of the dips of a squared slip (n,) to `found` (n,); return how many."""
    return _kernels.find_dips(square, n, found)


def branch_point(slip: np.ndarray, start: complex, close: float) -> tuple[complex, float, bool]:
    """Return exp(i a), b of the zero of wx + i wy near a time, and whether it is alone there.

    Parameters
    ----------
    slip : (2 N + 1, 2)
        Rows sin 1..N, cos 1..N, constant; columns x, y [m/s].
    start : complex
        exp(i t) at a minimum of the samples.
    close : float
        Distance [rad] within which other zeros are not welcome.
    """
    real, imag, b, alone = _kernels.branch_point(slip, start.real, start.imag, close)
    return complex(real, imag), b, alone
