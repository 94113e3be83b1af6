"""Method A: sequences of rotations as motions in time, and their solver."""

import numpy as np
import pytest

from plate_core import PlateError
from plate_core.limits import corner_accel, usage
from plate_solver import RotationSolver
from plate_solver.centres import ring, unit_twists
from plate_solver.rotation_family import RotationFamily
from plate_solver.sequence import motion, timeline
from plate_solver.solution import Bounds

HALF = np.array([0.3, 0.15])
CORNERS = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
CENTRES = np.array([[0.1, 0.05], [-0.2, 0.0], [0.0, -0.12], [0.28, 0.14]])
PERIOD, ACCEL = 0.2, 90.0
TWISTS = unit_twists(CENTRES, HALF)
HOLDS = np.array([1.0, 2.0, 0.5, 1.5, 0.3])
SPEED = np.array([0.25, -0.2, 0.1, -0.3])


@pytest.fixture(name="played")
def _played():
    """The example sequence at 20,000 steps: pose, twist, acceleration, gap, and the step."""
    n = 20_000
    pose, twist, accel = np.empty((3, n, 3))
    gap = motion(*timeline(HOLDS, SPEED, TWISTS, HALF, PERIOD, ACCEL), n, pose, twist, accel)
    return pose, twist, accel, gap, PERIOD / n


def test_sequence_closes_from_rest_to_rest(played):
    pose, twist, accel, gap, dt = played
    assert np.max(np.abs(gap)) > 1e-3, "nothing had to be closed"
    # Samples are at the middles of steps: half a step from the edge.
    for end in (0, -1):
        assert np.max(np.abs(pose[end])) < 1e-9
        assert np.max(np.abs(twist[end])) < 20 * dt
        assert np.max(np.abs(accel[end])) < 10
    np.testing.assert_allclose(twist.sum(axis=0) * dt, 0, atol=1e-9)


def test_sequence_is_consistent_in_time(played):
    pose, twist, accel, _, dt = played
    for of, derivative in ((pose, twist), (twist, accel)):
        slope = (of[2:] - of[:-2]) / (2 * dt)
        scale = np.max(np.abs(derivative))
        np.testing.assert_allclose(slope, derivative[1:-1], atol=2e-3 * scale)


def test_sequence_turns_about_its_centres_in_order(played):
    _, _, accel, gap, _ = played
    times, knots = timeline(HOLDS, SPEED, TWISTS, HALF, PERIOD, ACCEL)
    assert times[0] == 0
    assert times[-1] == pytest.approx(PERIOD)
    assert np.all(np.diff(times) >= 0)
    holding = np.diff(times)[1::2]
    np.testing.assert_allclose(holding / holding.sum(), HOLDS[: len(holding)] / HOLDS.sum())
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


def test_ramps_that_do_not_fit_are_made_by_going_slower():
    times, knots = timeline(HOLDS, 10 * SPEED, TWISTS, HALF, PERIOD, ACCEL)
    assert times[-1] == pytest.approx(PERIOD)
    assert np.all(np.diff(times) >= 0)
    slower = knots[1:-2:2, 2] / (10 * SPEED * TWISTS[:, 2])
    np.testing.assert_allclose(slower, slower[0])
    assert slower[0] < 1
    # The ramps still keep to the acceleration: 1.5 x mean at the fastest corner.
    step = np.diff(knots, axis=0)[::2]
    lasts = np.diff(times)[::2]
    change = np.stack([step[:, :2] + step[:, 2:] * [-y, x] for x, y in CORNERS])
    assert np.max(np.hypot(*np.moveaxis(change, 2, 0)) * 1.5 / lasts) < 1.001 * ACCEL


def family(rig, steps=0):
    return RotationFamily(TWISTS, Bounds.of(rig), PERIOD, 0.25, steps)


def test_family_cycle_agrees_with_its_samples(rig):
    sequence = family(rig, 3000)
    parameters = sequence.admissible(np.concatenate([HOLDS, SPEED / 0.25]))
    cycle = sequence.cycle(parameters)
    assert cycle.starts_at_rest
    assert usage(rig, cycle).worst <= 1.02
    pose, twist = sequence.samples(parameters)
    t = (np.arange(3000) + 0.5) * sequence.dt
    np.testing.assert_allclose(cycle.pose(t), pose, atol=1e-9)
    np.testing.assert_allclose(cycle.twist(t), twist, atol=1e-9)


