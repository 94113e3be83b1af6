"""Method A: sequences of rotations as motions in time, and their solver."""

import numpy as np
import pytest

from plate_core import PlateError
from plate_core.motion import usage
from plate_solver import Goal, Limits, RotationSolver, average_force
from plate_solver._kernels import force_slopes, run_of
from plate_solver.averages import step_forces
from plate_solver.library.library import unit_twists
from plate_solver.rotations.family import RotationFamily, Run, Sequences

HALF = np.array([0.3, 0.15])
CORNERS = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
CENTRES = np.array([[0.1, 0.05], [-0.2, 0.0], [0.0, -0.12], [0.28, 0.14]])
PERIOD, ACCEL = 0.2, 90.0
TWISTS = unit_twists(CENTRES, HALF)
NO_LOADS = np.empty((0, 3))
HOLDS = np.array([1.0, 2.0, 0.5, 1.5, 0.3])
SPEED = np.array([0.25, -0.2, 0.1, -0.3])
TURNS = TWISTS * SPEED[:, None]


@pytest.fixture(name="played")
def _played(rig):
    """The example sequence."""
    steps, limits = (2000, 2000), Limits.of(rig)
    family = Sequences(4, np.ones(3), PERIOD, ACCEL, NO_LOADS, steps, limits)
    return Run(*run_of(np.append(HOLDS, TURNS), family))


def test_sequence_closes_from_rest_to_rest(played):
    pose, twist, accel, dt, gap = *played[3:7], played.knot_pose[-1]
    assert np.max(np.abs(gap)) > 1e-3, "nothing had to be closed"
    assert dt.sum() == pytest.approx(PERIOD)
    for end in (0, -1):
        assert np.max(np.abs(pose[end])) < 1e-8
        assert np.max(np.abs(twist[end])) < 1e-4
        assert np.max(np.abs(accel[end])) < 1
    np.testing.assert_allclose(dt @ twist, 0, atol=1e-8)


def test_sequence_is_consistent_in_time(played):
    t = np.cumsum(played.dt) - played.dt / 2
    for of, derivative in ((played.pose, played.twist), (played.twist, played.accel)):
        slope = np.diff(of, axis=0) / np.diff(t)[:, None]
        middle = (derivative[1:] + derivative[:-1]) / 2
        np.testing.assert_allclose(slope, middle, atol=2e-3 * np.max(np.abs(derivative)))


def test_sequence_turns_about_its_centres_in_order(played):
    accel, gap = played.accel, played.knot_pose[-1]
    times, knots = played.times, played.knot_twist
    assert times[0] == 0
    assert times[-1] == pytest.approx(PERIOD)
    assert np.all(np.diff(times) >= 0)
    holding = np.diff(times)[1::2]
    np.testing.assert_allclose(holding / holding.sum(), HOLDS / HOLDS.sum())
    for j, centre in enumerate(CENTRES):
        u, v, spin = knots[2 * j + 1]
        np.testing.assert_array_equal(knots[2 * j + 2], knots[2 * j + 1])
        np.testing.assert_allclose([u - spin * centre[1], v + spin * centre[0]], 0, atol=1e-12)
        assert np.sign(spin) == np.sign(SPEED[j])
    # Ramps reach the acceleration they may have; the closing bump adds at most 5.8 gap/T^2.
    x, y = CORNERS.T
    along = accel[:, :1] - accel[:, 2:] * y, accel[:, 1:2] + accel[:, 2:] * x
    bump = 5.8 * (np.hypot(*gap[:2]) + abs(gap[2]) * np.hypot(*HALF)) / PERIOD**2
    assert abs(np.max(np.hypot(*along)) - ACCEL) < bump
    assert bump < 0.05 * ACCEL


def family(rig, steps=None):
    return RotationFamily(TURNS / 0.25, Limits.of(rig), PERIOD, 0.25, steps=steps)


def test_family_cycle_agrees_with_its_samples(rig):
    sequence = family(rig, (40, 40))
    parameters = sequence.parameters(0.9 * HOLDS[:4] / HOLDS.sum())
    cycle = sequence.cycle(parameters)
    assert cycle.starts_at_rest
    assert usage(rig, cycle).worst <= 1.02
    pose, twist, dt = sequence.samples(parameters)
    t = np.cumsum(dt) - dt / 2
    np.testing.assert_allclose(cycle.pose(t), pose, atol=1e-9)
    np.testing.assert_allclose(cycle.twist(t), twist, atol=1e-9)


def test_family_slopes_agree_with_differences(rig):
    sequence = family(rig, (5, 4))
    parameters = 0.9 * sequence.parameters(0.9 * HOLDS[:4] / HOLDS.sum())
    # One motor's stroke is exceeded, so that its penalty is seen too.
    parameters[:5] *= [4, 1, 1, 1, 1]
    assert np.any(sequence.penalty(parameters)[3:] != 0)
    rng = np.random.default_rng(0)
    n = 5 * (5 + 4)
    weights = [rng.normal(size=shape) for shape in ((3, n, 6), (3, n, 6), (n, 6))]

    def values(theta):
        seen = zip(weights, sequence.samples(theta), strict=True)
        return sum(np.tensordot(s.T, w, s.ndim) for w, s in seen), sequence.penalty(theta)

    slopes = sequence.pull_back(parameters, *weights), -sequence.penalty_slopes(parameters)
    step = 1e-6
    for p, d in enumerate(step * np.eye(len(parameters))):
        ends = values(parameters + d), values(parameters - d)
        for k, found in enumerate(slopes):
            slope = (ends[0][k] - ends[1][k]) / (2 * step)
            np.testing.assert_allclose(found[:, p], slope, atol=1e-6 * np.max(np.abs(found)))


