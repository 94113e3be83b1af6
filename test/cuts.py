"""Parts of cycles, with tails."""

import numpy as np

from plate_core import PlateCycle


def cut(cycle: PlateCycle, begin: int, end: int, tail_s: float = 0.05) -> PlateCycle:
    """Return the motion between two knots of a cycle, with a tail of `tail_s` [s] to rest."""
    tail = PlateCycle.stopping(cycle.state(end), tail_s)
    times = cycle.times[begin : end + 1] - cycle.times[begin]
    states = [
        np.concatenate([state[begin : end + 1], last])
        for state, last in zip(cycle.knots[1:], tail.knots[1:], strict=True)
    ]
    return PlateCycle.from_knots(np.append(times, times[-1] + tail.times), *states)
