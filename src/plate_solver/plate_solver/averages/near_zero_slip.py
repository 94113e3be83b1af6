"""Quadrature error of the mean over equal steps. It arises at times at which the slip of a part
nearly vanishes.

The slip's direction w/|w| is an analytic function of time, except at branch points with wx^2 + wy^2
= 0. A dip is a time at which the slip nearly vanishes. A dip corresponds to a pair of branch points
a + i b and a - i b near the real axis. The mean over n equal steps minus the true mean is exactly a
sum of integrals along the cuts that go up from the branch points. With t = a + i b cosh u the
integral of a dip is

    -2/pi Re integral of w / sqrt(Q) q / (1 + q) du from 0 to infinity,   q = exp(i n t)
    Q = (wx^2 + wy^2) / (-(b sinh u)^2)

The integrand is even and decreases like exp(-n b cosh u). Its poles are at Im u = pi/2 for any b.
Therefore the same few equal steps of u are sufficient for deep and shallow dips. No finer grid of
times is needed.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels


def find_dips(square: np.ndarray, n: int, found: np.ndarray) -> int:
    """Write the indices of the dips of a squared slip (n,) to `found` (n,). Return their number."""
    return _kernels.find_dips(square, n, found)


def branch_point(slip: np.ndarray, start: complex, close: float) -> tuple[complex, float, bool]:
    """Find the zero a + i b of wx + i wy near a time. Return exp(i a), the absolute value of b, and
    whether no other zero is within `close`.

    Parameters
    ----------
    slip : (2 N + 1, 2)
        Rows sin 1..N, cos 1..N, constant; columns x, y [m/s].
    start : complex
        exp(i t) at a minimum of the samples.
    close : float
        Maximum distance of another zero that counts as close [rad].
    """
    real, imag, b, alone = _kernels.branch_point(slip, start.real, start.imag, close)
    return complex(real, imag), b, alone
