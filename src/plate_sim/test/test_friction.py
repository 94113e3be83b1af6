"""Point parts against exact results, a stiff solver of scipy, and invariants."""

import numpy as np
import pytest
from harmonic import MU, G, TwoHarmonics, waves
from scipy.integrate import solve_ivp

from plate_core import PlateCycle, PlateError
from plate_core.rig import surface_velocity, to_plate
from plate_sim import PlateMotion, _kernels, simulate, simulate_bodies
from plate_sim.friction import disc


def travel(gamma):
    return simulate(TwoHarmonics(gamma).cycle(), [[0, 0.1]], [[0, 0]], MU, G, 30).position[-1, 0, 0]


def travel_in_steps(gamma, steps, turn=0.0):
    cycle = TwoHarmonics(gamma).cycle(turn)
    run = simulate_bodies(
        cycle, disc(0.01), [[0, 0.1]], 0, [[0, 0]], 0, MU, G, 30, 0, cycle.period / steps
    )
    return run.position[-1, 0, 0]


# Event-driven integration, equal to solve_ivp at rtol 1e-12 within 1e-10 mm.
EXACT = pytest.mark.parametrize(("gamma", "exact"), [(4, 4.997416048e-3), (20, 65.346182922e-3)])


@EXACT
def test_travel_of_the_exact_scene(gamma, exact):
    assert travel(gamma) == pytest.approx(exact, rel=1e-6)
    assert travel_in_steps(gamma, 20000) == pytest.approx(exact, rel=2e-5)


def error_in_steps(gamma, exact, start, turn):
    # A mean, as the error of one step size depends on where the steps fall.
    steps = range(start, start + 12)
    return np.mean([abs(travel_in_steps(gamma, n, turn) / exact - 1) for n in steps])


@EXACT
def test_converges_in_first_order_where_parts_stick_and_reverse(gamma, exact):
    # Where the plate turns, be it so little that the way is the same, all steps are general ones.
    fine, coarse = (error_in_steps(gamma, exact, n, 1e-9) for n in (6400, 800))
    assert fine < coarse / 7


@EXACT
def test_a_slip_that_reverses_on_a_line_is_followed_exactly(gamma, exact):
    assert error_in_steps(gamma, exact, 800, 0.0) < 2e-6


def test_mean_force_on_a_held_part():
    # Friction so small that the part hardly moves: the impulse is that on a held part.
    mu, cycle = 1e-7, TwoHarmonics(4).cycle()
    run = simulate_bodies(
        cycle, disc(0.01), [[0, 0]], 0, [[0, 0]], 0, mu, G, samples=0, step=cycle.period / 4000
    )
    assert run.velocity[-1, 0, 0] / (mu * G * cycle.period) == pytest.approx(0.2386, abs=1e-4)


def test_agrees_with_a_stiff_solver_in_the_plane():
    rng = np.random.default_rng(3)
    period, eps = 0.05, 1e-6
    cycle = waves(period, *(rng.normal(size=(2, 2, 3)) * [0.1, 0.1, 0.7]))
    start = np.array([0.2, -0.1, 0.02, -0.03])

    def slope(t, state):
        # Coulomb's law, rounded off below a slip of eps [m/s].
        surface = surface_velocity(cycle.pose(t)[0], cycle.twist(t)[0], state[:2])
        slip = surface - state[2:]
        return np.concatenate([state[2:], MU * G * slip / np.sqrt(slip @ slip + eps**2)])

    truth = solve_ivp(slope, (0, period), start, "LSODA", rtol=1e-9, atol=1e-11, max_step=2e-4)
    moved = np.linalg.norm(truth.y[:2, -1] - start[:2])

    run = simulate(cycle, start[None, :2], start[None, 2:], MU, G)
    assert truth.success
    assert run.velocity[-1, 0] == pytest.approx(truth.y[2:, -1], abs=1e-5)
    assert np.linalg.norm(run.position[-1, 0] - truth.y[:2, -1]) / moved < 3e-6


def test_below_the_friction_limit_parts_ride_along():
    cycle = waves(0.2, [[0.02, 0.01, 0.1]], [[0, 0, 0]])
    peak = np.max(np.abs(cycle.accel(np.linspace(0, 0.2, 500)))[:, 0])
    assert peak < 0.5 * MU * G
    position = np.array([[0.25, 0.1], [-0.1, 0.05], [0, 0]])
    run = simulate(cycle, position, np.zeros((3, 2)), MU, G, cycles=3, samples=4000)
    home = to_plate(cycle.pose(0)[0], position)
    for t in (0.05, 0.1, 0.3, 0.6):
        k = round(t / 5e-5)
        assert to_plate(cycle.pose(t % 0.2)[0], run.position[k]) == pytest.approx(home, abs=1e-7)


