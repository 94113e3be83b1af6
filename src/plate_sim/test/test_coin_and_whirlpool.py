"""The paper's coin (section 5) and whirlpool (3.1.3) against scipy, with its own quadrature."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plate_core import PlateCycle
from plate_sim import simulate, simulate_bodies
from plate_sim.friction import bar, disc

MU, G = 0.25, 9.81
CORNERS = 0.3 * np.array([[-1, -0.5], [1, -0.5], [1, 0.5]])
"""Of our plate, 0.3 times the paper's; its part is at (0.5, 0), ours at 0.3 times that."""

WEIGHTS, PLACE = [-0.59, -0.27, -0.53], np.array([0.15, 0])


def cells(radius, rings, sectors):
    """Midpoints of cells of equal area in a disc."""
    r = radius * np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2 * np.pi * (np.arange(sectors) + 0.5) / sectors
    return np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()


def friction(u, v, spin, x, y):
    """Mean of the direction of slip over cells (x, y), and of its moment."""
    a, b = u - spin * y, v + spin * x
    size = np.hypot(a, b) + 1e-15
    return (a / size).mean(-1), (b / size).mean(-1), ((x * b - y * a) / size).mean(-1)


def turning(frequency, spin, count=256):
    """Plate that turns at spin (sin wt + cos(2 wt) / 2), whose median is spin / 2."""
    t, w = np.arange(count) / (count * frequency), 2 * np.pi * frequency
    pose, twist, accel = np.zeros((3, count, 3))
    pose[:, 2] = spin / w * (-np.cos(w * t) + 0.25 * np.sin(2 * w * t))
    twist[:, 2] = spin * (np.sin(w * t) + 0.5 * np.cos(2 * w * t))
    accel[:, 2] = spin * w * (np.cos(w * t) - np.sin(2 * w * t))
    return PlateCycle.from_samples(1 / frequency, pose, twist, accel)


def polar(run, samples):
    """Angle [rad] and radius [m] of the first part after every given number of samples."""
    x, y = run.position[::samples, 0].T
    return np.unwrap(np.arctan2(y, x)), np.hypot(x, y)


def strokes(period, back=0.1, ramp=0.05, speed=1.0):
    """Turn about each corner clockwise, slowly, for its share of time, and quickly back."""
    t, rows = 0.0, [(0.0, *np.zeros(9))]
    for c, k in zip(CORNERS, np.abs(WEIGHTS) / np.abs(WEIGHTS).sum(), strict=True):
        r = ramp * k * period
        slow, fast = (1 - back) * k * period - 1.5 * r, back * k * period - 1.5 * r
        home = speed * (r + slow) / (r + fast)
        phi = w = 0.0
        for h, v in [(r, -speed), (slow, -speed), (r, home), (fast, home), (r, 0.0)]:
            phi, t, w = phi + 0.5 * h * (w + v), t + h, v
            x, y = -np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]]) @ c
            rows.append((t, c[0] + x, c[1] + y, phi, -w * y, w * x, w, -w * w * x, -w * w * y, 0))
    rows = np.array(rows)
    return PlateCycle.from_knots(rows[:, 0], rows[:, 1:4], rows[:, 4:7], rows[:, 7:])


def test_coin_moves_as_in_scipy():
    # In axes along and across the line from the plate's centre to the coin
    frequency = 25
    spin = 1.1
    radius = 0.0095
    start = 0.1
    seconds = 2
    x, y = cells(radius, 12, 36)
    w = 2 * np.pi * frequency

    def slope(t, state):
        r, out, _, rate, own = state
        plate = spin * (np.sin(w * t) + 0.5 * np.cos(2 * w * t))
        a, b, turn = friction(-out, r * (plate - rate), plate - own, x, y)
        return [
            out, r * rate**2 + MU * G * a, rate, (MU * G * b - 2 * out * rate) / r,
            MU * G * turn / (radius**2 / 2),
        ]  # fmt: skip

    ends = np.arange(seconds + 1)
    truth = solve_ivp(slope, (0, seconds), [start, 0, 0, 0, 0], "LSODA", ends, rtol=1e-6, atol=1e-8)
    run = simulate_bodies(
        turning(frequency, spin), disc(radius), [[start, 0]], 0, [[0, 0]], 0, MU,
        cycles=seconds * frequency, samples=4,
    )  # fmt: skip
    angle, out = polar(run, 4 * frequency)
    assert np.diff(angle) == pytest.approx(np.diff(truth.y[2]), rel=2e-4)
    assert np.diff(out) == pytest.approx(np.diff(truth.y[0]), rel=0.01)
    assert np.all(np.diff(out) > 2e-4)
    assert run.spin[:: 4 * frequency, 0] == pytest.approx(truth.y[4], abs=3e-3)


