"""Requests with slack, on refined maps, beyond reach and absurd: each answer is true."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plate_core import PlateError, load_rig
from plate_core.motion import usage
from plate_sim import simulate
from plate_solver import RotationSolver, SinusoidSolver, Status
from plate_solver.averages import step_forces
from plate_solver.averages.request import request_flags

METHODS = {"sinusoids": SinusoidSolver, "rotations": RotationSolver}
BOTH = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
RIG = load_rig()
FEW = {method: kind(RIG, restarts=1, iterations=15) for method, kind in METHODS.items()}
"""Solvers that stop after few attempts: their results must still be true."""

DIP = 1e-3
"""Dense samples may miss this much of a dip [mu m g]."""


def dense_force(cycle, position, velocity):
    """Average force from velocities of the surface sampled 65536 times."""
    t = (np.arange(65536) + 0.5) / 65536 * cycle.period
    return step_forces(position, velocity, cycle.twist(t), np.ones(len(t)))[:, :2]


def travel(cycle, position, velocity):
    """Displacement over one cycle in the simulator."""
    run = simulate(cycle, position, velocity, RIG.friction.mu, RIG.friction.gravity)
    return run.position[-1] - position


def check_truth(solution, position, force, velocity, tolerance, own):
    """Limits kept, no NaN, residual and status as an independent look has them."""
    assert usage(RIG, solution.cycle).worst <= 1
    start, end = solution.cycle.pose([0.0, solution.cycle.period])
    np.testing.assert_allclose(start, end, atol=1e-9)
    assert np.all(np.isfinite(solution.residual))
    assert 0 <= solution.fraction <= 1
    assert solution.message
    got = dense_force(solution.cycle, position, velocity)
    scale = max(1.0, np.max(np.abs(force)))
    np.testing.assert_allclose(force - got, solution.residual, atol=DIP * scale)
    met = np.all(np.abs(force - got) <= tolerance + own + DIP)
    assert solution.success == (solution.status is Status.SOLVED) == (solution.fraction == 1)
    if solution.success:
        assert met
    if solution.fraction > 0:
        missed = np.abs(solution.fraction * force - got)
        assert np.all(missed <= tolerance + own + DIP * scale)
    if np.max(np.hypot(*force.T)) > 1 + np.max(tolerance) * 1.5:
        assert solution.status is Status.UNREACHABLE


places = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.15, 0.15))
forces = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


@settings(max_examples=80, derandomize=True, deadline=None)
@given(
    method=st.sampled_from(list(METHODS)),
    parts=st.lists(st.tuples(places, forces), min_size=1, max_size=4),
    size=st.sampled_from([0.0, 0.02, 0.1, 0.5, 3.0]),
    slack=st.sampled_from([0.0, 0.0, 0.05, np.inf]),
    far=st.sampled_from([1.0, 1.0, 1.0, 40.0]),
)
def test_any_request_is_answered_with_the_truth(method, parts, size, slack, far):
    solver = FEW[method]
    solver.reset()
    position = far * np.array([place for place, _ in parts])
    force = size * np.array([push for _, push in parts])
    tolerance = np.zeros_like(force)
    tolerance[:, 1] = slack
    solution = solver.solve(position, force, tolerance=tolerance)
    check_truth(
        solution, position, force, np.zeros_like(force), tolerance, solver.options.tolerance
    )


@settings(max_examples=40, derandomize=True, deadline=None)
@given(
    method=st.sampled_from(list(METHODS)),
    parts=st.lists(st.tuples(places, forces, forces), min_size=1, max_size=3),
)
def test_any_request_for_moving_parts_is_answered_with_the_truth(method, parts):
    solver = FEW[method]
    solver.reset()
    position, force, velocity = (np.array(column) for column in zip(*parts, strict=True))
    force, velocity = 0.1 * force, 0.2 * velocity
    solution = solver.solve(position, force, velocity)
    check_truth(solution, position, force, velocity, 0.0, solver.options.tolerance)


@BOTH
def test_two_parts_approach_with_opposite_requests(method):
    solver = method(RIG, restarts=4)
    fractions = []
    for gap in np.geomspace(0.3, 0.005, 8):
        position = np.array([[0.05 - gap / 2, 0.02], [0.05 + gap / 2, 0.02]])
        force = np.array([[0.1, 0.0], [-0.1, 0.0]])
        solution = solver.solve(position, force)
        check_truth(solution, position, force, np.zeros((2, 2)), 0.0, solver.options.tolerance)
        fractions.append(solution.fraction)
    assert np.all(np.array(fractions[:4]) == 1)


@BOTH
def test_parts_in_one_place_pushed_apart_get_nothing(method):
    position = np.array([[0.05, 0.03], [0.05, 0.03]])
    solver = method(RIG, restarts=1)
    apart = solver.solve(position, [[0.1, 0.0], [-0.1, 0.0]])
    assert apart.status in (Status.FAILED, Status.UNREACHABLE)
    assert apart.fraction == 0
    assert np.all(apart.cycle.twist(np.linspace(0, apart.cycle.period, 50)) == 0)
    assert "plate rests" in apart.message
    assert solver.solve(position, [[0.1, 0.0], [0.1, 0.0]]).fraction > 0.9  # together: as one part


@BOTH
@pytest.mark.parametrize("refine", ["none", "velocity", "cycle"])
def test_no_request_is_a_plate_at_rest(method, refine):
    position = np.array([[0.05, 0.03], [0.05, 0.03], [9.0, 0.0]])
    force = np.array([[0.0, 0.0], [0.0, -0.05], [0.0, 0.0]])
    slack = np.array([[0.0, 0.0], [0.0, 0.05], [0.0, 0.0]])
    solution = method(RIG).solve(position, force, tolerance=slack, refine=refine)
    assert solution.success
    assert np.all(solution.cycle.pose(np.linspace(0, solution.cycle.period, 50)) == 0)


def test_fraction_is_the_largest_there_is(scene):
    # With N harmonics one part gets (N - 1)/(N + 1) at most.
    for number in (2, 3):
        maximum = (number - 1) / (number + 1)
        solution = SinusoidSolver(RIG, harmonics=number).solve([[0.1, 0.05]], [[0.8, 0.0]])
        assert not solution.success
        assert 0.9 * maximum <= 0.8 * solution.fraction <= maximum + 1e-3
        assert f"{solution.fraction:.3g} of the request" in solution.message
        np.testing.assert_allclose(
            solution.residual, [[0.8 * (1 - solution.fraction), 0]], atol=2e-4
        )


@BOTH
@pytest.mark.parametrize("size", [2.0, 1e6, 1e200])
def test_more_than_full_friction_is_known_to_be_too_much(method, size):
    position = np.array([[0.1, 0.05], [-0.1, 0.0]])
    solution = method(RIG, restarts=1).solve(position, [[size, 0.0], [0.0, 0.1 * size]])
    assert solution.status is Status.UNREACHABLE
    assert 0 < solution.fraction <= 1 / size
    assert "allowed: 1" in solution.message
    got = dense_force(solution.cycle, position, np.zeros((2, 2)))
    np.testing.assert_allclose(
        got, solution.fraction * np.array([[size, 0], [0, 0.1 * size]]), atol=2e-3
    )


@BOTH
def test_tolerance_makes_an_infeasible_request_feasible(method):
    # Close parts pushed apart: hard, unless it matters only along y, where both want the same.
    position = np.array([[0.05, 0.03], [0.056, 0.03]])
    force = np.array([[0.15, 0.1], [-0.15, 0.1]])
    solver = method(RIG, restarts=3)
    assert not solver.solve(position, force).success
    solver.reset()
    solution = solver.solve(position, force, tolerance=[[np.inf, 0.0], [0.2, 0.01]])
    assert solution.success
    got = dense_force(solution.cycle, position, np.zeros((2, 2)))
    own = solver.options.tolerance + DIP
    assert abs(got[0, 1] - 0.1) <= own
    assert abs(got[1, 1] - 0.1) <= 0.01 + own
    assert abs(got[1, 0] + 0.15) <= 0.2 + own


def test_the_order_of_numbers_in_memory_does_not_matter():
    position, force = np.array([[0.05, 0.03], [-0.1, 0.03]]), np.array([[0.05, 0.1], [-0.05, 0.1]])
    for slack in (None, np.array([[np.inf, 0.0], [0.2, 0.01]])):
        cycles = []
        for order in "CF":
            arrays = [
                None if array is None else np.array(array, order=order)
                for array in (position, force, np.zeros((2, 2)), slack)
            ]
            solver = SinusoidSolver(RIG, restarts=1)
            cycles.append(solver.solve(*arrays[:3], tolerance=arrays[3]).cycle)
        np.testing.assert_array_equal(cycles[0].coefficients, cycles[1].coefficients)


@BOTH
@pytest.mark.parametrize("count", [1, 2, 4])
def test_force_on_the_cycle_map_is_the_growth_of_the_drift(scene, method, count):
    solver = method(RIG)
    unit = RIG.friction.accel * solver.steering_period(count) ** 2
    missed, requested = 0.0, 0.0
    for seed in range(5):
        solver.reset()
        rng, position = scene(seed, count)
        force, velocity = rng.uniform(-0.03, 0.03, (2, count, 2))
        solution = solver.solve(position, force, 0.2 * velocity, refine="cycle")
        assert solution.fraction > 0.9
        assert solution.cycle.starts_at_rest
        drift = 0.2 * velocity * solution.cycle.period
        got = (travel(solution.cycle, position, 0.2 * velocity) - drift) / unit
        np.testing.assert_allclose(force - got, solution.residual, atol=0.1 * 0.03)
        missed += np.sum((force - got) ** 2)
        requested += np.sum(force**2)
    assert np.sqrt(missed / requested) < 0.1


@BOTH
def test_an_infeasible_request_on_the_cycle_map_has_the_stated_residual(scene, method):
    solver = method(RIG, restarts=1)
    unit = RIG.friction.accel * solver.steering_period(4) ** 2
    rng, position = scene(0, 4)
    force = rng.uniform(-0.2, 0.2, (4, 2))
    solution = solver.solve(position, force, refine="cycle")
    assert solution.status is Status.PARTIAL
    assert 0 < solution.fraction < 1
    got = travel(solution.cycle, position, np.zeros((4, 2))) / unit
    np.testing.assert_allclose(force - got, solution.residual, atol=0.01)
    sizes = np.linalg.norm(force - got), np.linalg.norm(force)
    assert sizes[0] <= (1 - 0.9 * solution.fraction) * sizes[1] + 0.01


def test_force_at_the_mean_velocity(scene):
    # The residual is by the velocities that the simulator shows, not those at the start.
    solver = SinusoidSolver(RIG)
    for seed in range(4):
        solver.reset()
        rng, position = scene(seed, 2)
        force = rng.uniform(-0.03, 0.03, (2, 2))
        solution = solver.solve(position, force, refine="velocity")
        assert solution.success
        mean = travel(solution.cycle, position, np.zeros((2, 2))) / solution.cycle.period
        got = dense_force(solution.cycle, position, mean)
        np.testing.assert_allclose(force - got, solution.residual, atol=3e-3)
        still = dense_force(solution.cycle, position, np.zeros((2, 2)))
        assert np.max(np.abs(force - still)) > 5 * np.max(np.abs(force - got))


@pytest.mark.parametrize(
    ("wrong_request", "message"),
    [
        ({"refine": "more"}, "refine is 'more', allowed: none, velocity, cycle"),
        ({"tolerance": [0.1, 0.1]}, r"tolerance has shape \(2,\), allowed: \(1, 2\)"),
        ({"tolerance": [[-0.1, 0.1]]}, "tolerance has values below 0 or NaN, allowed: 0 and above"),
        ({"tolerance": [[np.nan, 0.1]]}, "tolerance has values below 0 or NaN"),
        ({"position": [[2e3, 0.0]]}, "position has value 2000, allowed: -1000 to 1000"),
        ({"velocity": [[0.0, -2e3]]}, "velocity has value -2000, allowed: -1000 to 1000"),
    ],
)
def test_wrong_requests_are_named(wrong_request, message):
    with pytest.raises(PlateError, match=message):
        SinusoidSolver(RIG).solve(
            **({"position": [[0.1, 0.0]], "force": [[0.1, 0.0]]} | wrong_request)
        )


def test_flags_of_a_request():
    rng = np.random.default_rng(0)
    for _ in range(50):
        position, velocity, force = rng.normal(size=(3, 4, 2))
        tolerance = np.abs(rng.normal(size=(4, 2))) * rng.integers(0, 3)
        curl = np.full(4, np.nan)
        velocity *= rng.integers(0, 2)
        sound, moving, curled, slack, within, loaded = request_flags(
            position, force, velocity, curl, tolerance
        )
        left = np.maximum(np.abs(force) - tolerance, 0)
        assert sound
        assert not curled
        assert moving == bool(np.any(velocity))
        assert slack == bool(np.any(tolerance))
        assert within == bool(np.all(np.abs(force) <= tolerance))
        assert loaded == pytest.approx(np.max(np.hypot(*left.T)))
        curl[2] = 1.0
        assert request_flags(position, force, velocity, curl, tolerance)[2]
        for broken in (np.nan, np.inf, 1e4):
            spoilt = position.copy()
            spoilt[1, 0] = broken
            assert not request_flags(spoilt, force, velocity, curl, tolerance)[0]
