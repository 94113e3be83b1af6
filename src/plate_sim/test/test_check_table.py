"""Motor tables that the device plays, and tables that it refuses."""

import numpy as np
import pytest
from shaking import bump

from plate_core import CycleError, PlateCycle, load_rig
from plate_sim.plate import check_table

RIG = load_rig()
REST = PlateCycle.rest(0.1)


def test_a_correct_table_is_accepted_and_its_peaks_are_measured():
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


HOME, STATE = np.zeros((3, 3)), np.array([[1e-3, 0, 0], [0.02, 0, 0], [0, 0, 0]])


def leaving(state, begin=HOME, stops_s=0.05):
    """Table of 50 ms from a state of the plate, rest if it is left out, to another one, and a tail
    that takes `stops_s`."""
    knots = np.stack([begin, state, state, HOME], axis=1)
    return PlateCycle.from_knots(np.array([0.0, 0.05, 0.05, 0.05 + stops_s]), *knots)


def test_a_table_in_motion_follows_the_state_in_which_it_begins():
    first, second = leaving(STATE), leaving(2 * STATE, STATE)
    assert check_table(RIG, second, first).stroke_m > 0
    for running in (REST, second, bump(1e-3)):
        with pytest.raises(CycleError, match="end state of the running table"):
            check_table(RIG, second, running)


def test_the_tail_keeps_the_limits_too():
    fast = np.array([[1e-3, 0, 0], [0.3, 0, 0], [0, 0, 0]])
    check_table(RIG, leaving(fast), REST)
    with pytest.raises(CycleError, match="m/s2, allowed: "):
        check_table(RIG, leaving(fast, stops_s=0.005), REST)


@pytest.mark.parametrize("tail_s", [2e-9, 1e6])
def test_a_tail_of_an_impossible_length_is_refused(tail_s):
    still, times = np.zeros((4, 3)), np.array([0.0, 0.1, 0.1, 0.1 + tail_s])
    with pytest.raises(CycleError, match=r"tail is .* allowed: 0\.01 to 10 s"):
        check_table(RIG, PlateCycle.from_knots(times, still, still, still), REST)
