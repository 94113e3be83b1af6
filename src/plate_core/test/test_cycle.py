"""PlateCycle against polynomials, sinusoids and finite differences."""

import numpy as np
import pytest
from scipy.interpolate import PPoly, make_interp_spline

from plate_core import CycleError, PlateCycle
from plate_core.motion import evaluate_pieces

PERIOD = 0.2


def random_cycle(seed: int, knots: int = 12) -> PlateCycle:
    """Cycle with unequal intervals and random states of natural size."""
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0], np.cumsum(rng.uniform(0.5, 1.5, knots))])
    times *= PERIOD / times[-1]
    states = [rng.normal(size=(knots + 1, 3)) * size for size in (0.003, 0.3, 30)]
    for state in states:
        state[-1] = state[0]
    return PlateCycle.from_knots(times, *states)


def sinusoids(t: np.ndarray, harmonics: int = 2) -> list[np.ndarray]:
    """Pose of sines up to `harmonics`, twist and acceleration, each (n, 3), at times t (n,)."""
    rng = np.random.default_rng(7)
    result = [np.zeros((len(t), 3)) for _ in range(3)]
    for h in range(1, harmonics + 1):
        rate = 2 * np.pi * h / PERIOD
        for column in range(3):
            phase, size = rng.uniform(0, 2 * np.pi), 0.003 / h**2
            result[0][:, column] += size * np.sin(rate * t + phase)
            result[1][:, column] += size * rate * np.cos(rate * t + phase)
            result[2][:, column] -= size * rate**2 * np.sin(rate * t + phase)
    return result


def test_the_motion_passes_through_its_knots():
    cycle = random_cycle(0)
    np.testing.assert_allclose(cycle.pose(cycle.times), cycle.knot_pose, atol=1e-13)
    np.testing.assert_allclose(cycle.twist(cycle.times), cycle.knot_twist, atol=1e-11)
    np.testing.assert_allclose(cycle.accel(cycle.times), cycle.knot_accel, atol=1e-8)


def test_a_periodic_cycle_ends_in_its_initial_state():
    cycle = random_cycle(1)
    for function in (cycle.pose, cycle.twist, cycle.accel):
        start, end = function(np.array([0, cycle.period]))
        np.testing.assert_allclose(start, end, rtol=1e-9, atol=1e-9)


def test_continuous_to_the_acceleration():
    cycle = random_cycle(2)
    inner = cycle.times[1:-1]
    for function, scale in ((cycle.pose, 0.003), (cycle.twist, 0.3), (cycle.accel, 30)):
        jump = function(inner + 1e-12) - function(inner - 1e-12)
        assert np.max(np.abs(jump)) < 1e-6 * scale


def test_quintic_is_reproduced_exactly():
    # x = t^3 (T - t)^2 and the like are zero with slope zero at the end, so they close.
    power = np.polynomial.Polynomial
    t, rest = power([0, 1]), power([PERIOD, -1])
    columns = [t**2 * rest**2, t**3 * rest**2, t**2 * rest**3]
    # A cycle must also close in acceleration: take the curvature at the ends from the sum.
    columns = [c * scale for c, scale in zip(columns, (50, 1e3, 1e3), strict=True)]
    times = np.array([0, 0.03, 0.11, 0.15, PERIOD])
    states = [np.column_stack([c.deriv(k)(times) for c in columns]) for k in range(3)]
    states[2][[0, -1]] = states[2][0]
    cycle = PlateCycle.from_knots(times, *states)
    inside = np.linspace(0, 0.15, 200)  # the last interval bends to close
    for k, function in enumerate((cycle.pose, cycle.twist, cycle.accel)):
        exact = np.column_stack([c.deriv(k)(inside) for c in columns])
        np.testing.assert_allclose(function(inside), exact, rtol=1e-9, atol=1e-12 * 100**k)


def test_derivatives_agree_with_finite_differences():
    cycle = random_cycle(3)
    step = 1e-7
    t = np.random.default_rng(0).uniform(step, PERIOD - step, 300)
    for function, derivative in ((cycle.pose, cycle.twist), (cycle.twist, cycle.accel)):
        difference = (function(t + step) - function(t - step)) / (2 * step)
        scale = np.max(np.abs(derivative(t)))
        np.testing.assert_allclose(difference, derivative(t), atol=1e-4 * scale)