def test_family_slopes_agree_with_differences(rig):
    sequence = family(rig, 120)
    parameters = np.concatenate([HOLDS, 0.6 * SPEED / 0.25])
    rng = np.random.default_rng(0)
    by_twist, by_pose = rng.normal(size=(5, 120, 3)), rng.normal(size=(5, 120, 2))

    def values(parameters):
        pose, twist = sequence.samples(parameters)
        seen = np.einsum("rnc,nc->r", by_twist, twist)
        return seen + np.einsum("rnc,nc->r", by_pose, pose[:, :2]), sequence.penalty(parameters)

    slopes = sequence.pull_back(parameters, by_twist, by_pose), -sequence.penalty_slopes(parameters)
    step = 1e-6
    for p, d in enumerate(step * np.eye(len(parameters))):
        ends = values(parameters + d), values(parameters - d)
        for k, found in enumerate(slopes):
            slope = (ends[0][k] - ends[1][k]) / (2 * step)
            np.testing.assert_allclose(found[:, p], slope, atol=5e-3 * np.max(np.abs(found)))


@pytest.mark.parametrize("seed", range(4))
def test_admissible_parameters_are_within_the_limits(rig, seed):
    rng = np.random.default_rng(seed)
    sequence = family(rig)
    wild = np.concatenate([rng.normal(size=5), 20 * rng.normal(size=4)])
    kept = sequence.admissible(wild)
    assert np.all(kept[:5] > 0)
    # Samples may miss a peak by some per cent; solvers scale what they return by an exact check.
    assert usage(rig, sequence.cycle(kept)).worst < 1.06
    np.testing.assert_array_equal(np.sign(kept[5:]), np.sign(wild[5:]))
    gentle = np.concatenate([kept[:5], 0.1 * np.sign(wild[5:])])
    np.testing.assert_array_equal(sequence.admissible(gentle), gentle)


def test_shares_become_lengths_and_senses(rig):
    share = np.array([0.2, -0.3, 0.1, -0.1])
    parameters = family(rig).parameters(share)
    np.testing.assert_allclose(parameters[:4] / parameters[0], np.abs(share) / 0.2)
    assert parameters[4] / parameters[0] == pytest.approx(0.3 / 0.2)  # what is left is rest
    np.testing.assert_array_equal(np.sign(parameters[5:]), np.sign(share))


def test_cycle_is_made_of_rotations_from_rest_to_rest(rig, scene):
    rng, position = scene(0, 1)
    centres = ring(rig.plate.half, 8)
    solver = RotationSolver(rig, centres=centres, period=0.25, restarts=2)
    solution = solver.solve(position, rng.uniform(-0.1, 0.1, (1, 2)))
    cycle = solution.cycle
    assert cycle.starts_at_rest
    assert cycle.period == pytest.approx(0.25)
    assert solver.steering_period(7) == pytest.approx(0.25)
    # Where the plate turns steadily, it turns about one of the centres, but for the closing bump.
    t = (np.arange(2000) + 0.5) / 2000 * cycle.period
    twist, accel = cycle.twist(t), cycle.accel(t)
    steady = np.max(corner_accel(rig, cycle.pose(t), 0 * twist, accel), axis=1) < 3
    turning = steady & (np.abs(twist[:, 2]) > 0.2)
    assert np.sum(turning) > 200
    at = np.column_stack([-twist[turning, 1], twist[turning, 0]]) / twist[turning, 2:]
    off = np.min(np.hypot(*(at[:, None] - centres).transpose(2, 0, 1)), axis=1)
    assert np.median(off) < 0.03


def test_close_parts_that_go_apart_are_not_shaken_wildly(rig):
    position = np.array([[0.05, 0.02], [0.051, 0.02]])
    solver = RotationSolver(rig, restarts=0)
    apart = solver.solve(position, [[0.1, 0.0], [-0.1, 0.0]])
    assert not apart.success
    assert usage(rig, apart.cycle).worst <= 1
    far = solver.solve(position * [[1, 1], [-3, 1]], [[0.1, 0.0], [-0.1, 0.0]])
    assert apart.condition > 20 * far.condition


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 0.0}, "speed is 0.0, allowed: 0.001 to 10"),
        ({"most_gain": 0.5}, "most_gain is 0.5, allowed: 1 to "),
        ({"centres": np.zeros((2, 2))}, r"centres have shape \(2, 2\), allowed: \(N, 2\)"),
        ({"centres": np.zeros(6)}, r"centres have shape \(6,\), allowed: \(N, 2\)"),
        ({"centres": np.full((4, 2), np.nan)}, "centres have values that are not finite"),
    ],
)
def test_wrong_options_are_named(rig, options, message):
    with pytest.raises(PlateError, match=message):
        RotationSolver(rig, **options)
