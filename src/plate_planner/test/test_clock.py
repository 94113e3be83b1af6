"""The period from stamps: lost images, gaps, stamps that go back."""

import pytest

from plate_planner.clock import CycleClock


def period_after(*stamps: float) -> float:
    clock = CycleClock.starting(0.1)
    for t in stamps:
        clock = clock.tick(t)
    return clock.period


def test_the_default_until_two_stamps_are_known():
    assert period_after() == 0.1
    assert period_after(5.0) == 0.1
    assert period_after(5.0, 5.05) == pytest.approx(0.05)


def test_one_lost_image_changes_nothing():
    assert period_after(0.0, 0.05, 0.10, 0.20, 0.25) == pytest.approx(0.05)


def test_a_new_period_is_followed_after_two_images():
    assert period_after(0.0, 0.05, 0.10, 0.15, 0.35, 0.55) == pytest.approx(0.2)


@pytest.mark.parametrize("gap", [60.0, -10.0, 0.0, 1e-4])
def test_gaps_and_steps_back_leave_the_last_plausible_period(gap):
    assert period_after(0.0, 0.05, 0.10, 0.10 + gap) == pytest.approx(0.05)
    assert period_after(0.0, 0.05, 0.10, 0.10 + gap, 0.15 + gap) == pytest.approx(0.05)


def test_going_back_is_noticed():
    clock = CycleClock.starting(0.1)
    assert not clock.went_back(3.0)
    clock = clock.tick(3.0)
    assert clock.went_back(2.9)
    assert not clock.went_back(3.0)
