"""The exact integrator against scipy's event-driven and stiff solvers, theory, and symmetries."""

from itertools import pairwise

import numpy as np
import pytest
from harmonic import MU, TIGHT, G, TwoHarmonics, waves
from scipy.integrate import solve_ivp

from plate_core import PlateCycle, PlateError
from plate_core.rig import surface_velocity, to_plate
from plate_sim import simulate, simulate_bodies
from plate_sim.friction import TOLERANCE, disc
from plate_sim.friction.point_events import run_points
from plate_sim.plate.pieces import tabulate

STILL = np.zeros((1, 2))


@pytest.mark.parametrize(("gamma", "known"), [(4, 4.997416048e-3), (20, 65.3462e-3)])
def test_travel_of_the_exact_scene(gamma, known):
    line = TwoHarmonics(gamma)
    truth, _ = line.travel(30 * line.period)
    for tolerance, error in ((1e-12, 1e-12), (TOLERANCE, 1e-9)):
        run = simulate(line.cycle(), STILL, STILL, MU, G, 30, tolerance=tolerance)
        assert run.position[-1, 0, 0] == pytest.approx(truth, abs=error)
    assert truth == pytest.approx(known, abs=1e-11 if gamma == 4 else 5e-8)


def scenes(seed, count, parts=3):
    """Random motions and parts: period, cycle, position, velocity, mu."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        period, size = rng.uniform(0.02, 0.2), 10 ** rng.uniform(-2, 0)
        cycle = waves(period, *(rng.normal(size=(2, 3, 3)) * [size, size, 7 * size]), 64)
        position = rng.uniform(-0.3, 0.3, (parts, 2))
        velocity = 0.1 * rng.normal(size=(parts, 2)) * rng.integers(0, 2)
        yield cycle, position, velocity, 10 ** rng.uniform(-2, 0.3)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10])
def test_true_error_is_below_the_tolerance(tolerance):
    for cycle, position, velocity, mu in scenes(0, 40):
        truth, run = (
            simulate(cycle, position, velocity, mu, samples=1, tolerance=expected).position[-1]
            for expected in (1e-12, tolerance)
        )
        assert np.max(np.linalg.norm(run - truth, axis=1)) < tolerance


def test_agrees_with_the_steps_of_a_tiny_disc():
    for cycle, position, velocity, mu in scenes(1, 20):
        exact = simulate(cycle, position, velocity, mu)
        steps = simulate_bodies(
            cycle, disc(1e-7), position, 0, velocity, 0, mu, samples=0, step=cycle.period / 20_000
        )
        assert steps.position[-1] == pytest.approx(exact.position[-1], abs=2e-6)


def sliding(seed=3):
    """Cycle, and a part whose slip never comes near 0 in it."""
    rng = np.random.default_rng(seed)
    cycle = waves(0.05, *(rng.normal(size=(2, 2, 3)) * [0.1, 0.1, 0.7]))
    return cycle, np.array([[0.2, -0.1]]), np.array([[0.5, -0.6]])


def solved_by_scipy(cycle, position, velocity):
    def rate(t, state):
        surface = surface_velocity(cycle.pose(t)[0], cycle.twist(t)[0], state[:2])
        slip = surface - state[2:]
        return np.concatenate([state[2:], MU * G * slip / np.linalg.norm(slip)])

    start = np.concatenate([position[0], velocity[0]])
    return solve_ivp(rate, (0, cycle.period), start, max_step=1e-3, **TIGHT).y[:, -1]


def test_agrees_with_scipy_in_the_plane():
    cycle, position, velocity = sliding()
    truth = solved_by_scipy(cycle, position, velocity)
    run = simulate(cycle, position, velocity, MU, G, tolerance=1e-13)
    assert run.position[-1, 0] == pytest.approx(truth[:2], abs=1e-13)
    assert run.velocity[-1, 0] == pytest.approx(truth[2:], abs=1e-11)


def test_error_falls_with_the_fifth_power_of_the_steps():
    cycle, position, velocity = sliding()
    truth = solved_by_scipy(cycle, position, velocity)[:2]
    steps, errors = [], []
    for tolerance in (1e-7, 1e-8, 1e-9, 1e-10, 1e-11):
        path, speed = np.empty((2, 2, 1, 2))
        path[0], speed[0] = position, velocity
        how = np.array([MU * G]), 1.0, tolerance, 1
        steps.append(run_points(*tabulate(cycle), *how, path, speed, np.empty(1, bool)))
        errors.append(np.linalg.norm(path[-1, 0] - truth))
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order > 4.7


def test_stuck_parts_keep_their_place_in_the_plate():
    cycle = waves(0.2, [[0.02, 0.01, 0.1]], [[0, 0, 0]])
    position = np.array([[0.25, 0.1], [-0.1, 0.05], [0, 0]])
    speed = [surface_velocity(cycle.pose(0)[0], cycle.twist(0)[0], p) for p in position]
    run = simulate(cycle, position, speed, MU, G, cycles=2000, samples=7, tolerance=1e-6)
    home = to_plate(cycle.pose(0)[0], position)
    for k in (1, 3, 6):
        late = to_plate(cycle.pose(run.time[k])[0], run.position[-8 + k])
        assert late == pytest.approx(home, abs=1e-14)


def test_a_part_slips_again_when_the_surface_accelerates_too_much():
    # a(t) = 2 mu g sin wt: held until sin wt = 1/2.
    period = 0.5
    w, top = 2 * np.pi / period, 2 * MU * G
    cycle = waves(period, [[0, 0, 0]], [[-top / w, 0, 0]])
    run = simulate(cycle, STILL, [[-top / w, 0]], MU, G, samples=2400, tolerance=1e-9)
    surface = cycle.twist(run.time % period)[:, 0]
    slips = np.abs(run.velocity[:, 0, 0] - surface) > 1e-12
    assert run.time[np.argmax(slips)] == pytest.approx(period / 12, abs=period / 2400 * 1.01)
    assert np.ptp(np.diff(run.velocity[202:600, 0, 0])) < 1e-12  # mu g, evenly
    assert run.velocity[300, 0, 0] == pytest.approx(
        -top / w * np.cos(np.pi / 6) + MU * G * (run.time[300] - period / 12), abs=1e-12
    )


def test_rotation_throws_parts_off_that_ride_too_far_out():
    # A rotation whose angular velocity peaks at rim: r w^2 acts there on a part at radius r.
    angle, period = 0.4, 0.5
    cycle = waves(period, [[0, 0, 0]], [[0, 0, 2 * np.pi * angle / period]])
    t = np.linspace(0, period, 4001)
    spin, push = cycle.twist(t)[:, 2], cycle.accel(t)[:, 2]
    radius = MU * G / np.max(np.hypot(spin**2, push))
    for fraction, held in ((0.999, True), (1.001, False)):
        position = np.array([[fraction * radius, 0.0]])
        speed = [surface_velocity(cycle.pose(0)[0], cycle.twist(0)[0], position[0])]
        run = simulate(cycle, position, speed, MU, G, cycles=2)
        away = np.abs(to_plate(cycle.pose(0)[0], run.position[-1]) - position).max()
        assert (away < 1e-12) == held


def test_steady_speed_is_the_median_of_the_plates_velocity():
    line = TwoHarmonics(400)
    median = np.median(line.velocity(np.arange(100_000) * line.period / 100_000))
    run = simulate(
        line.cycle(), STILL, [[0.8 * median, 0]], MU, G, cycles=600, samples=1, tolerance=1e-9
    )
    drift = np.diff(run.position[-3:, 0, 0]) / line.period
    assert drift == pytest.approx(median, rel=2e-3)


def test_no_line_motion_carries_faster_than_a_t_over_16():
    rng = np.random.default_rng(5)
    for _ in range(20):
        cycle = waves(0.05, *(rng.normal(size=(2, 4, 3)) * [0.3, 0, 0]), 64)
        bound = np.abs(cycle.accel(np.linspace(0, 0.05, 1001))[:, 0]).max() * 0.05 / 16
        run = simulate(cycle, STILL, STILL, 0.1, G, cycles=60, samples=1, tolerance=1e-9)
        assert np.abs(np.diff(run.position[:, 0, 0])).max() / 0.05 <= bound


def test_the_best_line_motion_comes_near_a_t_over_16():
    # Half the cycle at a T/16, then down and up again at a (paper's physics, DESIGN 5).
    period, a = 0.05, 100.0
    knots = period * np.array([0, 0.5, 0.75, 1])
    t = np.concatenate([np.linspace(p + 1e-5, q - 1e-5, 20) for p, q in pairwise(knots)])
    t = np.concatenate([[0], t, [period]])
    accel = np.select([t < knots[1], t < knots[2]], [0, -a], a)
    accel[[0, -1]] = 0.5 * a
    speed = a * (period / 16 - np.interp(t, knots, [0, 0, period / 4, 0]))
    position = np.concatenate([[0], np.cumsum(np.diff(t) * (speed[1:] + speed[:-1]) / 2)])
    position -= position[-1] * t / period  # rounding of the rule where the acceleration jumps
    states = np.zeros((3, len(t), 3))
    states[:, :, 0] = position, speed, accel
    cycle = PlateCycle.from_knots(t, *states)
    start = [[0.9 * a * period / 16, 0]]
    run = simulate(cycle, STILL, start, 0.01, G, cycles=1000, samples=1, tolerance=1e-9)
    drift = (run.position[-1] - run.position[-2])[0, 0] / period
    assert 0.97 * a * period / 16 < drift <= a * period / 16 * (1 + 1e-9)


def turned(array, angle):
    return array @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def moved(cycle, change, turn=1.0):
    """Cycle in a changed frame: change (n, 2) -> (n, 2), and the sense of turning."""
    states = [
        np.column_stack([change(s[:, :2]), turn * s[:, 2]])
        for s in (cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    ]
    return PlateCycle.from_knots(cycle.times, *states)


def test_results_do_not_depend_on_order_or_frame():
    rng = np.random.default_rng(6)
    for cycle, position, velocity, mu in scenes(7, 15, parts=4):
        run = simulate(cycle, position, velocity, mu, cycles=2)
        order = rng.permutation(4)
        again = simulate(cycle, position[order], velocity[order], mu, cycles=2)
        assert np.array_equal(again.position, run.position[:, order])
        assert np.array_equal(again.velocity, run.velocity[:, order])
        for change, turn in (
            (lambda a: turned(a, 0.7), 1.0),
            (lambda a: turned(a, np.pi / 2), 1.0),
            (lambda a: a * [-1.0, 1.0], -1.0),
        ):
            there = simulate(
                moved(cycle, change, turn), change(position), change(velocity), mu, cycles=2
            )
            assert there.position == pytest.approx(change(run.position), abs=2e-7)


def test_output_samples_do_not_change_the_motion():
    for cycle, position, velocity, mu in scenes(8, 10):
        few = simulate(cycle, position, velocity, mu, samples=3, tolerance=1e-9, cycles=2)
        many = simulate(cycle, position, velocity, mu, samples=3000, tolerance=1e-9, cycles=2)
        assert np.array_equal(few.position[-1], many.position[-1])
        assert many.position[::1000] == pytest.approx(few.position, abs=1e-15)
        step = cycle.period / 3000
        assert np.all(np.linalg.norm(np.diff(many.velocity, axis=0), axis=2) <= mu * G * step * 1.2)
        middle = 0.5 * (many.velocity[1:] + many.velocity[:-1]) * step
        assert np.max(np.abs(np.diff(many.position, axis=0) - middle)) <= mu * G * step**2


def test_no_input_gives_nan_or_stalls():
    rng = np.random.default_rng(9)
    for case in range(40):
        size = 10 ** rng.uniform(-20, 20, 5) * rng.integers(0, 2, 5)
        pose = rng.normal(size=(rng.integers(1, 20), 3)) * size[:3]
        rates = (0 * pose, 0 * pose) if case % 2 else (None, None)
        cycle = PlateCycle.from_samples(10 ** rng.uniform(-4, 2), pose, *rates)
        position, velocity = rng.normal(size=(2, 2, 2)) * size[3:, None, None]
        for mu in (0, 10 ** rng.uniform(-20, 20)):
            run = simulate(cycle, position, velocity, mu, samples=4, tolerance=1e-7)
            assert np.all(np.isfinite(run.position))
            assert np.all(np.isfinite(run.velocity))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cycle": None}, "cycle is a NoneType"),
        ({"position": [[0, 0], [0, np.nan]]}, r"position .* not finite: part 1 has \[0.0, nan\]"),
        ({"velocity": [[-np.inf, 0], [0, 0]]}, "velocity .* part 0"),
        ({"velocity": [[1e80, 0], [0, 0]]}, "velocity .* too large: part 0"),
        ({"friction": [0.1, -0.2]}, "friction is -0.2 for part 1"),
        ({"gravity": np.nan}, "gravity is nan"),
        ({"cycles": 1.5}, "cycles is 1.5"),
        ({"tolerance": 0}, "tolerance is 0"),
    ],
)
def test_wrong_arguments_of_simulate_are_refused(change, message):
    arguments = {
        "cycle": PlateCycle.rest(0.1), "position": np.zeros((2, 2)), "velocity": np.zeros((2, 2)),
        "friction": MU,
    }  # fmt: skip
    with pytest.raises(PlateError, match=message):
        simulate(**(arguments | change))
