"""Steps of a sliding part: Runge-Kutta 5(4), the landing where the slip vanishes, the restart.

While a part slides, v' = mu g w/|w| with the slip w = v_s(p, t) - v: smooth, as long as w is not
zero. Every step returns how far it went, the part's new state, and the direction of friction at
its end.
"""

from __future__ import annotations

from math import log, sqrt
from typing import NamedTuple

from plate_core.kernels import inner_kernel

from ..plate.pieces import in_plate, riding, slip

# Dormand and Prince, A family of embedded Runge-Kutta formulae, J. Comp. Appl. Math. 6 (1980),
# table 2: order 5 with an error estimate of order 4; the last stage is the next step's first.
C2, C3, C4, C5 = 1 / 5, 3 / 10, 4 / 5, 8 / 9
A21 = 1 / 5
A31, A32 = 3 / 40, 9 / 40
A41, A42, A43 = 44 / 45, -56 / 15, 32 / 9
A51, A52, A53, A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
A61, A62, A63, A64, A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
B1, B3, B4, B5, B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
E1, E3, E4 = B1 - 5179 / 57600, B3 - 7571 / 16695, B4 - 393 / 640
E5, E6, E7 = B5 + 92097 / 339200, B6 - 187 / 2100, -1 / 40


class Point(NamedTuple):
    """State of a part: place [m] and velocity [m/s]."""

    x: float
    y: float
    vx: float
    vy: float


TRIES = 40
"""Shortened restarts before a part is held a moment longer: 0.3**40 of a step is rounding."""

ROOT = 1e-15
"""A root in time is found to this share of its bracket."""


@inner_kernel
def _stage(table, t, k, px, py, vx, vy, limit, nx, ny):
    """Friction [m/s2] of one stage, and whether the slip is still along the unit vector n."""
    k, wx, wy, r = slip(table, t, k, Point(px, py, vx, vy))
    share = limit / r if r > 0 else 0.0
    return k, share * wx, share * wy, wx * nx + wy * ny > 0


