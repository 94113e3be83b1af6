"""Steering by the true cycle map, judged by the simulator: another implementation."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError
from plate_core.motion import is_rest, usage
from plate_sim import simulate
from plate_solver import Goal, RotationSolver, SinusoidSolver
from plate_solver._kernels import TRACE, adjoint, trace
from plate_solver.cycle_map import (
    LANES,
    blocks_of,
    end_state,
    end_state_gradient,
    finely_sampled,
)
from plate_solver.goal import PartRotations
from plate_solver.limits import Limits
from plate_solver.sinusoids import family_on_grid
from plate_solver.sinusoids.basis import TAIL_S
from plate_solver.sinusoids.descent import Motions, Problem, descend
from plate_solver.sinusoids.solver import ROUGH, SPREAD

BOTH = pytest.mark.parametrize("method", [SinusoidSolver, RotationSolver])
DRIFT = 0.01  # m/s, the maximum request
STOP = 2e-4  # m/s, where the search stops


def moved(rig, solution, goal):
    """Displacement (M, 2) [m] in the simulator."""
    friction = rig.friction
    run = simulate(solution.cycle, goal.position, goal.velocity, friction.mu, friction.gravity)
    return run.position[-1] - goal.position


def random_goal(rig, scene, seed, count, period, tolerance=0.0):
    rng, position = scene(seed, count)
    return Goal(
        position,
        rng.normal(size=(count, 2)) * 0.005,
        rng.uniform(-DRIFT, DRIFT, (count, 2)) * period,
        np.full((count, 2), tolerance * period),
        rig.friction.accel,
    )


def rms(array):
    return np.sqrt(np.mean(array**2))


@BOTH
@pytest.mark.parametrize(("count", "turning"), [(2, 0), (2, 1), (4, 0), (4, 1), (7, 4), (8, 8)])
@pytest.mark.parametrize("multi_cycle", [False, True])
def test_the_announced_period_is_that_of_the_answer(
    rig, scene, method, count, turning, multi_cycle
):
    solver, none = method(rig), np.zeros(count)
    period = solver.steering_period(count, turning, multi_cycle)
    weight = np.where(np.arange(count) < turning, 0.01, 0.0)
    rotations = (
        PartRotations(none, np.full((count, 3), 1e-5), none, none, weight) if turning else None
    )
    goal = replace(
        random_goal(rig, scene, 0, count, period), part_rotations=rotations, multi_cycle=multi_cycle
    )
    assert solver.steer(goal, 1.0, 1.0).cycle.period == period


def test_a_motion_that_ends_with_the_requested_mean_velocity_meets_the_goal_ahead_too(rig, scene):
    period, coast, count = 0.2, 0.03, 3
    rotation = np.array([0.1, -0.2, 0.3])
    rotations = PartRotations(
        np.zeros(count), np.full((count, 3), 1e-5), rotation, rotation, np.ones(count)
    )
    goal = replace(random_goal(rig, scene, 0, count, period, 0.0005), part_rotations=rotations)
    ahead = goal.ahead(coast, period)
    end = np.concatenate([(goal.position + goal.displacement).T.ravel(), rotation])
    moved = np.concatenate([goal.displacement.T.ravel(), rotation])
    np.testing.assert_allclose(ahead.error(end + coast * moved / period)[0], 0, atol=1e-15)
    # A part that ends at rest misses it by the distance that it would have moved on.
    slack = (1 + coast / period) * goal.tolerance.T.ravel()
    short = np.append(np.maximum(np.abs(moved[:-3]) * coast / period - slack, 0), 0.15 * rotation)
    np.testing.assert_allclose(np.abs(ahead.error(end)[0]), np.abs(short), atol=1e-12)
    assert ahead.coast == coast


# Missed share of the wanted displacement, median over seeds. Measured 0.05, 0.05, 0.07 and
# 0.04, 0.11, 0.17; the search itself may stop at 0.15.
@pytest.mark.parametrize(
    ("method", "count", "seeds", "min_success", "missed"),
    [
        (SinusoidSolver, 1, 12, 0.9, 0.12),
        (SinusoidSolver, 2, 12, 0.9, 0.12),
        (SinusoidSolver, 4, 12, 0.8, 0.15),
        (RotationSolver, 1, 8, 0.8, 0.15),
        (RotationSolver, 2, 8, 0.7, 0.25),
        (RotationSolver, 4, 6, 0.3, 0.40),
    ],
)
def test_simulated_parts_reach_the_requested_places(
    rig, scene, method, count, seeds, min_success, missed
):
    solver = method(rig)
    period = solver.steering_period(count)
    unit = rig.friction.accel * period**2
    successes, misses = [], []
    for seed in range(seeds):
        solver.reset()
        goal = random_goal(rig, scene, seed, count, period)
        good = 0.15 * rms(goal.displacement)
        solution = solver.steer(goal, STOP * period, good)
        assert solution.cycle.period == pytest.approx(period)
        assert solution.cycle.starts_at_rest
        assert usage(rig, solution.cycle).worst <= 1
        got = moved(rig, solution, goal)
        # The prediction is true: some 0.1 mm are the error of steps of about 1 ms.
        predicted = goal.displacement - solution.residual * unit
        np.testing.assert_allclose(got, predicted, atol=0.15 * DRIFT * period)
        assert solution.success == (rms(solution.residual) * unit <= good)
        successes.append(solution.success)
        misses.append(rms(got - goal.displacement) / rms(goal.displacement))
    assert np.mean(successes) >= min_success
    assert np.median(misses) < missed


@BOTH
def test_velocity_at_the_start_counts(rig, scene, method):
    # Two parts that swing at 30 mm/s must stay in place.
    solver = method(rig)
    period = solver.steering_period(2)
    for seed in range(3):
        solver.reset()
        rng, position = scene(seed, 2)
        velocity = 0.03 * rng.normal(size=(2, 2))
        nothing = np.zeros((2, 2))
        goal = Goal(position, velocity, nothing, nothing, rig.friction.accel)
        solution = solver.steer(goal, STOP * period, STOP * period)
        np.testing.assert_allclose(moved(rig, solution, goal), 0, atol=0.002 * period)


@BOTH
def test_tolerance_is_kept_and_spares_work(rig, scene, method):
    solver = method(rig)
    period = solver.steering_period(4)
    steps = {0.0: 0, 0.006: 0}
    used = []
    for seed in range(6):
        for tolerance in steps:
            solver.reset()
            goal = random_goal(rig, scene, seed, 4, period, tolerance)
            solution = solver.steer(goal, STOP * period, 0.001 * period)
            steps[tolerance] += solution.iterations
            if tolerance and solution.success:
                miss = np.abs(moved(rig, solution, goal) - goal.displacement)
                assert np.all(miss < goal.tolerance + 0.004 * period)
                used.append(np.max(miss) / period)
    assert len(used) >= 4
    assert np.median(used) > 0.002, "the freedom was not used"
    assert steps[0.006] < 0.7 * steps[0.0]  # measured 0.07


def test_errors_are_what_is_beyond_intervals_edges_and_distances():
    start, still = np.array([[0.1, 0.2], [0.1, 0.15]]), np.zeros((2, 2))
    tolerance = np.array([[1e-3, 0.0], [np.inf, np.inf]])
    goal = Goal(start, still, np.array([[5e-3, 0.0], [0.0, 0.0]]), tolerance, 2.45,
                weight=0.5, edge=np.array([0.3, 0.21]), clear=0.03)  # fmt: skip

    def errors(way_x, way_y):
        position = start + [[way_x, way_y], [0.0, 0.0]]
        error, slope = goal.error(position.T.ravel())
        for k, step in enumerate(1e-7 * np.eye(4)):
            there = goal.error(position.T.ravel() + step)[0]
            np.testing.assert_allclose(-(there - error) / 1e-7, slope[:, k], atol=1e-4)
        return error

    np.testing.assert_allclose(errors(4.5e-3, 2e-4), [0, 0, -1e-4, 0], atol=1e-15)
    np.testing.assert_allclose(errors(3e-3, 2e-3), [0.5e-3, 0, -1e-3, 0], atol=1e-15)
    np.testing.assert_allclose(errors(9e-3, -2e-3), [-1.5e-3, 0, 1e-3, 0], atol=1e-15)
    # Beyond the edge: half as much again at half of STEEP_M.
    np.testing.assert_allclose(errors(5e-3, 15e-3)[2], -0.5 * 15e-3 - 1.5 * 5e-3)
    gap = np.hypot(5e-3, 0.025)
    np.testing.assert_allclose(errors(5e-3, -0.025)[4], 0.03 - gap)  # too near


@pytest.mark.parametrize(("weight", "bound"), [(0.0, 0.1), (0.5, 0.12)])
def test_a_part_stays_beyond_the_edge_only_on_request(weight, bound):
    start, none = np.array([[0.12, -0.12]]), np.zeros((1, 2))
    goal = Goal(start, none, none, none, 2.45, weight=weight, edge=np.array([0.1, 0.1]))
    np.testing.assert_allclose(goal.ends.edge_high, [bound, 0.1])  # not on the far side
    np.testing.assert_allclose(goal.ends.edge_low, [-0.1, -bound])
    error, _ = goal.error(start.T.ravel())
    assert np.any(error != 0) == (weight == 0)


@pytest.mark.parametrize("wrong", [np.nan, -0.5, np.inf])
def test_meaningless_weights_are_refused(wrong):
    none, angles = np.zeros((2, 2)), np.zeros(2)
    with pytest.raises(PlateError, match=rf"^weight has {wrong:g}, allowed: finite, 0 and above$"):
        Goal(none, none, none, none, 2.45, weight=np.array([[1.0, 1.0], [1.0, wrong]]))
    weight = np.array([0.01, wrong])
    rotations = PartRotations(angles, np.zeros((2, 3)), angles, angles, weight)
    with pytest.raises(PlateError, match=f"^weight of rotations has {wrong:g}, "):
        Goal(none, none, none, none, 2.45, part_rotations=rotations)


@pytest.mark.parametrize("count", [1, LANES, LANES + 1])
def test_blocks_do_as_the_cycle_map_and_so_do_their_derivatives(rig, scene, through_twist, count):
    rng, position = scene(3, count)
    velocity = 0.02 * rng.normal(size=(count, 2))
    friction = rng.uniform(2, 3, count)
    n, dt, coast = 40, 1e-3, 0.03
    t = np.arange(n) * dt
    twist = np.sin(90 * t[:, None] + [0, 1, 2]) * [0.2, 0.1, 1.0]
    pose = np.cumsum(twist, axis=0) * dt
    state = blocks_of(position, velocity, friction, dt)
    steps = np.empty((n, len(state), TRACE), np.float32)
    trace(state, pose, twist, dt, steps)
    place, left = end_state(position, velocity, pose, twist, np.full(n, dt), friction)

    def rows(of, first, size):  # (..., b, rows * LANES) to (..., row, M)
        own = of[..., first * LANES : (first + size) * LANES]
        own = own.reshape(*of.shape[:-1], size, LANES)
        return np.moveaxis(own, -3, -2).reshape(*of.shape[:-2], size, -1)[..., :count]

    np.testing.assert_allclose(rows(state, 0, 2).T, place, atol=1e-7)
    np.testing.assert_allclose(rows(state, 2, 2).T, left, atol=1e-6)
    by_twist = np.empty((10, len(state), 2, 3 * LANES), np.float32)
    adjoint(steps, twist, dt, coast, by_twist)
    on_pose, on_twist, _ = end_state_gradient(
        position, velocity, pose, twist, np.full(n, dt), friction, coast
    )
    right = through_twist(on_pose, on_twist, dt)
    bins = right.reshape(3, 10, 4, 2, count).sum(axis=2)  # c, bin, axis, part
    mine = rows(np.moveaxis(by_twist, 1, 2), 0, 3).transpose(2, 0, 1, 3)
    np.testing.assert_allclose(mine, bins, atol=1e-4 * np.abs(bins).max())


PLATE = np.array([[1e-3, -5e-4, 0.01], [0.05, 0.1, -0.5], [5.0, -3.0, 20.0]])
"""A state of the plate that is well within the limits."""


@pytest.mark.parametrize("plate", [None, PLATE])
def test_a_descents_slopes_agree_with_differences(rig, scene, plate):
    rng, position = scene(4, 3)
    goal = Goal(
        position, 0.02 * rng.normal(size=(3, 2)), 0.004 * rng.normal(size=(3, 2)),
        np.zeros((3, 2)), rig.friction.accel, edge=np.full(2, 0.05), clear=0.2, coast=0.03,
        plate=plate,
    )  # fmt: skip
    free_end = plate is not None
    family = family_on_grid(4, 0.1, Limits.of(rig), free_end=free_end, plate=plate)
    problem = Problem.of(goal, Motions.of(family.basis, Limits.of(rig)), 1.3)
    theta = (1.2 if free_end else 0.99) * family.random(rng)
    found = descend(problem, theta, 0.0, 0)
    assert len(found.error) > 6 + 3  # places, pairs, and limits that are exceeded
    for k in rng.choice(len(theta), 8, replace=False):
        step = np.zeros(len(theta))
        step[k] = 2e-4  # places have single precision
        above, below = (descend(problem, theta + s, 0.0, 0).error for s in (step, -step))
        slope = (above - below) / 4e-4
        size = np.max(np.abs(found.jacobian))
        # Bins of four steps stand for their mean: measured 6 % of the greatest at most.
        np.testing.assert_allclose(-slope, found.jacobian[:, k], atol=0.1 * size)


def test_four_steps_from_near_a_solution_gain_most_of_what_it_gains(rig, scene):
    """Steps that are damped too little at first are refused, each at the price of an evaluation."""
    limits, fractions = Limits.of(rig), []
    for seed in range(10):
        rng, position = scene(seed, 10)
        way = np.where(position[:, :1] > 0, -0.1, 0.1) * [1.0, 0.0]
        goal = Goal(
            position, 0 * position, way, np.full((10, 2), 0.01), rig.friction.accel,
            multi_cycle=True, weight=0.03, edge=rig.plate.half - 0.008, coast=0.03, free_end=True,
        )  # fmt: skip
        family = family_on_grid(8, 0.1, limits, ROUGH, True)
        problem = Problem.of(goal, Motions.of(family.basis, limits), 1.3)
        known = descend(problem, 0.5 * family.random(rng), 0.0, 60)
        size = SPREAD * np.sqrt(np.mean(known.parameters**2))
        start = known.parameters + size * rng.normal(size=known.parameters.size)
        rest = descend(problem, 0 * start, 0.0, 0).cost
        gain = rest - descend(problem, start, 0.0, 4).cost
        fractions.append(gain / (rest - known.cost))
    assert min(fractions) > 0.8  # 0.92; with `first` at 1e-2: -3 to 2.5


def test_a_cycle_continues_from_the_plate_state_and_parts_move_as_predicted(rig, scene):
    solver = SinusoidSolver(rig, restarts=3)
    rng, position = scene(2, 4)
    velocity, before = 0.02 * rng.normal(size=(4, 2)), PlateCycle.rest(0.1)
    aim = rng.uniform(-0.1, 0.1, (4, 2))
    for k in range(6):
        last = k == 5
        goal = Goal(
            position, velocity, 2e-3 * np.sign(aim - position) if last else aim - position,
            np.zeros((4, 2)), rig.friction.accel, multi_cycle=not last, coast=0.0 if last else 0.03,
            plate=before.state(-1), free_end=not last,
        )  # fmt: skip
        cycle = solver.steer(goal, 1e-5, 1e-4).cycle
        assert cycle.follows(before)
        assert cycle.tail is not None
        assert is_rest(cycle.state(-1)) == last  # an exact drift ends at rest
        assert is_rest(cycle.parts[-1].state(-1))
        assert usage(rig, cycle).worst <= 1
        run = simulate(cycle, position, velocity, rig.friction.mu, rig.friction.gravity)
        end = goal.end(*finely_sampled(cycle)).reshape(2, -1).T - goal.coast * run.velocity[-1]
        np.testing.assert_allclose(run.position[-1], end, atol=3e-5)
        position, velocity, before = run.position[-1], run.velocity[-1], cycle
    assert np.any(goal.plate[1] != 0)


def test_no_parameters_are_the_tail_and_nearest_ones_repeat_a_motion(rig):
    limits, rng = Limits.of(rig), np.random.default_rng(0)
    family = family_on_grid(8, 0.1, limits, free_end=True, plate=PLATE)
    nothing = family.cycle(np.zeros(3 * family.basis.size))
    t = np.linspace(0, TAIL_S, 30)
    np.testing.assert_allclose(
        nothing.pose(t), PlateCycle.stopping(PLATE, TAIL_S).pose(t), atol=1e-12
    )
    assert is_rest(nothing.state(-1))
    theta = family.random(rng)
    np.testing.assert_allclose(family.nearest(family.samples(theta)[1]), theta, rtol=1e-6)
    cycle = family.cycle(theta)
    np.testing.assert_array_equal(cycle.state(0), PLATE)
    np.testing.assert_allclose(cycle.tail.state(0), cycle.state(-1))
    pose, twist, dt = family.samples(theta)
    middle = np.cumsum(dt) - dt / 2
    np.testing.assert_allclose(cycle.pose(middle), pose, atol=1e-6)
    np.testing.assert_allclose(cycle.twist(middle), twist, atol=2e-3)


@BOTH
def test_parts_come_to_their_targets_by_many_cycles(rig, method):
    """Rounding decides which way is found, so machines differ: 18 to 40 cycles by Method B from
    starts that are micrometres apart."""
    low = np.array([[0.1, -0.15], [-0.3, -0.15], [-0.02, 0.04]])
    high = np.array([[0.3, 0.15], [-0.1, 0.15], [0.02, 0.06]])
    counts = []
    for apart_m in (0.0, 1e-6, 2e-6):
        solver, cycles = method(rig), 0
        position = np.array([[-0.1, 0.03], [0.1, -0.03], [0.0, 0.05]]) + apart_m
        velocity = np.zeros((3, 2))
        while np.any(way := np.maximum(np.maximum(low - position, position - high), 0)):
            cycles += 1
            assert cycles < 80
            goal = Goal(
                position, velocity, (low + high) / 2 - position, (high - low) / 2,
                rig.friction.accel, multi_cycle=True, weight=0.012 / max(way.max(), 0.01),
                edge=rig.plate.half - 0.024, clear=0.02, coast=0.03,
            )  # fmt: skip
            found = solver.steer(goal, 1e-5, 0.0)
            assert found.success
            run = simulate(found.cycle, position, velocity, rig.friction.mu, rig.friction.gravity)
            position, velocity = run.position[-1], run.velocity[-1]
            assert np.all(np.abs(position) < rig.plate.half)
            apart = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
            assert np.min(apart + np.eye(3)) > 0.016, "rims meet; 0.020 was asked for"
        counts.append(cycles)
        if np.count_nonzero(np.array(counts) < 40) == 2:
            break  # whatever the third one takes
    assert np.sort(counts)[1] < 40, f"median measured: 33 by Method B, 27 by A; now {counts}"


def test_downhill_is_towards_the_target_that_is_missed_most(rig):
    start, still = np.array([[0.1, 0.0], [-0.1, 0.0]]), np.zeros((2, 2))
    far = np.array([[0.0, 0.1], [0.02, 0.0]])
    goal = Goal(start, still, far, still, rig.friction.accel, multi_cycle=True)
    np.testing.assert_allclose(goal.downhill(0.01), [[0, 0.01], [0.002, 0]], atol=1e-12)


@BOTH
def test_last_solution_is_a_good_start(rig, scene, method):
    warm, cold = method(rig), method(rig)
    period = warm.steering_period(2)
    steps = {"warm": 0, "cold": 0}
    for seed in range(4):
        warm.reset()
        first = random_goal(rig, scene, seed, 2, period)
        for k in range(5):
            goal = Goal(
                first.position + 0.001 * k, first.velocity, first.displacement * (1 - 0.03 * k),
                first.tolerance, first.friction_accel,
            )  # fmt: skip
            cold.reset()
            for name, solver in (("warm", warm), ("cold", cold)):
                steps[name] += solver.steer(goal, STOP * period, 4 * STOP * period).iterations
    assert steps["warm"] < 0.75 * steps["cold"]  # measured 0.20 and 0.33


@BOTH
def test_same_seed_same_answer(rig, scene, method):
    def knots(solver):
        period = solver.steering_period(3)
        goal = random_goal(rig, scene, 1, 3, period)
        return solver.steer(goal, STOP * period, STOP * period).cycle.knot_pose

    solver = method(rig, seed=3, restarts=3)
    first = knots(solver)
    np.testing.assert_array_equal(knots(method(rig, seed=3, restarts=3)), first)
    solver.reset()
    np.testing.assert_array_equal(knots(solver), first)


@BOTH
def test_infeasible_requests_are_reported(rig, method):
    # A part at rest cannot go further than mu g T^2 / 2 in a cycle.
    solver = method(rig, restarts=1, iterations=20)
    period = solver.steering_period(1)
    unit = rig.friction.accel * period**2
    goal = Goal(
        np.array([[0.1, 0.05]]), np.zeros((1, 2)), np.array([[0.6 * unit, 0.0]]),
        np.zeros((1, 2)), rig.friction.accel,
    )  # fmt: skip
    solution = solver.steer(goal, STOP * period, 0.1 * unit)
    assert not solution.success
    assert "mm" in solution.message
    assert solution.cycle.starts_at_rest
    assert usage(rig, solution.cycle).worst <= 1
    got = moved(rig, solution, goal)[0] / unit
    assert 0.02 < got[0] < 0.5  # as far that way as it can


def test_a_low_acceleration_limit_lengthens_the_cycles(rig):
    weak = replace(rig, limits=replace(rig.limits, accel=5 * rig.friction.accel))
    for one, period in ((rig, 0.1), (weak, 0.2)):
        solver = SinusoidSolver(one)
        assert solver.steering_period(4, multi_cycle=True, free_end=True) == period