def test_one_harmonic_gives_no_drift():
    cycle = waves(1 / 30, [[0.1, 0.05, 0.0]], [[0.02, -0.1, 0.0]])
    run = simulate(cycle, [[0.1, 0.0]], [[0.05, 0.0]], MU, G, cycles=60)
    per_cycle = run.position[-1] - run.position[-1 - (len(run.time) - 1) // 60]
    assert np.abs(per_cycle).max() < 1e-8


def test_resting_plate_brakes_parts_in_a_straight_line():
    velocity, mu = np.array([[0.3, 0.4], [0.5, 0.0]]), np.array([0.25, 0.5])
    run = simulate(PlateCycle.rest(0.3), np.zeros((2, 2)), velocity, mu, G)
    speed = np.linalg.norm(velocity, axis=1)
    way = velocity * (speed / (2 * mu * G))[:, None]  # v^2/(2 mu g)
    assert run.position[-1] == pytest.approx(way, rel=1e-6)
    assert np.all(run.velocity[-1] == 0)
    energy = np.sum(run.velocity**2, axis=2)
    assert np.all(np.diff(energy, axis=0) <= 0)


def test_friction_never_exceeds_its_limit():
    cycle = TwoHarmonics(20).cycle()
    run = simulate(cycle, [[0.1, 0.1]], [[0, 0]], MU, G, samples=500)
    change = np.linalg.norm(np.diff(run.velocity, axis=0), axis=2)
    assert np.max(change) <= MU * G * cycle.period / 500 * (1 + 1e-9)


def test_result_holds_the_start_and_every_step():
    run = simulate(
        TwoHarmonics(4).cycle(), np.zeros((3, 2)), np.zeros((3, 2)), MU, cycles=2, samples=50
    )
    assert run.time.shape == (101,)
    assert run.time[-1] == pytest.approx(2 / 30)
    assert run.position.shape == run.velocity.shape == (101, 3, 2)
    assert np.all(run.position[0] == 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.zeros((2, 3))}, "position has shape"),
        ({"velocity": np.zeros((1, 2))}, "velocity has shape"),
        ({"position": np.full((2, 2), np.nan)}, "position has values that are not finite"),
        ({"friction": [0.1, 0.2, 0.3]}, "friction has shape"),
        ({"friction": -0.1}, "friction is -0.1"),
        ({"friction": [0.1, np.nan]}, "friction is nan for part 1, allowed"),
        ({"velocity": [[0, 0], [np.inf, 1]]}, r"velocity .* not finite: part 1 has \[inf, 1.0\]"),
        ({"velocity": [[0, -1e70], [0, 1]]}, r"velocity .* too large: part 0 has \[0.0, -1e\+70\]"),
        ({"cycles": 0}, "cycles is 0"),
        ({"samples": 0}, "samples is 0"),
    ],
)
def test_wrong_arguments_of_simulate_are_refused(change, message):
    arguments = {"position": np.zeros((2, 2)), "velocity": np.zeros((2, 2)), "friction": MU}
    with pytest.raises(PlateError, match=message):
        simulate(PlateCycle.rest(0.1), **(arguments | change))


@pytest.mark.parametrize("how", [{}, {"samples": 10}])
def test_a_plate_that_moves_nowhere_finite_is_refused(how):
    pieces = np.zeros((2, 6, 3))
    pieces[1, 3, 2] = np.nan
    motion = PlateMotion(np.array([0.0, 0.1, 0.2]), pieces)
    with pytest.raises(PlateError, match="piece 1 of the plate's motion is not finite"):
        simulate(motion, [[0, 0]], [[0, 0]], MU, **how)


def test_a_cycle_that_ends_in_motion_is_not_repeated():
    moving = np.zeros((3, 3))
    moving[1] = 0.01, 0.0, 0.2
    cycle = PlateCycle.stopping(moving, 0.1)  # starts in motion, ends at rest
    simulate(cycle, [[0, 0]], [[0, 0]], MU)
    message = (
        r"cycles is 2, allowed: 1, because the cycle does not close\. .* 0 m or rad in pose, "
        r"0\.2 m/s or rad/s in twist, 0 m/s2 or rad/s2 in acceleration, allowed: 1e-06 m and "
        r"1e-05 rad, 0\.0001 m/s and 0\.001 rad/s, 0\.01 m/s2 and 0\.1 rad/s2"
    )
    with pytest.raises(PlateError, match=message):
        simulate(cycle, [[0, 0]], [[0, 0]], MU, cycles=2)


def test_a_cycle_that_does_not_close_is_refused():
    states = np.zeros((3, 3, 3))
    states[0, 2, 0] = 1e-3
    with pytest.raises(PlateError, match=r"not closed: end and start differ by 0\.001 m"):
        PlateCycle.from_knots(np.array([0, 0.1, 0.2]), *states)


@pytest.mark.parametrize("w", [0.05, 0.2, 0.4, 0.4999, 0.5001, 0.7])
def test_force_and_torque_on_a_disc_are_the_integrals_over_its_area(w):
    """By Gauss and the trapezoidal rule. No point of the disc is at rest, so both are exact."""
    r, weight = np.polynomial.legendre.leggauss(60)
    r, weight = 0.5 * (r + 1)[:, None], weight[:, None] / 2 / 240
    angle = 2 * np.pi * np.arange(240) / 240
    x, y = r * np.cos(angle), r * np.sin(angle)
    u, v = 1 - w * y, w * x
    speed = np.hypot(u, v)
    force = np.sum(2 * r * weight * u / speed)
    torque = np.sum(2 * r * weight * (x * v - y * u) / speed)
    assert _kernels.disc_force(1.0, w) == pytest.approx((force, torque), abs=1e-9)