@inner_kernel
def runge_kutta(table, t, k, h, point, force, limit):
    """Try a step h [s] from friction f [m/s2].

    Returns
    -------
    turned : float
        Share of the step by which the slip has reversed; 0 if it has not, and then
    point, force : Point, (2,)
        State and friction at the end, and
    ep, ev : float
        Estimated errors of position [m] and velocity [m/s].
    """
    px, py, vx, vy = point
    fx, fy = force
    nx, ny = fx / limit, fy / limit
    none = (point, force, 0.0, 0.0)
    ux2, uy2 = vx + h * A21 * fx, vy + h * A21 * fy
    x = px + h * A21 * vx
    y = py + h * A21 * vy
    k, fx2, fy2, on = _stage(table, t + C2 * h, k, x, y, ux2, uy2, limit, nx, ny)
    if not on:
        return (C2, *none)
    ux3, uy3 = vx + h * (A31 * fx + A32 * fx2), vy + h * (A31 * fy + A32 * fy2)
    x = px + h * (A31 * vx + A32 * ux2)
    y = py + h * (A31 * vy + A32 * uy2)
    k, fx3, fy3, on = _stage(table, t + C3 * h, k, x, y, ux3, uy3, limit, nx, ny)
    if not on:
        return (C3, *none)
    ux4 = vx + h * (A41 * fx + A42 * fx2 + A43 * fx3)
    uy4 = vy + h * (A41 * fy + A42 * fy2 + A43 * fy3)
    x = px + h * (A41 * vx + A42 * ux2 + A43 * ux3)
    y = py + h * (A41 * vy + A42 * uy2 + A43 * uy3)
    k, fx4, fy4, on = _stage(table, t + C4 * h, k, x, y, ux4, uy4, limit, nx, ny)
    if not on:
        return (C4, *none)
    ux5 = vx + h * (A51 * fx + A52 * fx2 + A53 * fx3 + A54 * fx4)
    uy5 = vy + h * (A51 * fy + A52 * fy2 + A53 * fy3 + A54 * fy4)
    x = px + h * (A51 * vx + A52 * ux2 + A53 * ux3 + A54 * ux4)
    y = py + h * (A51 * vy + A52 * uy2 + A53 * uy3 + A54 * uy4)
    k, fx5, fy5, on = _stage(table, t + C5 * h, k, x, y, ux5, uy5, limit, nx, ny)
    if not on:
        return (C5, *none)
    ux6 = vx + h * (A61 * fx + A62 * fx2 + A63 * fx3 + A64 * fx4 + A65 * fx5)
    uy6 = vy + h * (A61 * fy + A62 * fy2 + A63 * fy3 + A64 * fy4 + A65 * fy5)
    x = px + h * (A61 * vx + A62 * ux2 + A63 * ux3 + A64 * ux4 + A65 * ux5)
    y = py + h * (A61 * vy + A62 * uy2 + A63 * uy3 + A64 * uy4 + A65 * uy5)
    k, fx6, fy6, on = _stage(table, t + h, k, x, y, ux6, uy6, limit, nx, ny)
    if not on:
        return (1.0, *none)
    ux7 = vx + h * (B1 * fx + B3 * fx3 + B4 * fx4 + B5 * fx5 + B6 * fx6)
    uy7 = vy + h * (B1 * fy + B3 * fy3 + B4 * fy4 + B5 * fy5 + B6 * fy6)
    x = px + h * (B1 * vx + B3 * ux3 + B4 * ux4 + B5 * ux5 + B6 * ux6)
    y = py + h * (B1 * vy + B3 * uy3 + B4 * uy4 + B5 * uy5 + B6 * uy6)
    k, fx7, fy7, on = _stage(table, t + h, k, x, y, ux7, uy7, limit, nx, ny)
    if not on:
        return (1.0, *none)
    epx = E1 * vx + E3 * ux3 + E4 * ux4 + E5 * ux5 + E6 * ux6 + E7 * ux7
    epy = E1 * vy + E3 * uy3 + E4 * uy4 + E5 * uy5 + E6 * uy6 + E7 * uy7
    evx = E1 * fx + E3 * fx3 + E4 * fx4 + E5 * fx5 + E6 * fx6 + E7 * fx7
    evy = E1 * fy + E3 * fy3 + E4 * fy4 + E5 * fy5 + E6 * fy6 + E7 * fy7
    ep, ev = h * (abs(epx) + abs(epy)), h * (abs(evx) + abs(evy))
    return 0.0, Point(x, y, ux7, uy7), (fx7, fy7), ep, ev


@inner_kernel
def even(point, force, tau):
    """State after tau [s] of constant friction [m/s2]."""
    return Point(
        point.x + tau * (point.vx + 0.5 * tau * force[0]),
        point.y + tau * (point.vy + 0.5 * tau * force[1]),
        point.vx + tau * force[0],
        point.vy + tau * force[1],
    )


@inner_kernel
def straight(table, t, k, tau, point, force, nx, ny):
    """Slip along and across n [m/s] after tau [s] of constant friction f."""
    k, wx, wy, _ = slip(table, t + tau, k, even(point, force, tau))
    return wx * nx + wy * ny, wy * nx - wx * ny


@inner_kernel
def line_step(table, t, k, h, point, force):
    """As `runge_kutta`, for a slip that keeps to a line: friction is constant, the step exact."""
    along, _ = straight(table, t, k, h, point, force, force[0], force[1])
    return 0.0 if along > 0 else 1.0, even(point, force, h), force, 0.0, 0.0


