"""The averaged force map against closed forms, quadrature, invariants and the simulator."""

import numpy as np
import pytest
from harmonic import waves
from scipy.integrate import quad

from plate_core import PlateCycle, PlateError
from plate_sim import simulate_bodies
from plate_sim.friction import disc
from plate_solver import average_force
from plate_solver.averages import step_force_gradient, step_forces

KNOTS = 64


def mean_force(position, velocity, twist):
    """Force (M, 2) over equal steps."""
    return step_forces(position, velocity, twist, np.ones(len(twist)))[:, :2]


def mean_curl(position, velocity, twist):
    """Curl (M,) over equal steps."""
    return step_forces(position, velocity, twist, np.ones(len(twist)))[:, 2]


PLACES = np.array([[0.0, 0.0], [0.21, -0.08], [-0.17, 0.11], [0.29, 0.14], [-0.05, -0.13]])
STILL = np.zeros_like(PLACES)


@pytest.fixture(name="wild")
def _wild():
    """Function (seed, N) to a random cycle of N harmonics, about 0.2 m/s everywhere."""

    def make(seed: int, number: int = 2, period: float = 0.1) -> PlateCycle:
        rng = np.random.default_rng(seed)
        sin, cos = rng.normal(size=(2, number, 3)) * [0.2, 0.2, 1.0]
        return waves(period, sin, cos, KNOTS)

    return make


@pytest.mark.parametrize("seed", range(6))
def test_one_harmonic_gives_no_force_anywhere(wild, seed):
    # Section 3.2.1. The two halves of the period cancel sample by sample.
    assert np.max(np.abs(average_force(wild(seed, 1), PLACES))) < 1e-9


@pytest.mark.parametrize("b", [0.1, 0.5, 0.9, -0.5])
def test_sin_and_double_cos_push(b):
    # Observation 3: u1 = sin t + b cos 2t is positive between the roots of a quadratic in sin t.
    # Each of the two changes of sign falls between two of 1024 samples: 2 x 2/1024 at most.
    cycle = waves(0.1, [[0.3, 0, 0], [0, 0, 0]], [[0, 0, 0], [0.3 * b, 0, 0]], KNOTS)
    root = (np.sqrt(1 + 8 * b**2) - 1) / (4 * b)
    exact = 2 / np.pi * np.arcsin(root)
    force = average_force(cycle, PLACES)
    assert abs(exact) > 0.06
    np.testing.assert_allclose(force[:, 0], exact, atol=4 / 1024)
    np.testing.assert_array_equal(force[:, 1], 0)
    if b == 0.5:
        assert exact == pytest.approx(0.2386, abs=5e-5)  # the value of the simulators' bench


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_quadrature_of_the_textbook_formula(seed):
    rng = np.random.default_rng(seed)
    sin, cos = rng.normal(size=(2, 2, 3)) * [0.2, 0.2, 1.0]
    cycle = waves(2 * np.pi, sin, cos, KNOTS)

    def friction(t: float, place: np.ndarray, part: np.ndarray) -> np.ndarray:
        u = sum(
            a * np.sin(j * t) + b * np.cos(j * t) for j, a, b in zip((1, 2), sin, cos, strict=True)
        )
        slip = u[:2] + np.cross([0, 0, u[2]], [*place, 0])[:2] - part
        return slip / np.linalg.norm(slip)

    places, velocity = PLACES[1:3], rng.normal(size=(2, 2)) * 0.02
    for i, force in enumerate(average_force(cycle, places, velocity)):
        for axis in range(2):
            exact, error = quad(
                lambda t, i=i, axis=axis: friction(t, places[i], velocity[i])[axis],
                0, 2 * np.pi, epsabs=1e-5, limit=400,
            )  # fmt: skip
            assert error < 1e-3
            assert force[axis] == pytest.approx(exact / (2 * np.pi), abs=5e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_mean_force_equals_the_velocity_gain_of_a_nearly_frictionless_part(wild, seed):
    # Friction too weak to move the part: its gain of velocity is the mean force. The plate's own
    # displacement, which the map neglects, is 0.1 um after scaling; velocities scale along.
    scale, mu, gravity = 1e-4, 1e-12, 9.81
    cycle = wild(seed, 3)
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=PLACES.shape) * 0.1
    start = scale * velocity
    end = simulate_bodies(
        cycle.scaled(scale), disc(1e-7), PLACES, 0, start, 0, mu, gravity, samples=0,
        step=cycle.period / 20_000,
    ).velocity[-1]  # fmt: skip
    gain = (end - start) / (mu * gravity * cycle.period)
    # Moving parts drift by 0.01 mm in the cycle: 1e-5 m times a curl of some 10/m.
    np.testing.assert_allclose(average_force(cycle, PLACES, velocity), gain, atol=1e-3)