@pytest.mark.parametrize("given", ["pose", "pose and twist", "all"])
def test_samples_of_sinusoids_converge(given):
    fine = np.linspace(0, PERIOD, 1000)
    exact = sinusoids(fine)
    errors = []
    for count in (16, 32):
        pose, twist, accel = sinusoids(np.arange(count) * PERIOD / count)
        if given == "pose":
            cycle = PlateCycle.from_samples(PERIOD, pose)
        elif given == "pose and twist":
            cycle = PlateCycle.from_samples(PERIOD, pose, twist)
        else:
            cycle = PlateCycle.from_samples(PERIOD, pose, twist, accel)
        errors.append(np.max(np.abs(cycle.pose(fine) - exact[0])))
    order = np.log2(errors[0] / errors[1])
    assert order > 5.5, f"{errors}: a quintic converges with order 6"
    assert errors[1] < 1e-6 * 0.003 * 10


def test_derivatives_of_samples_converge():
    fine = np.linspace(0, PERIOD, 1000)
    _, twist, accel = sinusoids(fine)
    errors = []
    for count in (16, 32):
        cycle = PlateCycle.from_samples(PERIOD, sinusoids(np.arange(count) * PERIOD / count)[0])
        errors.append(
            (
                np.max(np.abs(cycle.twist(fine) - twist)),
                np.max(np.abs(cycle.accel(fine) - accel)),
            )
        )
    orders = np.log2(np.array(errors[0]) / np.array(errors[1]))
    assert orders[0] > 4.5  # of 5
    assert orders[1] > 3.5  # of 4


@pytest.mark.parametrize("count", [6, 7, 48])
def test_samples_give_the_periodic_spline(count):
    pose = np.random.default_rng(count).normal(size=(count, 3))
    cycle = PlateCycle.from_samples(PERIOD, pose)
    knots = np.linspace(0, PERIOD, count + 1)
    spline = make_interp_spline(knots, np.vstack([pose, pose[:1]]), k=5, bc_type="periodic")
    t = np.linspace(0, PERIOD, 333)
    np.testing.assert_allclose(cycle.pose(t), spline(t), atol=1e-11)


def test_control_points_enclose_the_motion():
    cycle = random_cycle(4)
    t = np.linspace(0, PERIOD, 5000)
    for order, function in enumerate((cycle.pose, cycle.twist, cycle.accel)):
        exact = function(t)
        size = np.max(np.abs(exact))
        overshoot = []
        for pieces in (4, 8, 16):
            points = cycle.control_points(order, pieces)
            assert points.shape == (12 * pieces * 5, 3)
            assert np.all(points.max(axis=0) >= exact.max(axis=0) - 1e-9 * size)
            assert np.all(points.min(axis=0) <= exact.min(axis=0) + 1e-9 * size)
            overshoot.append(np.max(points.max(axis=0) - exact.max(axis=0)))
        assert overshoot[2] < overshoot[0] / 4 + 1e-6 * size


def test_rest_and_scaled():
    rest = PlateCycle.rest(0.05)
    assert rest.starts_at_rest
    assert rest.period == 0.05
    assert not np.any(rest.pose(np.linspace(0, 0.05, 20)))
    cycle = random_cycle(5)
    assert not cycle.starts_at_rest
    t = np.linspace(0, PERIOD, 50)
    np.testing.assert_allclose(cycle.scaled(-0.3).accel(t), -0.3 * cycle.accel(t), atol=1e-9)


def test_time_may_be_a_number():
    cycle = random_cycle(6)
    np.testing.assert_array_equal(cycle.pose(0.1), cycle.pose(np.array([0.1])))


@pytest.mark.parametrize("t", [-0.01, PERIOD + 0.01, float("nan")])
def test_time_outside_is_refused(t):
    with pytest.raises(CycleError, match=r"time is .* s, allowed: 0 to 0\.2 s"):
        random_cycle(0).pose(t)


def broken(field: int, index: tuple[int, ...], value: float) -> list[np.ndarray]:
    cycle = random_cycle(8)
    arguments = [
        np.array(a) for a in (cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    ]
    arguments[field][index] = value
    return arguments


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (broken(0, (0,), 0.001), "knot times must be finite"),
        (broken(0, (3,), 0.0), "knot times must be finite"),
        (broken(0, (3,), float("inf")), "knot times must be finite"),
        (broken(1, (2, 1), float("nan")), "pose has values that are not finite"),
        (broken(2, (2, 1), float("inf")), "twist has values that are not finite"),
        (broken(3, (2, 1), float("nan")), "accel has values that are not finite"),
        (broken(1, (-1, 0), 0.1), "motion is not closed: .* in pose"),
        (broken(2, (-1, 0), 9.0), "motion is not closed"),
        (broken(3, (-1, 2), 1e3), "motion is not closed"),
        (([0.0], [[0] * 3], [[0] * 3], [[0] * 3]), "cycle has 1 knots, allowed: at least 2"),
        (([0.0, 1.0], [[0] * 3] * 2, [[0] * 3], [[0] * 3] * 2), r"shape \(1, 3\), allowed: \(2"),
    ],
)
def test_wrong_knots_are_refused(arguments, message):
    with pytest.raises(CycleError, match=message):
        PlateCycle.from_knots(*arguments)


