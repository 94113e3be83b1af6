"""Tilt, static friction and motions that do not close, in both integrators of point parts."""

import numpy as np
import pytest
from harmonic import MU, TIGHT, G, TwoHarmonics, waves
from scipy.integrate import solve_ivp

from plate_core import PlateCycle, PlateError
from plate_core.rig import surface_velocity, to_plate
from plate_sim import Ground, PlateMotion, simulate

LIMIT = MU * G
STILL = np.zeros((1, 2))
BOTH = pytest.mark.parametrize(
    ("how", "error"), [({"tolerance": 1e-11}, 1e-10), ({"samples": 8000}, 2e-6)]
)


def steep(fraction, heading=0.0):
    """Tilt whose pull is `share` of mu g, towards `heading` [rad]."""
    return tuple(np.arcsin(fraction * MU * np.array([np.cos(heading), np.sin(heading)])))


@BOTH
@pytest.mark.parametrize("static", [1.0, 1.4])
def test_a_part_slides_down_a_still_plate_only_if_static_friction_cannot_hold_it(
    how, error, static
):
    for heading in (0.0, 2.0):
        way = np.array([np.cos(heading), np.sin(heading)])
        for fraction in (0.5, 0.999 * static, 1.001 * static, 1.8):
            ground = Ground(static, steep(fraction, heading))
            run = simulate(PlateCycle.rest(0.3), STILL, STILL, MU, G, 2, ground=ground, **how)
            slid = 0.5 * (fraction - 1) * LIMIT * 0.6**2 if fraction > static else 0.0
            assert run.position[-1, 0] == pytest.approx(slid * way, abs=max(error, 2e-3 * slid))
            if slid == 0:
                assert np.abs(run.position).max() < 1e-15


@BOTH
def test_a_part_pushed_up_the_tilt_stops_and_comes_back_if_it_is_steep(how, error):
    for static, fraction, back in ((1.0, 0.6, False), (1.5, 1.3, False), (1.2, 1.3, True)):
        ground = Ground(static, steep(fraction))
        run = simulate(PlateCycle.rest(0.3), STILL, [[-0.5, 0]], MU, G, ground=ground, **how)
        stop = 0.5 / ((1 + fraction) * LIMIT)
        down = 0.5 * (fraction - 1) * LIMIT * (0.3 - stop) ** 2 if back else 0.0
        assert stop < 0.3
        assert run.position[-1, 0, 0] == pytest.approx(-0.25 * stop + down, abs=10 * error)
        assert run.position[-1, 0, 1] == 0


@BOTH
def test_static_friction_holds_longer_and_then_lets_go(how, error):
    # Acceleration 2 mu g sin wt: held up to sin wt = static/2, then mu g alone.
    period, static = 0.5, 1.6
    w, top = 2 * np.pi / period, 2 * LIMIT / (2 * np.pi / period)
    cycle = waves(period, [[0, 0, 0]], [[-top, 0, 0]], 512)
    release = np.arcsin(static / 2) / w
    run = simulate(cycle, STILL, [[-top, 0]], MU, G, ground=Ground(static), **how)
    t = run.time
    v = np.where(t < release, -top * np.cos(w * t), -top * np.cos(w * release))
    v += LIMIT * np.maximum(0, t - release)
    before = t < 0.25 * period
    assert run.velocity[before, 0, 0] == pytest.approx(v[before], abs=max(1e-9, 50 * error))
    assert run.velocity[before][-1, 0, 0] < -0.01 * top


@pytest.mark.parametrize(
    ("gamma", "static", "fraction"),
    [(1.5, 1.2, 0.0), (2.5, 1.5, 0.3), (4, 1.3, -0.4), (4, 2.0, 0.0), (20, 1.5, 0.2), (3, 1, 0.5)],
)
def test_agrees_with_an_event_driven_truth(gamma, static, fraction):
    scene, ground = TwoHarmonics(gamma, static, fraction), Ground(static, steep(fraction))
    truth, stuck = scene.travel(0.2)
    assert stuck >= 1 or gamma == 20
    options = {"cycles": 6, "ground": ground}
    for tolerance, error in ((1e-12, 3e-11), (1e-7, 6e-7)):
        run = simulate(scene.cycle(), STILL, STILL, MU, G, tolerance=tolerance, **options)
        assert run.position[-1, 0, 0] == pytest.approx(truth, abs=error)
    run = simulate(scene.cycle(), STILL, STILL, MU, G, samples=16_000, **options)
    assert run.position[-1, 0, 0] == pytest.approx(truth, abs=2e-6)