def test_a_steadily_moving_part_is_braked(wild):
    way = np.array([np.cos(0.7), np.sin(0.7)])
    for seed in range(5):
        still = average_force(wild(seed), PLACES)
        moving = average_force(wild(seed), PLACES, STILL + 0.05 * way)
        assert np.all((moving - still) @ way < -0.01)
    fast = average_force(wild(0), PLACES, STILL + 100 * way)
    np.testing.assert_allclose(fast, STILL - way, atol=0.02)  # all friction against the motion


def test_scale_and_shift_of_time_do_not_matter(wild):
    cycle = wild(1)
    force = average_force(cycle, PLACES)
    assert np.max(np.abs(force)) > 0.05
    np.testing.assert_allclose(average_force(cycle.scaled(0.01), PLACES), force, atol=1e-9)
    faster = PlateCycle.from_knots(
        0.5 * cycle.times, 0.5 * cycle.knot_pose, cycle.knot_twist, 2 * cycle.knot_accel
    )
    np.testing.assert_allclose(average_force(faster, PLACES), force, atol=1e-9)
    shifted = PlateCycle.from_samples(
        cycle.period,
        *(
            np.roll(a[:-1], 5, axis=0)
            for a in (cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
        ),
    )
    np.testing.assert_allclose(average_force(shifted, PLACES), force, atol=1e-9)
    # With the part moving, it must be scaled too.
    part = STILL + [0.02, 0.01]
    force = average_force(cycle, PLACES, part)
    half = cycle.scaled(0.5)
    np.testing.assert_allclose(average_force(half, PLACES, 0.5 * part), force, atol=1e-9)
    assert np.max(np.abs(average_force(half, PLACES, part) - force)) > 1e-3


@pytest.mark.parametrize(("number", "rank"), [(2, 10), (3, 16)])
def test_rank_is_at_most_six_n_minus_two(number, rank):
    # DESIGN 4: 6 N parameters less scale and time shift. Many parts, so nothing else binds.
    rng = np.random.default_rng(number)
    places = rng.uniform(-1, 1, (20, 2)) * [0.3, 0.15]
    parameters = rng.normal(size=6 * number) * np.tile([0.2, 0.2, 1.0], 2 * number)
    angle = np.outer(2 * np.pi * (np.arange(16384) + 0.5) / 16384, np.arange(1, number + 1))
    basis = np.hstack([np.sin(angle), np.cos(angle)])

    def force(parameters: np.ndarray) -> np.ndarray:
        return mean_force(places, np.zeros_like(places), basis @ parameters.reshape(-1, 3)).ravel()

    step = 1e-6
    jacobian = np.column_stack(
        [
            (force(parameters + d) - force(parameters - d)) / (2 * step)
            for d in step * np.eye(6 * number)
        ]
    )
    values = np.linalg.svd(jacobian, compute_uv=False)
    assert values[rank - 1] > 1e-4 * values[0]
    assert values[rank] < 1e-7 * values[0]


# The field around a place: curl and divergence.


def field_slopes(cycle_twist, position, velocity, step):
    """Return d f_x/dx, d f_x/dy, d f_y/dx, d f_y/dy of the averaged field, by differences."""

    def field(offset):
        return mean_force((position + offset)[None], velocity[None], cycle_twist)[0]

    by_x = (field([step, 0]) - field([-step, 0])) / (2 * step)
    by_y = (field([0, step]) - field([0, -step])) / (2 * step)
    return by_x[0], by_y[0], by_x[1], by_y[1]


def test_curl_of_a_rotation_is_equation_11():
    centre, spin = np.array([0.1, -0.05]), 0.8
    twist = spin * np.array([centre[1], -centre[0], 1.0])
    # forward 62 % of the time
    cycle = waves(0.1, [twist, 0 * twist], [0 * twist, 0.5 * twist], KNOTS)
    step = 1e-4

    def field(place):
        return average_force(cycle, np.array([place]))[0]

    fraction = 2 / np.pi * np.arcsin((np.sqrt(3) - 1) / 2)
    for place in PLACES[1:]:
        arm = place - centre
        distance = np.hypot(*arm)
        expected = fraction * np.array([-arm[1], arm[0]]) / distance
        np.testing.assert_allclose(field(place), expected, atol=4 / 1024)
        by_x = (field(place + [step, 0]) - field(place - [step, 0])) / (2 * step)
        by_y = (field(place + [0, step]) - field(place - [0, step])) / (2 * step)
        assert by_x[1] - by_y[0] == pytest.approx(fraction / distance, rel=0.02)
        samples = cycle.twist((np.arange(1024) + 0.5) / 1024 * cycle.period)
        curl = mean_curl(place[None], np.zeros((1, 2)), samples)
        assert curl[0] == pytest.approx(fraction / distance, rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_curl_and_divergence_of_any_field(wild, seed):
    rng = np.random.default_rng(seed)
    cycle = wild(seed, 3)
    twist = cycle.twist((np.arange(300) + 0.5) / 300 * cycle.period)
    velocity = rng.normal(size=PLACES.shape) * 0.02
    curl = mean_curl(PLACES, velocity, twist)
    for i, position in enumerate(PLACES):
        step = 1e-5
        xx, xy, yx, yy = field_slopes(twist, position, velocity[i], step)
        # Every instant's field has slopes up to 1/d and third derivatives up to some 10/d^3,
        # d the distance to the instantaneous centre of rotation; rounding adds 1e-16/step.
        slip = np.hypot(
            twist[:, 0] - twist[:, 2] * position[1] - velocity[i, 0],
            twist[:, 1] + twist[:, 2] * position[0] - velocity[i, 1],
        )
        bound = 10 * step**2 * np.mean(np.abs(twist[:, 2] / slip) ** 3) + 1e-9
        assert bound < 1e-2, "too near a centre for a test by differences"
        assert abs(yx - xy - curl[i]) < bound
        assert abs(xx + yy) < bound
        assert max(map(abs, (xx, xy, yx, yy))) > 30 * bound, "a constant field shows nothing"


@pytest.mark.parametrize("seed", range(3))
def test_gradient_agrees_with_differences(seed):
    rng = np.random.default_rng(seed)
    twist, dt = rng.normal(size=(16, 3)) * [0.2, 0.2, 1.0], rng.uniform(0.5, 1.5, 16)
    places, velocity = PLACES[:3], rng.normal(size=(3, 2)) * 0.02
    gradient = step_force_gradient(places, velocity, twist, dt)
    step = 1e-6
    for k, c in np.ndindex(*twist.shape):
        change = np.zeros_like(twist)
        change[k, c] = step
        ends = [step_forces(places, velocity, twist + sign * change, dt) for sign in (1, -1)]
        slope = (ends[0] - ends[1]).ravel() / (2 * step)
        np.testing.assert_allclose(gradient[c, k], slope, rtol=1e-5, atol=1e-6)


def test_without_slip_there_is_no_force():
    none = np.zeros((8, 3))
    for array in (
        step_forces(PLACES, STILL, none, np.ones(8)),
        step_force_gradient(PLACES, STILL, none, np.ones(8)),
        average_force(PlateCycle.rest(0.1), PLACES),
    ):
        assert np.all(array == 0)
    away = average_force(PlateCycle.rest(0.1), PLACES, STILL + [3e-3, -4e-3])
    np.testing.assert_allclose(away, STILL + [-0.6, 0.8], atol=1e-12)


@pytest.mark.parametrize(
    ("position", "velocity", "shapes"),
    [
        ([0.1, 0.2], None, r"\(2,\) and \(2,\)"),
        (np.zeros((3, 3)), None, r"\(3, 3\) and \(3, 3\)"),
        (np.zeros((3, 2)), np.zeros((2, 2)), r"\(3, 2\) and \(2, 2\)"),
    ],
)
def test_wrong_shapes_are_named(position, velocity, shapes):
    with pytest.raises(PlateError, match=shapes):
        average_force(PlateCycle.rest(0.1), position, velocity)


@pytest.mark.parametrize("name", ["position", "velocity"])
def test_values_that_are_not_finite_are_named(name):
    given = {"position": PLACES, "velocity": STILL} | {name: PLACES * np.nan}
    with pytest.raises(PlateError, match=f"{name} has values that are not finite"):
        average_force(PlateCycle.rest(0.1), **given)


def test_without_parts_there_are_no_forces():
    assert average_force(PlateCycle.rest(0.1), np.zeros((0, 2))).shape == (0, 2)
