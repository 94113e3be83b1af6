"""The bounds of one part's speed, against motions along a line that are integrated here."""

from dataclasses import replace

import numpy as np
import pytest

from plate_bringup.bounds import rest_to_rest_s, speed_bounds
from plate_core import load_rig

RIG = load_rig()
A = RIG.friction.accel


def shaken(accel, stroke=1.0):
    return replace(RIG, limits=replace(RIG.limits, accel=accel, stroke_m=stroke, speed=100.0))


def steady_drift(u, period, cycles=400):
    """Mean velocity of a part on a plate whose velocity is u (n,), once it is the same each cycle;
    friction brings its velocity towards u by at most mu g dt."""
    dt, v = period / len(u), 0.0
    for _ in range(cycles):
        before, total = v, 0.0
        for each in u:
            v += np.clip(each - v, -A * dt, A * dt)
            total += v
        if abs(v - before) < 1e-9:
            break
    return total / len(u)


@pytest.mark.parametrize("ratio", [1.5, 3.0, 10.0, 40.0])
def test_a_motion_comes_near_the_bound_by_acceleration(ratio):
    """For half of the cycle the plate leads a little, and then it goes back as quickly as it can:
    to just where it was."""
    period, max_accel, n = 0.2, ratio * A, 4000
    bound = speed_bounds(shaken(max_accel), period).accel
    t = (np.arange(n // 2) + 0.5) / n * period
    forward = A * t
    down = period / 2 * (max_accel + A) / (2 * max_accel)  # the slip's slopes are A - a and A + a
    back = A * period / 2 - np.minimum(max_accel * t, 2 * max_accel * down - max_accel * t)
    u = np.concatenate([forward, back])
    u += 1e-4 * np.repeat([1, 0], n // 2)
    drift = steady_drift(u - np.mean(u), period)
    assert 0.97 * bound < drift < bound + 1e-4


@pytest.mark.parametrize("seed", range(6))
def test_no_motion_along_a_line_exceeds_the_bounds(seed):
    rng = np.random.default_rng(seed)
    period, n = 0.1, 400
    t = np.arange(n) / n * 2 * np.pi
    for _ in range(20):
        order = np.arange(1, 5)[:, None]
        amplitude, phase = rng.standard_normal((4, 1)), rng.uniform(0, 2 * np.pi, (4, 1))
        u = np.sum(amplitude * np.sin(order * t + phase), axis=0)
        accel = np.max(np.abs(np.diff(u, append=u[:1]))) * n / period
        u *= rng.uniform(1.2, 40) * A / accel
        accel = np.max(np.abs(np.diff(u, append=u[:1]))) * n / period
        x = np.cumsum(u) * period / n
        bounds = speed_bounds(shaken(accel, np.ptp(x) / 2 / np.sqrt(2)), period)
        drift = abs(steady_drift(u, period))
        assert drift <= bounds.accel + 1e-3
        assert drift <= bounds.stroke + 1e-3


def test_the_speed_bound_is_zero_if_no_part_slides():
    assert speed_bounds(shaken(0.9 * A), 0.1).minimum == 0


def test_motors_that_are_weak_bound_too():
    strong, weak = (
        speed_bounds(replace(RIG, limits=replace(RIG.limits, force=force)), 0.1)
        for force in (200.0, 10.0)
    )
    assert weak.accel < strong.accel / 5


def test_minimum_time_of_a_displacement():
    """Half of the way gaining speed at mu g, half losing it."""
    t = rest_to_rest_s(0.1, A)
    assert 2 * (A * (t / 2) ** 2 / 2) == pytest.approx(0.1)
