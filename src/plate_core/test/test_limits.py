"""usage() against brute force over a dense grid of times and plate points."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.motion import corner_accel, usage

RIG = load_rig()
PERIOD = 0.1


def random_cycle(seed: int) -> PlateCycle:
    """Smooth random cycle of three harmonics, about as large as the rig allows."""
    rng = np.random.default_rng(seed)
    t = np.arange(48) * PERIOD / 48
    pose = np.zeros((48, 3))
    for h in (1, 2, 3):
        phase = rng.uniform(0, 2 * np.pi, 3)
        size = rng.uniform(0, 1, 3) * [3e-3, 3e-3, 1e-2] / h**2
        pose += size * np.sin(2 * np.pi * h * t[:, None] / PERIOD + phase)
    return PlateCycle.from_samples(PERIOD, pose)


def brute_force(cycle: PlateCycle) -> tuple[float, float, float]:
    """Peaks of travel, speed and acceleration from positions alone, by differences in time."""
    n, step = 4000, 2e-6
    t = step + np.arange(n) * (cycle.period - 2 * step) / (n - 1)

    def points(times, at):
        pose = cycle.pose(times)
        cos, sin = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
        x = pose[:, :1] + cos * at[:, 0] - sin * at[:, 1]
        y = pose[:, 1:2] + sin * at[:, 0] + cos * at[:, 1]
        return np.stack([x, y], axis=2)

    motors = np.array([m.point for m in RIG.motors])
    ways = np.array([m.direction for m in RIG.motors])
    before, now, after = (
        np.sum((points(t + d, motors) - motors) * ways, axis=2) for d in (-step, 0, step)
    )
    grid_x, grid_y = np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(-0.15, 0.15, 5))
    grid = np.column_stack([grid_x.ravel(), grid_y.ravel()])
    second = (points(t + step, grid) - 2 * points(t, grid) + points(t - step, grid)) / step**2
    return (
        float(np.max(np.abs(now))),
        float(np.max(np.abs(after - before)) / (2 * step)),
        float(np.max(np.linalg.norm(second, axis=2))),
    )


@pytest.mark.parametrize("seed", range(5))
def test_usage_is_the_peak(seed):
    cycle = random_cycle(seed)
    found = usage(RIG, cycle)
    peaks = brute_force(cycle)
    for ours, exact in zip((found.stroke_m, found.speed, found.accel), peaks, strict=True):
        assert 0.9999 * exact < ours < 1.002 * exact


def test_peak_between_knots_is_not_missed():
    # Two knots at home; all the motion is between them.
    twist = np.array([[0.5, 0, 0]] * 2)
    zero = np.zeros((2, 3))
    cycle = PlateCycle.from_knots([0, PERIOD], zero, twist, zero)
    peak = np.max(np.abs(cycle.pose(np.linspace(0, PERIOD, 10001))))
    assert peak <= usage(RIG, cycle).stroke_m < 1.1 * peak


@pytest.mark.parametrize("limit", ["stroke_m", "speed", "accel"])
def test_worst_is_the_greatest_share(limit):
    cycle = random_cycle(9)
    found = usage(RIG, cycle)
    tight = {"stroke_m": 1.0, "speed": 100.0, "accel": 1e4, limit: getattr(found, limit) / 3}
    rig = replace(RIG, limits=replace(RIG.limits, **tight))
    assert usage(rig, cycle).worst == pytest.approx(3)


def test_rest_uses_nothing():
    assert usage(RIG, PlateCycle.rest(PERIOD)).worst == 0


def test_corner_of_a_spinning_plate_is_pulled_inwards():
    zero = np.zeros((1, 3))
    accel = corner_accel(RIG, zero, np.array([[0, 0, 2.0]]), zero)
    np.testing.assert_allclose(accel, 4 * np.hypot(0.3, 0.15))
