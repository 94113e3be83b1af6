"""Linear programme that selects the rotations for requested forces, and their durations.

The inputs are a library of rotations, the positions of the parts and the requested forces. The
output is a `RotationPlan`. The plan uses averaged forces, which do not depend on the order of the
rotations. The real motion depends on the order, because each change of twist takes time, the stroke
is limited, and parts move during the cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..library import CURL_LENGTH_M, Library, TimeFractions, min_time

SPEEDS = (1.0, 0.5)
"""Speeds of a rotation in the linear programme, in units of the usual speed. The averaged friction
does not depend on the speed. The displacement of the plate depends on the speed, and its sum over
the sequence must be 0."""

CLOSURE_PRICE = 1e4
"""Price per unit of the gap between the plate's poses at the start and at the end of the sequence.
The price is so high that the solution has no gap."""


@dataclass(frozen=True)
class RotationPlan:
    """Sequence of rotations, and their durations.

    Attributes
    ----------
    twist : (J, 3)
        Signed twist of each rotation, in units of the usual speed of the fastest corner (see
        `SPEEDS`).
    fraction : (J,)
        Duration of each rotation as a fraction of the cycle. The sum is at most 1.
    priority : (J,)
        Priority as in section 3.1.4 of the paper: weight divided by the distance between the centre
        of rotation and the nearest part [1/m].
    times : TimeFractions
        Solution of the linear programme. The cost of this solution is the time that the plan needs
        [cycles].
    """

    twist: np.ndarray
    fraction: np.ndarray
    priority: np.ndarray
    times: TimeFractions

    def in_order(self, order: np.ndarray) -> RotationPlan:
        """Return the plan with its rotations in another order (J,)."""
        return replace(
            self,
            twist=self.twist[order],
            fraction=self.fraction[order],
            priority=self.priority[order],
        )


def plan_rotations(
    library: Library,
    position: np.ndarray,
    force: np.ndarray,
    curl: np.ndarray | None = None,
    price: float = 1e3,
    start: np.ndarray | None = None,
    cost: np.ndarray | None = None,
) -> RotationPlan:
    """Plan the closed sequence of rotations with the minimum total time.

    Let w_j be the weights of the rotations, A the matrix of their mean forces and curls (in
    columns), and f the request. The linear programme minimises the time plus the price of unmet
    requests. The sequence is closed: the sum of all w_j twist_j is 0.

        minimise  sum_j cost_j abs(w_j) + sum_i price_i abs(A w - f)_i

    Parameters
    ----------
    library : Library
    position, force : (M, 2)
        Positions of the parts [m] and requested forces on them [mu m g].
    curl : (M,), optional
        Requested curls [mu m g / m]. If an entry is NaN, any curl of this part is accepted.
    price : float
        Maximum time per unit of force [cycles / (mu m g)]. Forces that cost more are not met.
    start : optional
        Basis of the last plan. This basis is the initial basis of the simplex method.
    cost : (K,), optional
        Cost of each rotation of the library per unit of time. Default: 1.
    """
    with_curl = np.zeros(len(position), bool) if curl is None else np.isfinite(curl)
    rows = np.vstack([library.forces(position), library.curls(position)[with_curl] * CURL_LENGTH_M])
    twist = np.vstack([speed * library.twist for speed in SPEEDS])
    matrix = np.vstack([np.tile(rows, len(SPEEDS)), twist.T])
    curl_m = np.zeros(0) if curl is None else curl[with_curl] * CURL_LENGTH_M
    right_side = np.concatenate([force.T.ravel(), curl_m, np.zeros(3)])
    prices = np.append(np.full(len(rows), price), np.full(3, CLOSURE_PRICE))
    cost = np.ones(len(library.twist)) if cost is None else cost
    times = min_time(matrix, right_side, np.tile(cost, len(SPEEDS)), prices, start)
    used = np.flatnonzero(np.abs(times.weights) > 1e-9)
    if not len(used):  # the request is zero: use one rotation of duration 0
        used = np.zeros(1, dtype=int)
    weight = times.weights[used]
    total = float(np.sum(np.abs(weight)))
    return RotationPlan(
        twist=twist[used] * np.where(weight < 0, -1.0, 1.0)[:, None],
        fraction=np.abs(weight) / max(total, 1.0),
        priority=np.abs(weight)
        / np.maximum(library.clearance(position)[used % len(library.twist)], 1e-9),
        times=times,
    )
