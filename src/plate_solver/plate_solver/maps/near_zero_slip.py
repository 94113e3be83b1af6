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

from math import cosh, exp, log, pi, sinh, sqrt

import numpy as np

from plate_core.kernels import kernel

STEP = 0.55
"""Step of u: errs by exp(-pi^2 / STEP) = 2e-8 of the integrand."""

WEIGHT = 2 / pi * STEP
"""Of a node: the integrand is even, half of it is summed."""

PLACES = (np.arange(44) + 0.5) * STEP
COSH, SINH = np.cosh(PLACES), np.sinh(PLACES)
"""Nodes: enough for the narrowest dip."""

NARROWEST = 1e-10
"""Least b [rad]: a narrower dip is a jump to all that matters."""

FADED = 17.0
"""n b cosh u beyond which nothing is left: 4e-8."""

NEAR = 14.0
"""n b from which a dip needs no correction: equal steps err by exp(-n b)."""

CLOSE = 4.0
"""Steps within which a second dip may hide from the samples, beside the first."""

STEPS_NEAR = (NEAR / (2 * pi)) ** 2 / 2
"""The same for the parabola's lowest point, in units of its bend, with time in steps."""

NEWTON_STEPS = 10
"""Steps to a zero at most; from a minimum of the samples three are usual."""


@kernel(fastmath=True, error_model="numpy", inline="always")
def _is_dip(before: float, here: float, after: float) -> float:
    """Return a positive number if three samples have a minimum whose parabola has n b < `NEAR`."""
    bend, slope = before - 2 * here + after, after - before
    depth = STEPS_NEAR * bend * bend - (here * bend - slope * slope / 8)
    return depth if here <= before and here < after else -1.0


@kernel(fastmath=True, error_model="numpy")
def find_dips(square: np.ndarray, n: int, found: np.ndarray) -> int:
    """Write the indices of the dips of a squared slip (n,) to `found` (n,); return how many."""
    found[0] = _is_dip(square[n - 1], square[0], square[1])
    for k in range(1, n - 1):
        found[k] = _is_dip(square[k - 1], square[k], square[k + 1])
    found[n - 1] = _is_dip(square[n - 2], square[n - 1], square[0])
    count = 0
    for k in range(n):  # without branches
        hit = found[k] > 0.0
        found[count] = k
        count += hit
    return count


@kernel(fastmath=True, error_model="numpy")
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
    number = len(slip) // 2
    z = start  # z^N (wx + i wy) is a polynomial of z = exp(i t)
    bend = slope = 1j
    last = off = 1.0
    for _ in range(NEWTON_STEPS):
        value = slope = bend = 0j
        for k in range(number, -number - 1, -1):
            if k > 0:
                s, c = k - 1, number + k - 1
                term = complex((slip[c, 0] + slip[s, 1]) / 2, (slip[c, 1] - slip[s, 0]) / 2)
            elif k < 0:
                s, c = -k - 1, number - k - 1
                term = complex((slip[c, 0] - slip[s, 1]) / 2, (slip[c, 1] + slip[s, 0]) / 2)
            else:
                term = complex(slip[2 * number, 0], slip[2 * number, 1])
            bend = bend * z + slope
            slope = slope * z + value
            value = value * z + term
        step = value * slope.conjugate() * (1 / (_square(slope) + 1e-300))
        z -= step
        last, off = _square(step), (_square(z) - 1) / 2
        if last < 1e-10 * off * off or last < 1e-24:
            break
    radius = sqrt(_square(z)) + 1e-300
    done = last < 1e-8 * off * off or last < 1e-22
    # bend / slope is the sum of 1 / (z - other zero): large if one is close.
    lonely = _square(bend) * close * close < _square(slope)
    return z * (1 / radius), max(abs(log(radius)), NARROWEST), done and lonely


@kernel(fastmath=True, error_model="numpy", inline="always")
def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


@kernel(fastmath=True, error_model="numpy")
def excess(
    slip: np.ndarray, start: complex, n: int, gradient: np.ndarray
) -> tuple[float, float, bool]:
    """Return by how much the mean of n steps is too high, due to the dip near a time.

    Parameters
    ----------
    slip : (2 N + 1, 2)
        As `branch_point`.
    start : complex
        exp(i t) at the minimum of the samples.
    n : int
        Steps, N times a power of 2, with nodes at their middles.
    gradient : (3, 2 N) or (0, 0)
        Derivatives, as in `sinusoid_force.force_of`. Their excess is taken off, unless it is empty.

    Returns
    -------
    x, y, good
        Force [mu m g]; whether that holds: not if another dip lies close by.
    """
    middle, b, done = branch_point(slip, start, CLOSE * 2 * pi / n)
    if not done or _square(middle - start) > (1.5 * 2 * pi / n) ** 2 or n * b > 2 * NEAR:
        return 0.0, 0.0, False
    turned = _turned(slip, middle)
    number = len(turned) - 1
    phase, m = complex(turned[number, 4], turned[number, 5]), number
    while m < n:  # exp(i n a)
        phase, m = phase * phase, 2 * m
    sloped = len(gradient) > 0
    if sloped:
        # Derivatives have a double pole at u = 0, of which steps to its sides miss pi^2 / STEP.
        x, y, fade = _complex_slip(turned, b, n)
        dx, dy = _complex_rate(turned, b)
        root, good = _inverse_root((x * dx + y * dy) * (-1 / b))
        share = 0.5 * (pi / STEP / b) ** 2 * _kernel(phase * fade) * root * root * root
        _add_slopes(share, x, y, b, turned)
    fx = fy = 0.0
    for u in range(len(COSH)):
        depth = b * COSH[u]
        if n * depth > FADED:
            break
        x, y, fade = _complex_slip(turned, depth, n)
        across = -1 / (b * SINH[u]) ** 2
        root, good = _inverse_root((x * x + y * y) * across)
        if not good:
            return 0.0, 0.0, False
        share = _kernel(phase * fade) * root
        fx += (share * x).real
        fy += (share * y).real
        if sloped:
            _add_slopes(share * root * root * across, x, y, depth, turned)
    if sloped:
        _take_off(turned, gradient)
    return WEIGHT * fx, WEIGHT * fy, True