@pytest.mark.parametrize(
    ("period", "pose", "message"),
    [
        (0.0, np.zeros((8, 3)), "period is 0.0 s, allowed: a positive number"),
        (float("nan"), np.zeros((8, 3)), "period is nan s"),
        (0.1, np.zeros((8, 2)), r"pose has shape \(8, 2\), allowed: \(n, 3\)"),
        (0.1, np.zeros((0, 3)), r"pose has shape \(0, 3\)"),
        (0.1, np.full((8, 3), np.nan), "pose has values that are not finite"),
    ],
)
def test_wrong_samples_are_refused(period, pose, message):
    with pytest.raises(CycleError, match=message):
        PlateCycle.from_samples(period, pose)


@pytest.mark.parametrize("arguments", [broken(1, (3, 0), 1e305), broken(0, (1,), 1e-200)])
def test_knots_beyond_computing_are_refused(arguments):
    with pytest.raises(CycleError, match="the knots have too large values or too short intervals"):
        PlateCycle.from_knots(*arguments)


def test_knots_cannot_be_changed():
    cycle = random_cycle(9)
    for array in (*cycle.knots, cycle.coefficients):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 1.0


def test_the_tail_begins_at_the_repeated_knot():
    times = np.array([0.0, 0.05, 0.1, 0.1, 0.15])
    rng = np.random.default_rng(5)
    states = [rng.normal(size=(5, 3)) * size for size in (0.003, 0.3, 30)]
    for state in states:
        state[3], state[4] = state[2], 0.0
    cycle = PlateCycle.from_knots(times, *states)
    assert cycle.tail is not None
    assert cycle.period == pytest.approx(0.1)
    assert not cycle.starts_at_rest
    assert not cycle.closes
    assert cycle.tail.follows(cycle)
    assert PlateCycle.rest(0.1).follows(cycle.tail)
    assert not PlateCycle.rest(0.1).follows(cycle)
    for mine, given in zip(cycle.knots, (times, *states), strict=True):
        np.testing.assert_array_equal(mine, given)
    again = PlateCycle.from_knots(*cycle.knots)
    np.testing.assert_array_equal(again.coefficients, cycle.coefficients)
    stopping = PlateCycle.stopping(cycle.state(-1), 0.05)
    np.testing.assert_allclose(stopping.pose(0.0)[0], states[0][2])
    assert np.all(stopping.state(-1) == 0)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0, 0.05, 0.1, 0.1, 0.1, 0.15], "knot times must"),
        ([0, 0, 0.05, 0.1], "knot times must"),
        ([0, 0.05, 0.1, 0.1], "knot times must"),
    ],
)
def test_only_one_knot_inside_may_be_given_twice(times, message):
    still = np.zeros((len(times), 3))
    with pytest.raises(CycleError, match=message):
        PlateCycle.from_knots(np.array(times), still, still, still)


def test_a_tail_ends_at_rest_and_begins_where_the_cycle_ends():
    times = np.array([0.0, 0.1, 0.1, 0.15])
    pose = np.array([[0, 0, 0], [1e-3, 0, 0], [1e-3, 0, 0], [1e-4, 0, 0]])
    still = np.zeros((4, 3))
    with pytest.raises(CycleError, match="not closed"):
        PlateCycle.from_knots(times, pose, still, still)
    pose[2:] = [[2e-3, 0, 0], [0, 0, 0]]
    with pytest.raises(CycleError, match="differ"):
        PlateCycle.from_knots(times, pose, still, still)


def test_a_tail_ends_at_rest_alone():
    times, state = np.array([0.0, 0.1, 0.1, 0.15]), np.array([1e-3, 0.0, 0.0])
    still = np.zeros((4, 3))
    with pytest.raises(CycleError, match="its tail does not end at rest"):
        PlateCycle.from_knots(times, np.array([0 * state, state, state, state]), still, still)
    almost = np.array([[2.8e-6] * 3, [1e-4] * 3, [1e-3] * 3])
    assert np.all(PlateCycle.stopping(almost, 0.05, 0.1).state(-1) == 0)


@pytest.mark.parametrize("order", range(3))
def test_pieces_have_the_values_of_scipy_to_the_last_bit(order):
    rng = np.random.default_rng(order)
    for count in (1, 2, 30):
        times = np.append(0.0, np.cumsum(rng.uniform(1e-4, 0.1, count)))
        pieces = rng.normal(size=(count, 6, 3))
        t = np.concatenate([times, rng.uniform(-0.1, times[-1] + 0.1, 50)])
        spline = PPoly(pieces.transpose(1, 0, 2)[::-1], times).derivative(order)
        assert evaluate_pieces(times, pieces, t, order).tobytes() == spline(t).tobytes()