def test_force_slopes_agree_with_differences(rig):
    sequence = family(rig, (7, 4))
    parameters = sequence.parameters(0.9 * HOLDS[:4] / HOLDS.sum())
    rng = np.random.default_rng(3)
    position = rng.uniform(-1, 1, (3, 2)) * rig.plate.half
    velocity = 0.02 * rng.normal(size=(3, 2))
    requested = np.array([1, 1, 0, 1, 1, 1, 0, 1, 1], bool)

    def forces(theta):
        _, twist, dt = sequence.samples(theta)
        return step_forces(position, velocity, twist, dt).ravel()[requested]

    found = force_slopes(parameters, sequence.kernel_data, position, velocity, requested)
    step = 1e-6
    for p, d in enumerate(step * np.eye(len(parameters))):
        slope = (forces(parameters + d) - forces(parameters - d)) / (2 * step)
        np.testing.assert_allclose(found[:, p], slope, atol=1e-5 * np.max(np.abs(found)))


@pytest.mark.parametrize("seed", range(4))
def test_admissible_parameters_are_within_the_limits(rig, seed):
    rng = np.random.default_rng(seed)
    sequence = RotationFamily(TURNS, Limits.of(rig), PERIOD, 0.25, within_stroke=True)
    wild = 20 * rng.normal(size=len(sequence.parameters(np.ones(4))))
    kept = sequence.admissible(wild)
    assert np.all(kept[:5] > 0)
    # Samples can miss a peak by some per cent; solvers scale their results by an exact check.
    assert usage(rig, sequence.cycle(kept)).worst < 1.06
    np.testing.assert_array_equal(np.sign(kept[5:]), np.sign(wild[5:]))
    gentle = np.concatenate([kept[:5], 0.1 * np.sign(wild[5:])])
    np.testing.assert_array_equal(sequence.admissible(gentle), gentle)


def test_fractions_become_lengths(rig):
    sequence = family(rig)
    fraction = np.array([0.2, 0.3, 0.1, 0.1])
    parameters = sequence.parameters(fraction)
    np.testing.assert_allclose(parameters[:4] / parameters[0], fraction / 0.2)
    assert parameters[4] / parameters[0] == pytest.approx(0.3 / 0.2)  # the remaining time is rest
    np.testing.assert_array_equal(sequence.parameters(3 * fraction)[4], 0.02)  # nothing is left


def test_cycle_is_made_of_rotations_from_rest_to_rest(rig, scene):
    rng, position = scene(0, 1)
    solver = RotationSolver(rig, period=0.25, restarts=2)
    solution = solver.solve(position, rng.uniform(-0.1, 0.1, (1, 2)))
    cycle = solution.cycle
    assert cycle.starts_at_rest
    assert cycle.period == pytest.approx(0.25)
    assert solver.steering_period(7) == pytest.approx(0.25)


def test_close_parts_that_go_apart_are_not_shaken_wildly(rig):
    position = np.array([[0.05, 0.02], [0.051, 0.02]])
    solver = RotationSolver(rig, restarts=0)
    apart = solver.solve(position, [[0.1, 0.0], [-0.1, 0.0]])
    assert not apart.success
    assert usage(rig, apart.cycle).worst <= 1
    far = solver.solve(position * [[1, 1], [-3, 1]], [[0.1, 0.0], [-0.1, 0.0]])
    assert far.success


@pytest.mark.parametrize("seed", range(5))
def test_hard_requests_get_true_answers_within_the_limits(rig, seed):
    """Parts in one place, almost in one place, on a centre, off the plate; requests of zero, and
    far too large ones."""
    rng = np.random.default_rng(seed)
    solver = RotationSolver(rig, restarts=0, iterations=8)
    met = 0
    for case in range(12):
        count = int(rng.integers(2, 11))
        position = rng.uniform(-1, 1, (count, 2)) * HALF
        if case % 6 < 2:
            position[1] = position[0] + (case % 6) * 1e-6
        position *= 5 if case % 6 == 2 else 1
        if case % 6 == 3:
            position[0] = solver.library.centre[rng.integers(480)]
        force = 10.0 ** rng.uniform(-3, 1) * rng.normal(size=(count, 2)) * (case % 6 != 4)
        found = solver.solve(position, force)
        moved = solver.steer(
            Goal(position, 0 * force, np.clip(0.01 * force, -0.01, 0.01), 0 * force, 2.45),
            1e-5, 1e-4,
        )  # fmt: skip
        for solution in (found, moved):
            assert usage(rig, solution.cycle).worst <= 1
            assert np.all(np.isfinite(solution.residual))
        if found.success:
            met += 1
            np.testing.assert_allclose(average_force(found.cycle, position), force, atol=1.001e-3)
    assert 2 <= met < 12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 0.0}, "speed is 0.0, allowed: 0.001 to 10"),
        ({"max_price": 0.5}, "max_price is 0.5, allowed: 1 to "),
    ],
)
def test_wrong_options_are_named(rig, options, message):
    with pytest.raises(PlateError, match=message):
        RotationSolver(rig, **options)