@inner_kernel
def landing(table, t, k, h, point, force, r, limit, none):
    """Find when the slip, r [m/s] now, vanishes within h [s] if friction keeps its direction.

    A slip along of `none` [m/s] is as good as none.

    Returns
    -------
    tau : float
        That time [s], or 0 if there is none.
    rest : float
        The slip [m/s] that then remains across: 0 on a line.
    error : float
        Bound of the velocity's error [m/s] from the direction's change on the way.
    """
    nx, ny = force[0] / limit, force[1] / limit
    low, high = 0.0, h
    s_low = r
    s_high, rest = straight(table, t, k, h, point, force, nx, ny)
    if s_high > 0:
        return 0.0, 0.0, 0.0
    side = 0
    tau = h
    for _ in range(60):  # Illinois: regula falsi that halves the value at an end that stays
        if high - low <= ROOT * h or s_high == 0:
            break
        tau = (low * s_high - high * s_low) / (s_high - s_low)
        if not low < tau < high:
            tau = 0.5 * (low + high)
            if not low < tau < high:
                break
        s, rest = straight(table, t, k, tau, point, force, nx, ny)
        if s > 0:
            low, s_low = tau, s
            if side == 1:
                s_high *= 0.5
            side = 1
        else:
            high, s_high = tau, s
            if side == -1:
                s_low *= 0.5
            side = -1
        if abs(s) <= none:
            break
    along, across = straight(table, t, k, 0.5 * tau, point, force, nx, ny)
    rest = abs(rest)
    # Across a slip that shrinks evenly the angle grows as rest tau/(tau - t): a logarithm.
    share = rest / r * (1 + log(max(1.0, r / rest))) if rest > 0 else 0.0
    share += abs(across) / along if along > 0 else 1.0
    return tau, rest, limit * tau * share


@inner_kernel
def restart(table, t, k, h, point, limit, allowed):
    """Slide off from a slip of nearly 0, at most h [s] far, where the surface accelerates too much.

    The slip turns at once along the surface's acceleration a, and then follows it: friction is
    mu g a/|a|. Velocity may err by `allowed` [m/s].

    Returns
    -------
    tau : float
        Length of the step [s], 0 if the part slid nowhere.
    point, before, after : Point, (2,), (2,)
        State at its end; friction [m/s2] at its start and end.
    """
    px, py, vx, vy = point
    qx, qy = in_plate(table, t, k, px, py)
    nx0, ny0 = _heading(table, t, k, qx, qy)
    for _ in range(TRIES):
        nx1, ny1 = _heading(table, t + 0.5 * h, k, qx, qy)
        nx2, ny2 = _heading(table, t + h, k, qx, qy)
        # Simpson's rule for v, its integral for p
        ux = vx + limit * h / 6 * (nx0 + 4 * nx1 + nx2)
        uy = vy + limit * h / 6 * (ny0 + 4 * ny1 + ny2)
        x = px + h * (vx + limit * h / 6 * (nx0 + 2 * nx1))
        y = py + h * (vy + limit * h / 6 * (ny0 + 2 * ny1))
        _, wx, wy, r = slip(table, t + h, k, Point(x, y, ux, uy))
        # The slip r lags behind a that turns at a rate w by the angle r w/|a|.
        error = r * (abs(nx2 - nx0) + abs(ny2 - ny0))
        if error > allowed:
            h *= max(0.1, min(0.7, 0.9 * (allowed / error) ** (1 / 3)))
            continue
        if wx * nx2 + wy * ny2 > 0:
            before, after = (limit * nx0, limit * ny0), (limit * nx2, limit * ny2)
            return h, Point(x, y, ux, uy), before, after
        h *= 0.3
    return 0.0, point, (0.0, 0.0), (0.0, 0.0)


@inner_kernel
def _heading(table, t, k, qx, qy):
    """Direction of the acceleration of a place in the plate."""
    _, _, _, _, _, ax, ay = riding(table, t, k, qx, qy)
    a = sqrt(ax * ax + ay * ay)
    return (ax / a, ay / a) if a > 0 else (0.0, 0.0)
