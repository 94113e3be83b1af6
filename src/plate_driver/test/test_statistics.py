"""Counters of a guard, and when the plate counts as at rest."""

import pytest

from plate_core import PlateCycle, load_rig
from plate_driver.setpoints.guard import Guard, Statistics
from plate_driver.setpoints.limits import scale_to_limits

RIG = load_rig()


def wild(size: float) -> PlateCycle:
    pose = [[size * x, 0, 0] for x in (0, 1, 2, 3, 2, 1, 0, -1, -2, -1)]
    return PlateCycle.from_samples(0.1, pose)


def test_accepted_scaled_and_refused_cycles_are_counted():
    gentle, large, larger = (scale_to_limits(RIG, wild(size)) for size in (1e-5, 0.01, 0.1))
    statistics = Statistics()
    for found in (gentle, large, larger, large):
        statistics = statistics.accepted(found)
    assert (statistics.cycles, statistics.scaled) == (4, 3)
    assert statistics.worst == pytest.approx(larger.requested.overall)
    assert statistics.factor == pytest.approx(larger.factor)
    assert statistics.problems == ("a cycle was scaled down",)
    guard = Guard(RIG, statistics=statistics).refused().refused()
    guard, _ = guard.commanded(wild(1e-5), 0, 1.0)
    guard, rests = guard.at_time(1.0 + guard.lasts_s + 1e-9)
    assert rests
    assert (guard.statistics.refused, guard.statistics.rests) == (2, 1)
    assert guard.statistics.problems == (
        "a cycle was scaled down",
        "a cycle was refused",
        "no more cycles arrived",
    )


def test_a_plate_rests_just_after_what_was_sent_is_over():
    guard, _ = Guard(RIG).commanded(wild(1e-5), 0, 10.0)
    assert guard.lasts_s == pytest.approx(guard.plays * guard.table.cycle.period)
    assert not guard.over(10.0)
    assert not guard.over(10.0 + guard.lasts_s - 1e-9)
    assert guard.over(10.0 + guard.lasts_s + 1e-9)
    later, _ = guard.commanded(wild(1e-5), 1, 10.9)
    assert not later.over(10.1 + later.lasts_s)
    assert later.over(10.9 + later.lasts_s + 1e-9)


def test_a_plate_at_rest_has_no_end_of_motion():
    assert not Guard(RIG).over(1e9)
    guard, _ = Guard(RIG).commanded(wild(1e-5), 0, 10.0)
    assert not guard.resting(11.0).over(1e9)


def test_report_keeps_totals_and_forgets_peaks():
    statistics = Statistics().accepted(scale_to_limits(RIG, wild(0.1)), late=0.01)
    assert statistics.values(0.5)["rate_hz"] == "2.00"
    assert statistics.values(0.5)["late_ms"] == "10.0"
    statistics = statistics.reported()
    assert statistics.values(0.5) == {
        "rate_hz": "0.00",
        "late_ms": "0.0",
        "cycles": "1",
        "refused": "0",
        "scaled": "1",
        "rests": "0",
        "worst_limit_fraction": "0.0000",
        "factor": "1.0000",
    }
    assert statistics.problems == ()