@pytest.mark.parametrize(("frequency", "min_ratio"), [(25, 0.44), (400, 0.49)])
def test_coin_circles_at_constant_speed_and_moves_out(frequency, min_ratio):
    # At half the plate's spin, its median, if the plate is much quicker than mu g T; else slower.
    spin = 1.1
    start = [[0.1, 0]]
    count = 4 * frequency
    samples = 16
    cycle = turning(frequency, spin)
    coin = simulate_bodies(
        cycle, disc(0.0095), start, 0, [[0, 0]], 0, MU, cycles=count, samples=samples
    )
    point = simulate(cycle, start, [[0, 0]], MU, G, count, samples, tolerance=1e-8)
    (angle, out), (point_angle, point_out) = (
        polar(run, samples * frequency) for run in (coin, point)
    )
    rates, drifts = np.diff(angle)[1:], np.diff(out)[1:]
    assert np.all((rates > min_ratio * spin) & (rates < 0.5 * spin))
    assert np.ptp(rates) < 0.003 * rates.mean()
    assert rates == pytest.approx(np.diff(point_angle)[1:], rel=2e-3)
    assert np.all(drifts > 5e-5)
    assert drifts == pytest.approx(np.diff(point_out)[1:], rel=0.25)


def test_whirlpool_moves_a_disc_as_in_scipy():
    radius, period, cycles = 0.02, 0.02, 12
    cycle = strokes(period)
    x, y = cells(radius, 12, 36)
    inner = [end for end in cycle.times if 0 < end < period]
    edges = [0.0, *inner, period]

    def slope(t, state):
        (px, py, _), (u, v, w) = cycle.pose(t)[0], cycle.twist(t)[0]
        dx, dy = state[0] - px, state[1] - py
        a, b, turn = friction(u - w * dy - state[3], v + w * dx - state[4], w - state[5], x, y)
        return [*state[3:], MU * G * a, MU * G * b, MU * G * turn / (radius**2 / 2)]

    state = np.array([*PLACE, 0, 0, 0, 0])
    for _ in range(cycles):
        for a, b in pairwise(edges):
            state = solve_ivp(slope, (a, b), state, rtol=1e-7, atol=1e-9).y[:, -1]
    run = simulate_bodies(
        cycle,
        disc(radius),
        [PLACE],
        0,
        [[0, 0]],
        0,
        MU,
        cycles=cycles,
        samples=8,
        step=2e-5,
    )
    assert run.angle[-1, 0] < -0.04
    assert run.angle[-1, 0] == pytest.approx(state[2], rel=1e-3)
    assert run.position[-1, 0] == pytest.approx(state[:2], abs=2e-5)
    assert run.spin[-1, 0] == pytest.approx(state[5], rel=3e-3)


def test_whirlpool_rotates_a_disc_clockwise_in_place_as_averages_predict():
    # Quick strokes: friction averaged over a cycle for a part that moves steadily, (3) to (5)
    radius, period, seconds = 0.02, 0.002, 4
    cycle = strokes(period)
    x, y = cells(radius, 8, 24)
    u, v, w = cycle.twist((np.arange(400) + 0.5) / 400 * period).T[:, :, None]

    def slope(_, state):
        px, py = state[:2]
        a, b, turn = friction(u - w * py - state[3], v + w * px - state[4], w - state[5], x, y)
        return [
            *state[3:], MU * G * a.mean(), MU * G * b.mean(),
            MU * G * turn.mean() / (radius**2 / 2),
        ]  # fmt: skip

    truth = solve_ivp(
        slope, (0, seconds), [*PLACE, 0, 0, 0, 0], t_eval=np.arange(seconds + 1), rtol=1e-4,
        atol=1e-6,
    ).y  # fmt: skip
    second = round(1 / period)
    run = simulate_bodies(
        cycle,
        disc(radius),
        [PLACE],
        0,
        [[0, 0]],
        0,
        MU,
        cycles=seconds * second,
        samples=1,
        step=2e-5,
    )
    rate = np.diff(run.angle[::second, 0])[1:]
    drift = np.diff(run.position[::second, 0], axis=0)
    assert np.all(rate < -0.45)
    assert rate == pytest.approx(np.diff(truth[2])[1:], rel=0.03)
    assert np.hypot(*drift.T).max() < 2.5e-3
    assert drift == pytest.approx(np.diff(truth[:2].T, axis=0), abs=1.5e-3)


def test_a_whirlpool_also_rotates_a_bar():
    run = simulate_bodies(
        strokes(0.02), bar(0.08, 0.01), [PLACE], 0, [[0, 0]], 0, MU, cycles=100, samples=8
    )
    half = len(run.time) // 2
    rate = (run.angle[-1, 0] - run.angle[half, 0]) / (run.time[-1] - run.time[half])
    assert -0.8 < rate < -0.3
    assert np.linalg.norm(run.position[-1, 0] - PLACE) < 3e-3 * run.time[-1]
