"""The device's choice of tables."""

import numpy as np
import pytest

from plate_core import CycleError, PlateCycle, load_rig
from plate_sim.plate import Playback, check_table, next_playback

RIG = load_rig()
REST = PlateCycle.rest(0.1)


def bump(height, period=0.1):
    """Table that leaves home along x and comes back: `height` [m] half-way, at rest at the ends."""
    t = np.arange(33) / 32
    u = t * (1 - t)
    pose, twist, accel = np.zeros((3, 33, 3))
    scale = height * 4**3  # the bump is 64 u^3
    pose[:, 0] = scale * u**3
    twist[:, 0] = scale * 3 * u**2 * (1 - 2 * t) / period
    accel[:, 0] = scale * (6 * u * (1 - 2 * t) ** 2 - 6 * u**2) / period**2
    return PlateCycle.from_knots(period * t, pose, twist, accel)


def test_the_newest_table_is_played_next():
    a, b = bump(1e-3), bump(2e-3)
    assert next_playback(Playback(a, repeats=3), b, 5, 0.1) == Playback(b)


@pytest.mark.parametrize("hold", [0, 1, 5])
def test_a_table_is_repeated_then_the_plate_rests(hold):
    a, played = bump(1e-3), []
    state = Playback(a)
    for _ in range(hold + 2):
        state = next_playback(state, None, hold, 0.07)
        played.append(state)
    assert [p.cycle is a for p in played] == [True] * hold + [False] * 2
    assert all(p.resting and p.cycle.period == 0.07 for p in played[hold:])
    assert next_playback(state, a, hold, 0.07) == Playback(a)


def test_a_good_table_is_taken_and_measured():
    peaks = check_table(RIG, bump(1e-3), REST)
    assert peaks.stroke_m == pytest.approx(1e-3, rel=0.02)
    check_table(RIG, PlateCycle.rest(0.1), REST)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (bump(0.0103, 0.2), "10.3 mm"),
        (bump(2e-3, 0.02), "m/s2, allowed: 10 mm, 1 m/s and 100 m/s2"),
        (bump(1e-5, 0.009), "period is 0.009 s"),
        (
            PlateCycle.from_samples(0.1, np.full((1, 3), 1e-4), np.zeros((1, 3)), np.zeros((1, 3))),
            "at rest at home",
        ),
    ],
)
def test_bad_tables_are_refused(table, message):
    with pytest.raises(CycleError, match=message):
        check_table(RIG, table, REST)
