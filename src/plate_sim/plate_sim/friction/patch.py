"""The implicit Coulomb step of a rigid footprint: one small convex problem with three unknowns.

A part's slip d = (u, v, c) [m/s, m/s, rad/s] is the plate's twist at the part less the part's. With
no friction it would be `free` after a step; friction over the footprint makes it the least of

    1/2 |d - free|^2 + dv sum_i p_i |d_i|,    |d|^2 = u^2 + v^2 + gyration2 c^2,

d_i the slip at point i, p_i its share of the weight, dv = mu g dt the velocity step. (Its
optimality condition is the step: each point's force is mu p_i m g along the slip AFTER the step,
or, without slip, any up to that.) So a part slips, turns and sticks without overshooting, whatever
the step.

Solved with forces beside slips as unknowns (Andersen, Christiansen, Conn and Overton 2000), whose
Newton steps do not mind that norms have kinks. What the duality gap promises ends it.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plate_core.kernels import inner_kernel

SLACK = 1e-6
"""Error of the slip after a step, as a share of dv: as an error of mu of that share."""

ROUNDING = 1e-14
"""Share of the slip times dv that rounding leaves of the duality gap."""

SNAP = 1e-3
"""Slips below this share of dv are none: then the part sticks."""

ITERATIONS = 30
"""1 to 12 are needed; on feet, once in 5000 cases where a foot is a pivot, this many do not do."""

POINT = np.dtype([(name, np.float64) for name in ("x", "y", "weight", "blur", "fx", "fy", "fb")])
"""A point of a footprint: its place in the part's axes [m], its share of the weight, the size of
its cell (see `Footprint.blur`) [m], and the force on it and on its blur in the last step
[p_i mu m g], a first guess of the next."""

TINY = 1e-200
"""Added to a squared slip [m2/s2], so that none is divided by 0."""

ROUND = 1e-4
"""Share of dv below which a point's friction is rounded off, so that Newton's steps converge."""


@inner_kernel
def slip_after(fx, fy, fc, dv, gyration2, mesh, first, end):
    """Return the slip (u, v, c) after a step, in the part's axes; zeros if the part sticks.

    Parameters
    ----------
    fx, fy, fc : float
        Slip after the step if there were no friction.
    dv : float
        mu g dt [m/s], above 0.
    gyration2 : float
        [m2].
    mesh, first, end : (n,) of POINT, int, int
        The part's points are `first` to `end` - 1; their forces are changed.
    """
    far2 = 0.0
    spread = 0.0
    for i in range(first, end):
        r2 = mesh[i].x ** 2 + mesh[i].y ** 2
        far2 = max(far2, r2)
        spread += mesh[i].weight * r2
    # It sticks if a force that is linear over the footprint is enough: nearly always when it does.
    push = fc * gyration2 / spread
    if sqrt(fx * fx + fy * fy) + abs(push) * sqrt(far2) <= dv:
        return 0.0, 0.0, 0.0
    dx, dy, dc = fx, fy, fc
    size2 = fx * fx + fy * fy + gyration2 * fc * fc
    if size2 > 16 * dv * dv:
        # It slides on, so the forces point along the slip.
        share = 1 - dv / sqrt(size2)
        _directions(share * fx, share * fy, share * fc, dv, mesh, first, end)
        dx, dy, dc = share * fx, share * fy, share * fc
    round2 = (ROUND * dv) ** 2
    enough = 0.5 * (SLACK * dv) ** 2 + ROUNDING * dv * sqrt(size2)
    for _ in range(ITERATIONS):
        # Slips n at the points, their forces z; sums for the Newton step.
        gx = gy = gc = 0.0
        wx = wy = wc = 0.0
        gap = 0.0
        hxx = hyy = hxy = hxc = hyc = 0.0
        hcc = 0.0
        for i in range(first, end):
            x, y, b = mesh[i].x, mesh[i].y, mesh[i].blur
            u, v, w = dx - dc * y, dy + dc * x, dc * b
            norm = sqrt(u * u + v * v + w * w + round2)
            inverse = 1 / norm
            nx, ny, nb = u * inverse, v * inverse, w * inverse
            p = dv * mesh[i].weight
            zx, zy, zb = mesh[i].fx, mesh[i].fy, mesh[i].fb
            inner = sqrt(max(0.0, 1 - zx * zx - zy * zy - zb * zb))
            gap += p * (norm - zx * u - zy * v - zb * w - ROUND * dv * inner)
            wx += p * zx
            wy += p * zy
            wc += p * (x * zy - y * zx + b * zb)
            gx += p * nx
            gy += p * ny
            gc += p * (x * ny - y * nx + b * nb)
            # Symmetric part of (1 - z n^T)/norm, seen by (u, v, c)
            q = p * inverse
            axx, ayy, abb = q * (1 - zx * nx), q * (1 - zy * ny), q * (1 - zb * nb)
            axy = -0.5 * q * (zx * ny + zy * nx)
            axb = -0.5 * q * (zx * nb + zb * nx)
            ayb = -0.5 * q * (zy * nb + zb * ny)
            hxx += axx
            hyy += ayy
            hxy += axy
            hxc += -y * axx + x * axy + b * axb
            hyc += -y * axy + x * ayy + b * ayb
            hcc += y * y * axx + x * x * ayy + b * b * abb
            hcc += 2 * (b * x * ayb - b * y * axb - x * y * axy)
        ex, ey, ec = dx - fx + wx, dy - fy + wy, dc - fc + wc / gyration2
        gap += 0.5 * (ex * ex + ey * ey + gyration2 * ec * ec)
        if gap <= enough:
            break
        sx, sy, sc = _solve(
            1 + hxx, hxy, hxc, 1 + hyy, hyc, gyration2 + hcc,
            fx - dx - gx, fy - dy - gy, gyration2 * (fc - dc) - gc,
        )  # fmt: skip
        for i in range(first, end):
            x, y, b = mesh[i].x, mesh[i].y, mesh[i].blur
            u, v, w = dx - dc * y, dy + dc * x, dc * b
            inverse = 1 / sqrt(u * u + v * v + w * w + round2)
            nx, ny, nb = u * inverse, v * inverse, w * inverse
            tu, tv, tw = (sx - sc * y) * inverse, (sy + sc * x) * inverse, sc * b * inverse
            along = nx * tu + ny * tv + nb * tw
            zx = nx + tu - mesh[i].fx * along
            zy = ny + tv - mesh[i].fy * along
            zb = nb + tw - mesh[i].fb * along
            size = max(1.0, sqrt(zx * zx + zy * zy + zb * zb))
            mesh[i].fx, mesh[i].fy, mesh[i].fb = zx / size, zy / size, zb / size
        dx, dy, dc = dx + sx, dy + sy, dc + sc
    if dx * dx + dy * dy + gyration2 * dc * dc <= (SNAP * dv) ** 2:
        return 0.0, 0.0, 0.0
    return fx - wx, fy - wy, fc - wc / gyration2


@inner_kernel(fastmath={"nsz"})
def friction(dx, dy, dc, gyration2, mesh, first, end):
    """Friction that a slip (u, v, c) in the part's axes gives the points `first` to `end` - 1.

    Returns
    -------
    ax, ay, ac : float
        Force [mu m g], and torque by m gyration2 [mu g / m].
    stiff : float
        Bound of how it changes with the slip [mu g / (m/s)].
    """
    fx = fy = fc = stiff = 0.0
    for i in range(first, end):
        x, y, b = mesh[i].x, mesh[i].y, mesh[i].blur
        u, v, w = dx - dc * y, dy + dc * x, dc * b
        share = mesh[i].weight / np.sqrt(u * u + v * v + w * w + TINY)
        fx += share * u
        fy += share * v
        fc += share * (x * v - y * u + b * w)
        stiff += share * (gyration2 + x * x + y * y)
    return fx, fy, fc / gyration2, stiff / gyration2


@inner_kernel
def _directions(dx, dy, dc, dv, mesh, first, end):
    """Point the forces (n, 3) along the slips."""
    for i in range(first, end):
        u, v, w = dx - dc * mesh[i].y, dy + dc * mesh[i].x, dc * mesh[i].blur
        inverse = 1 / sqrt(u * u + v * v + w * w + (ROUND * dv) ** 2)
        mesh[i].fx, mesh[i].fy, mesh[i].fb = (
            u * inverse,
            v * inverse,
            w * inverse,
        )


@inner_kernel
def _solve(a, b, c, d, e, f, x, y, z):
    """Solve [[a, b, c], [b, d, e], [c, e, f]] s = (x, y, z), symmetric and positive."""
    l1, l2 = b / a, c / a
    d -= l1 * b
    e -= l1 * c
    f -= l2 * c
    y -= l1 * x
    z -= l2 * x
    l3 = e / d
    f -= l3 * e
    s3 = (z - l3 * y) / f
    s2 = y / d - l3 * s3
    return (x - b * s2 - c * s3) / a, s2, s3