def test_agrees_with_scipy_on_a_tilted_plate_that_turns():
    rng = np.random.default_rng(3)
    cycle = waves(0.05, *(rng.normal(size=(2, 2, 3)) * [0.1, 0.1, 0.7]))
    ground = Ground(1.5, (0.1, -0.2))
    pull = np.array(ground.effect(G)[:2])
    assert pull == pytest.approx([G * np.sin(0.1), -G * np.sin(0.2)])
    start = np.array([0.2, -0.1, 0.5, -0.6])

    def rate(t, state):
        t %= 0.05
        slip = surface_velocity(cycle.pose(t)[0], cycle.twist(t)[0], state[:2]) - state[2:]
        return np.concatenate([state[2:], LIMIT * slip / np.linalg.norm(slip) + pull])

    truth = solve_ivp(rate, (0, 0.1), start, max_step=1e-3, **TIGHT).y[:, -1]
    for how, error in (({"tolerance": 1e-13}, 1e-10), ({"samples": 8000}, 1e-6)):
        run = simulate(cycle, start[None, :2], start[None, 2:], MU, G, 2, ground=ground, **how)
        assert run.position[-1, 0] == pytest.approx(truth[:2], abs=error)
        assert run.velocity[-1, 0] == pytest.approx(truth[2:], abs=30 * error)


def test_both_integrators_agree_on_tilted_plates():
    rng = np.random.default_rng(11)
    for _ in range(15):
        period, size = rng.uniform(0.02, 0.2), 10 ** rng.uniform(-2, 0)
        cycle = waves(period, *(rng.normal(size=(2, 3, 3)) * [size, size, 7 * size]), 64)
        position, velocity = rng.uniform(-0.3, 0.3, (2, 3, 2)) * [[[1.0]], [[0.3]]]
        ground = Ground(1.0, tuple(rng.uniform(-0.1, 0.1, 2)))
        exact, steps = (
            simulate(cycle, position, velocity, MU, G, 2, ground=ground, **how)
            for how in ({"samples": 1, "tolerance": 1e-9}, {"samples": 16_000})
        )
        assert steps.position[-1] == pytest.approx(exact.position[-1], abs=3e-6)


def test_samples_on_a_tilted_plate_lie_on_one_motion():
    cycle = waves(0.1, [[0.1, 0.05, 0.2]], [[0.02, 0.1, -0.1]])
    run = simulate(
        cycle, [[0.1, 0.2]], [[0.1, 0]], MU, G, 3, 2000, 1e-9, ground=Ground(1.3, (0.05, 0.1))
    )
    step = 0.1 / 2000
    middle = 0.5 * (run.velocity[1:] + run.velocity[:-1]) * step
    assert np.diff(run.position, axis=0) == pytest.approx(middle, abs=LIMIT * step**2)
    assert np.abs(run.position[-1] - run.position[0]).max() > 1e-3


@BOTH
def test_held_parts_keep_their_place_on_a_tilted_plate_that_turns(how, error):
    cycle = waves(0.2, [[0.02, 0.01, 0.1]], [[0, 0, 0]])
    position = np.array([[0.25, 0.1], [-0.1, 0.05]])
    speed = [surface_velocity(cycle.pose(0)[0], cycle.twist(0)[0], p) for p in position]
    ground = Ground(2.5, steep(1.5, 0.7))  # more than dynamic friction could hold
    run = simulate(cycle, position, speed, MU, G, 20, ground=ground, **how)
    late = to_plate(cycle.pose(0)[0], run.position[-1])
    assert late == pytest.approx(to_plate(cycle.pose(0)[0], position), abs=max(error, 1e-12))