@kernel(fastmath=True, error_model="numpy", inline="always")
def _turned(slip: np.ndarray, middle: complex) -> np.ndarray:
    """Return a slip about time a: rows 0..N of even x, y, odd x, y, cos j a, sin j a, and zeros
    for the slopes by even (3) and odd (3)."""
    number = len(slip) // 2
    turned = np.zeros((number + 1, 12))
    turned[0, 0], turned[0, 1], turned[0, 4] = slip[2 * number, 0], slip[2 * number, 1], 1.0
    wave = 1 + 0j
    for j in range(1, number + 1):
        wave *= middle
        c, s = wave.real, wave.imag
        for axis in range(2):
            turned[j, axis] = slip[j - 1, axis] * s + slip[number + j - 1, axis] * c
            turned[j, 2 + axis] = slip[j - 1, axis] * c - slip[number + j - 1, axis] * s
        turned[j, 4], turned[j, 5] = c, s
    return turned


@kernel(fastmath=True, error_model="numpy", inline="always")
def _complex_slip(turned: np.ndarray, depth: float, n: int) -> tuple[complex, complex, float]:
    """Return the slip at a + i depth, and exp(-n depth)."""
    step, power = exp(-depth), 1.0
    rx, ry, ix, iy = turned[0, 0], turned[0, 1], 0.0, 0.0
    for j in range(1, len(turned)):
        power *= step
        ch, sh = (1 / power + power) / 2, (1 / power - power) / 2
        rx += turned[j, 0] * ch
        ry += turned[j, 1] * ch
        ix += turned[j, 2] * sh
        iy += turned[j, 3] * sh
    m = len(turned) - 1
    while m < n:
        power *= power
        m *= 2
    return complex(rx, ix), complex(ry, iy), power


@kernel(fastmath=True, error_model="numpy")
def _complex_rate(turned: np.ndarray, depth: float) -> tuple[complex, complex]:
    """Return the derivative of the slip at a + i depth by depth."""
    dx = dy = 0j
    for j in range(1, len(turned)):
        ch, sh = j * cosh(j * depth), j * sinh(j * depth)
        dx += complex(turned[j, 0] * sh, turned[j, 2] * ch)
        dy += complex(turned[j, 1] * sh, turned[j, 3] * ch)
    return dx, dy


@kernel(fastmath=True, error_model="numpy", inline="always")
def _kernel(q: complex) -> complex:
    """Return -q / (1 + q), the sum of (-q)^m from m = 1: all aliases of n equal steps."""
    return (q + _square(q)) * (-1 / _square(1 + q))


@kernel(fastmath=True, error_model="numpy", inline="always")
def _inverse_root(value: complex) -> tuple[complex, bool]:
    """Return 1 / sqrt(value) with a positive real part; whether the value has one too."""
    size = sqrt(_square(value))
    real = sqrt((size + value.real) / 2)
    share = 1 / size
    return complex(real * share, -0.5 * value.imag / real * share), value.real > 0.0


@kernel(fastmath=True, error_model="numpy")
def _add_slopes(share: complex, x: complex, y: complex, depth: float, turned: np.ndarray) -> None:
    """Add share [y y, -x y, x x] times cosh (real part) and sinh (imaginary) to the slopes."""
    xx, xy, yy = share * y * y, -share * x * y, share * x * x
    for j in range(1, len(turned)):
        ch, sh = cosh(j * depth), sinh(j * depth)
        turned[j, 6] += xx.real * ch
        turned[j, 7] += xy.real * ch
        turned[j, 8] += yy.real * ch
        turned[j, 9] -= xx.imag * sh
        turned[j, 10] -= xy.imag * sh
        turned[j, 11] -= yy.imag * sh


@kernel(fastmath=True, error_model="numpy")
def _take_off(turned: np.ndarray, gradient: np.ndarray) -> None:
    """Take the slopes about time a off the gradient by sines and cosines."""
    number = len(turned) - 1
    for j in range(1, number + 1):
        c, s = WEIGHT * turned[j, 4], WEIGHT * turned[j, 5]
        for row in range(3):
            even, odd = turned[j, 6 + row], turned[j, 9 + row]
            gradient[row, j - 1] -= s * even + c * odd
            gradient[row, number + j - 1] -= c * even - s * odd
