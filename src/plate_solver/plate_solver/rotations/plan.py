"""From forces to rotations: which ones, and for how long.

Sums of forces do not depend on the order, real motions do: each change of twist takes time, the
plate must stay within its stroke, and parts move meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..library import CURL_LENGTH_M, Library, TimeFractions, least_time

SPEEDS = (1.0, 0.5)
"""Speeds at which the linear programme may run a rotation, in units of the usual one: friction
takes no notice of them, closure does."""

CLOSURE_PRICE = 1e4
"""Price of a gap between the start and the end: there is to be none."""

RETURN = 2.5
"""Speed of a return stroke over that of the stroke before it."""


@dataclass(frozen=True)
class RotationPlan:
    """Rotations in order, and what they do.

    Attributes
    ----------
    twist : (J, 3)
        In its sense, in units of the usual speed of the fastest corner.
    fraction : (J,)
        Of the cycle's time, together at most 1.
    priority : (J,)
        Of section 3.1.4: weight over distance to the nearest part [1/m].
    met : float
        Fraction of what is asked that fits into the cycle: 1, or less.
    times : TimeFractions
        The linear programme's solution; its cost is the time needed, in cycles.
    """

    twist: np.ndarray
    fraction: np.ndarray
    priority: np.ndarray
    met: float
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
    """Plan the sequence of least time that closes as a whole.

    Parameters
    ----------
    library : Library
    position, force : (M, 2)
        Parts [m] and forces wanted on them [mu m g].
    curl : (M,), optional
        Curls wanted [mu m g / m]; NaN where free.
    price : float
        Most time that a unit of force may cost [cycles / (mu m g)]; what costs more is given up.
    start : optional
        Basis of the last plan.
    cost : (K,), optional
        What a unit of time of each rotation of the library costs (1).
    """
    asked = np.zeros(len(position), bool) if curl is None else np.isfinite(curl)
    rows = np.vstack([library.forces(position), library.curls(position)[asked] * CURL_LENGTH_M])
    twist = np.vstack([speed * library.twist for speed in SPEEDS])
    matrix = np.vstack([np.tile(rows, len(SPEEDS)), twist.T])
    turn = np.zeros(0) if curl is None else curl[asked] * CURL_LENGTH_M
    wanted = np.concatenate([force.T.ravel(), turn, np.zeros(3)])
    dear = np.append(np.full(len(rows), price), np.full(3, CLOSURE_PRICE))
    cost = np.ones(len(library.twist)) if cost is None else cost
    times = least_time(matrix, wanted, np.tile(cost, len(SPEEDS)), dear, dear, start)
    used = np.flatnonzero(np.abs(times.weights) > 1e-9)
    if not len(used):  # nothing is asked: one rotation, for no time
        used = np.zeros(1, dtype=int)
    weight = times.weights[used]
    total = float(np.sum(np.abs(weight)))
    return RotationPlan(
        twist=twist[used] * np.where(weight < 0, -1.0, 1.0)[:, None],
        fraction=np.abs(weight) / max(total, 1.0),
        priority=np.abs(weight)
        / np.maximum(library.clearance(position)[used % len(library.twist)], 1e-9),
        met=1 / max(total, 1.0),
        times=times,
    )


def with_return_strokes(plan: RotationPlan) -> RotationPlan:
    """Return the plan with every rotation turned back at once, faster: each closes by itself.

    Out and back over the same angle take 1 + 1/r of the time of the way out, and leave 1 - 1/r of
    its force: (r + 1)/(r - 1) times the time in all, 2.3 times at r = 2.5.
    """
    longer = (RETURN + 1) / (RETURN - 1)
    fraction = plan.fraction * longer
    fits = 1 / max(float(np.sum(fraction)), 1.0)
    out = fraction * fits * RETURN / (RETURN + 1)
    return RotationPlan(
        twist=np.stack([plan.twist, -RETURN * plan.twist], axis=1).reshape(-1, 3) / RETURN,
        fraction=np.stack([out, out / RETURN], axis=1).ravel(),
        priority=np.repeat(plan.priority, 2),
        met=plan.met * fits,
        times=plan.times,
    )