@BOTH
def test_a_plate_that_runs_away_carries_or_leaves_its_part(how, error):
    # From rest, x = a t^2/2: it never closes.
    for fraction, static in ((0.9, 1.0), (1.2, 1.3), (1.4, 1.3), (5.0, 1.0)):
        pieces = np.zeros((1, 6, 3))
        pieces[0, 2, :2] = 0.3 * fraction * LIMIT, 0.4 * fraction * LIMIT
        motion = PlateMotion(np.array([0.0, 0.2]), pieces)
        run = simulate(motion, STILL, STILL, MU, G, ground=Ground(static), **how)
        held = fraction if fraction <= static else 1.0
        way = 0.5 * held * LIMIT * 0.2**2 * np.array([0.6, 0.8])
        assert run.position[-1, 0] == pytest.approx(way, abs=20 * error)


def test_a_cycle_done_as_commanded_moves_parts_as_the_cycle_does():
    cycle = waves(0.1, [[0.1, 0.05, 0.2]], [[0.02, 0.1, -0.1]])
    for how in ({"tolerance": 1e-9}, {"samples": 500}):
        a, b = (
            simulate(motion, [[0.1, 0.2]], [[0.1, 0]], MU, G, ground=Ground(1.3, (0.02, 0)), **how)
            for motion in (cycle, PlateMotion.of_cycle(cycle))
        )
        assert np.array_equal(a.position, b.position)
        assert np.array_equal(a.velocity, b.velocity)


def test_a_motion_that_need_not_close_is_not_repeated():
    motion = PlateMotion.of_cycle(PlateCycle.rest(0.1))
    with pytest.raises(PlateError, match="cycles is 2, allowed: 1 for a PlateMotion"):
        simulate(motion, STILL, STILL, MU, cycles=2)


def test_a_part_without_friction_falls_down_the_tilt():
    pull = np.array(Ground(1.0, (0.1, 0.2)).effect(G)[:2])
    for how in ({}, {"samples": 50}):
        run = simulate(
            PlateCycle.rest(0.1),
            STILL,
            [[0.3, 0]],
            0.0,
            G,
            2,
            ground=Ground(1.0, (0.1, 0.2)),
            **how,
        )
        assert run.position[-1, 0] == pytest.approx([0.06, 0] + 0.02 * pull, abs=1e-14)
        assert run.velocity[-1, 0] == pytest.approx([0.3, 0] + 0.2 * pull, abs=1e-14)


def test_a_temporary_motion_in_one_direction_is_not_treated_as_a_line():
    # The plate speeds up along x, and only later along y.
    times = np.array([0.0, 0.05, 0.1])
    pieces = np.zeros((2, 6, 3))
    pieces[0, 2, 0] = 0.5 * 10
    pieces[1, :3, 0] = 0.5 * 10 * 0.05**2, 10 * 0.05, 0.5 * 1.0
    pieces[1, 2, 1] = 0.5 * 8.0
    motion = PlateMotion(times, pieces)
    exact = simulate(motion, STILL, STILL, MU, G, tolerance=1e-10)
    steps = simulate(motion, STILL, STILL, MU, G, samples=20_000)
    assert exact.position[-1] == pytest.approx(steps.position[-1], abs=1e-7)
    assert exact.position[-1, 0, 1] > 1e-4


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        *(("tilt", value, "rad, allowed: two angles, up to 0.5") for value in (
            (0.1,), (0.1, 0.1, 0.1), (np.nan, 0.0), (0.0, -np.inf), (0.31, -0.41), (0.0, 0.51),
        )),
        *(("static_ratio", value, ", allowed: 1 to 10") for value in (0.99, 10.1, np.nan)),
        *(("friction_slope", value, ", allowed: -5 to 5") for value in (-5.1, 5.1, np.nan)),
        *(("heave", value, ", allowed: -0.1 to 0.1") for value in (-0.11, 0.11, np.nan)),
    ],
)  # fmt: skip
def test_ground_out_of_range_is_refused(name, value, allowed):
    with pytest.raises(PlateError) as error:
        Ground(**{name: value})
    assert str(error.value).startswith(f"{name} is {value!r}")
    assert str(error.value).endswith(allowed)


def test_ground_at_the_ends_of_its_ranges_is_allowed():
    for static, slope, heave in ((1.0, -5.0, -0.1), (10.0, 5.0, 0.1)):
        Ground(static, (0.3, -0.4), slope, heave)
