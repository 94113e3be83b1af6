"""Parts that are dragged, in the closed loop without ROS; judged by their true places."""

from itertools import pairwise

import numpy as np
from short_task import FEW_STARTS

from plate_bringup.loop import Setup, run
from plate_core.tasks import PartTarget

LIMIT_S = 40.0


def dragged(target, seed):
    """The run of `play` in which black_1 has the target of a time [s]."""
    for moment in run(
        Setup("play", seed, effort=FEW_STARTS), drag=lambda t: [PartTarget("black_1", target(t))]
    ):
        assert moment.progress.phase == "running", moment.progress.text
        assert moment.world.dropped == 0
        yield moment
        if moment.time > LIMIT_S:
            return


def test_a_part_reaches_a_target_that_changes_during_the_motion():
    first, second = (0.15, 0.05), (-0.12, -0.05)
    for moment in dragged(lambda t: first if t < 2 else second, seed=21):
        if moment.time > 3 and np.max(moment.error_m, initial=1.0) < 2e-3:
            break
    assert np.max(moment.error_m) < 2e-3
    assert moment.progress.text.startswith("running: 1 of 1 at their targets")


def test_a_part_follows_a_target_that_is_dragged():
    """At 20 mm/s it lags by about half a second: 9 to 12 mm."""
    start, speed = 8.0, 0.02
    late = []

    def target(t):
        return (-0.1 + speed * max(t - start, 0.0), 0.0)

    for moment in dragged(target, seed=22):
        if moment.time > start + 7:
            break
        if moment.time > start + 2:
            late.append(float(np.max(moment.error_m)))
    assert np.median(late) < 0.02
    assert max(abs(b - a) for a, b in pairwise(late)) < 0.01  # it does not jump


def test_a_target_on_another_part_pushes_it_aside_and_reports_it():
    reported, where = set(), {"now": (0.0, 0.0)}
    for moment in dragged(lambda t: where["now"], seed=23):
        if moment.time < 1:
            where["now"] = tuple(moment.parts.position[moment.parts.ids.index("grey_2")].tolist())
        reported.add(moment.progress.text.partition("; ")[2])
        if moment.time > 3 and np.max(moment.error_m, initial=1.0) < 4e-3:
            break
    assert "grey_2 is on the target of black_1" in reported
    assert np.max(moment.error_m) < 4e-3
