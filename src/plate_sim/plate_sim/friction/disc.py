"""Friction of a disc that presses evenly on the plate, without quadrature.

Its centre slips at s, its rim, by the spin, at w = R |c|. The mean slip over the disc is the mean
distance from a point at s/w radii to the points of a disc, which complete elliptic integrals give;
force and torque are its derivatives by s and w (Farkas, Bartels, Unger and Wolf, PRL 90, 248302,
2003). Where the rim slips less than half as fast as the centre their power series is short; else
the integrals come from arithmetic and geometric means (Abramowitz and Stegun 1964, 17.6), arranged
so that no digits cancel.

With k = w/s the mean distance is s sum_n b_n k^2n, b_n = binomial(1/2, n)^2/(n + 1).
"""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt

from plate_core.kernels import inner_kernel

SNAP = 1e-3
"""Slips below this share of the velocity step are none: then the part sticks."""

CLOSE = 1e-9
"""Error of the direction times the slip after a step, as a share of the velocity step."""

MEANS = 2e-8
"""Means of numbers that differ by this share are equal to rounding."""

SERIES = 0.25
"""Greatest k^2 at which the series is summed: what is left out is below 2e-10 mu m g there."""


@inner_kernel(inline="always")
def series(k2):
    """Force [mu m g], and torque [mu m g R] over k, for k^2 up to `SERIES`."""
    force, torque = -0.00020234903786331415, 0.0001563606201671064
    force, torque = -0.0002856692299246788 + k2 * force, 0.0002142519224435091 + k2 * torque
    force, torque = -0.00042191147804260254 + k2 * force, 0.0003047138452529907 + k2 * torque
    force, torque = -0.0006608963012695312 + k2 * force, 0.00045436620712280273 + k2 * torque
    force, torque = -0.00112152099609375 + k2 * force, 0.000720977783203125 + k2 * torque
    force, torque = -0.00213623046875 + k2 * force, 0.0012461344401041667 + k2 * torque
    force, torque = -0.0048828125 + k2 * force, 0.00244140625 + k2 * torque
    force, torque = -0.015625 + k2 * force, 0.005859375 + k2 * torque
    force, torque = -0.125 + k2 * force, 0.020833333333333332 + k2 * torque
    return 1.0 + k2 * force, 0.25 + k2 * torque


@inner_kernel
def disc_force(s, w):
    """Force [mu m g] and torque [mu m g R] on a disc whose centre slips at s and rim at w [m/s].

    Both at least 0, and not both 0.
    """
    if w * w <= SERIES * s * s:
        force, torque = series((w / s) ** 2)
        return force, torque * w / s
    k = s / w if s <= w else w / s
    k2 = min(k * k, 1 - 1e-15)
    a, b = 1.0, sqrt(1 - k2)
    c = 0.5 * k2 / (1 + b)
    total, weight = 0.0, 1.0
    while True:
        total += weight * c * c
        weight *= 2
        a, b = 0.5 * (a + b), sqrt(a * b)
        if not c > MEANS * a:  # a NaN ends it too
            break
        c = 0.5 * (a - b)
    # K = pi/(2 a), and E = K (1 - k2/2 - total)
    rest = total / k2 if k2 > 0 else 0.0
    force = 2 / (3 * a) * (1.5 - 0.5 * k2 - (1 + k2) * rest)
    if s <= w:
        return k * force, 2 / (9 * a) * (3 - 3 * k2 + k2 * k2 - (4 - 2 * k2) * total)
    return force, 2 / (9 * a) * k * (1 + (2 - 4 * k2) * (rest / k2 if k2 > 0 else 0.0625))


@inner_kernel
def disc_slip_after(fx, fy, fc, dv, gyration2, radius):
    """As `patch.slip_after`, for a disc.

    By symmetry two unknowns are left, the slip s of the centre and g |c|, g the radius of
    gyration: the slip after the step is the free one, less dv times the nearest point of the set
    of forces that friction can give. That point is sought by its normal's direction.
    """
    arm = sqrt(gyration2)
    rim = radius / arm
    f = sqrt(fx * fx + fy * fy)
    zx, zy = f / dv, arm * abs(fc) / dv
    if zx + 1.5 * zy / rim <= 1:
        return 0.0, 0.0, 0.0
    if fc == 0:
        share = 1 - 1 / zx if zx - 1 > SNAP else 0.0
        return share * fx, share * fy, 0.0
    low, high = 0.0, 0.5 * pi
    s_low, s_high = -zy, zx
    side, p = 0, atan2(zy, zx)
    nx, ny, yx, yy = 1.0, 0.0, 0.0, 0.0
    for _ in range(60):  # Illinois: regula falsi that halves the value at an end that stays
        nx, ny = cos(p), sin(p)
        yx, yy = disc_force(nx, rim * ny)
        yy *= rim
        across = (zx - yx) * ny - (zy - yy) * nx
        if abs(across) <= CLOSE or high - low < 1e-15:
            break
        if across < 0:
            low, s_low = p, across
            if side == 1:
                s_high *= 0.5
            side = 1
        else:
            high, s_high = p, across
            if side == -1:
                s_low *= 0.5
            side = -1
        p = (low * s_high - high * s_low) / (s_high - s_low)
        if not low < p < high:
            p = 0.5 * (low + high)
    size = (zx - yx) * nx + (zy - yy) * ny
    if size <= SNAP:
        return 0.0, 0.0, 0.0
    share = 1 - yx / zx if zx > 0 else 0.0
    turn = fc - (dv * yy / arm if fc > 0 else -dv * yy / arm)
    return share * fx, share * fy, turn
