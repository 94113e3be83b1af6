"""Parts that turn: the cycle map of discs, its derivatives, and motions that turn a part in place.

Truth is the simulator's disc, which integrates friction over its whole area and shares no code.
"""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, PlateCycle, Wanted, load_rig
from plate_core.motion import usage
from plate_sim.world import WorldState, run_cycle
from plate_solver import Controller, Limits
from plate_solver.maps import end_disc, end_disc_gradient, finely_sampled
from plate_solver.maps.disc import POINTS
from plate_solver.sinusoids import SinusoidFamily, sinusoid_basis

RIG = load_rig()
RADIUS, ACCEL = RIG.parts.radius_m, RIG.friction.accel
FRICTION = np.full(2, ACCEL)
INERTIA = RIG.parts.mass_kg * RADIUS**2 / 2


def test_points_have_the_moments_of_a_disc():
    assert np.mean(np.sum(POINTS**2, axis=1)) == pytest.approx(1 / 2)  # inertia, m R^2
    assert np.mean(np.hypot(*POINTS.T)) == pytest.approx(2 / 3)  # greatest torque, mu m g R
    np.testing.assert_allclose(POINTS.mean(axis=0), 0, atol=1e-15)


@pytest.mark.parametrize("spin", [0.1, 3.0])
def test_disc_spins_down_on_a_plate_at_rest(spin):
    """At a constant rate: torque 2/3 mu m g R over inertia m R^2/2."""
    n, dt = 2000, 5e-6
    still = np.zeros((n, 3))
    at_rest = np.zeros((1, 2))
    rate = 4 / 3 * ACCEL / RADIUS
    _, _, turn, left = end_disc(
        at_rest, at_rest, np.array([spin]), still, still, np.full(n, dt), FRICTION, RADIUS * POINTS
    )
    stop = min(n * dt, spin / rate)
    assert left[0] == pytest.approx(spin - rate * stop, abs=1e-6)
    assert turn[0] == pytest.approx(
        spin * stop - rate * stop**2 / 2, rel=0.03
    )  # first order in the step


def test_disc_that_slides_hardly_feels_a_torque():
    """Sliding at v, the torque is mu m g R^2 c/(4 v): mu g/(2 v) of the spin is lost a second."""
    n, dt, speed, spin = 100, 1e-5, 1.0, 0.5
    twist = np.tile([speed, 0, 0], (n, 1))
    still = np.zeros((1, 2))
    after = end_disc(
        still, still, np.array([spin]), np.zeros((n, 3)), twist, np.full(n, dt), FRICTION,
        RADIUS * POINTS,
    )[3]  # fmt: skip
    assert 1 - after[0] / spin == pytest.approx(ACCEL / (2 * speed) * n * dt, rel=0.02)


def test_derivatives_agree_with_differences():
    rng = np.random.default_rng(1)
    n = 60
    position, velocity = rng.normal(size=(2, 2)) * 0.1, rng.normal(size=(2, 2)) * 0.02
    spin = rng.normal(size=2)
    pose = rng.normal(size=(n, 3)) * 1e-3
    twist = rng.normal(size=(n, 3)) * [0.1, 0.1, 1.0]
    twist[: n // 3] *= 0.01  # some steps stick
    dt = rng.uniform(2e-4, 6e-4, n)

    def end(pose, twist, dt):
        place, _, turn, _ = end_disc(
            position, velocity, spin, pose, twist, dt, FRICTION, RADIUS * POINTS
        )
        return np.concatenate([place.T.ravel(), turn])

    slopes = end_disc_gradient(position, velocity, spin, pose, twist, dt, FRICTION, RADIUS * POINTS)
    for which, (given, slope) in enumerate(zip((pose, twist, dt), slopes, strict=True)):
        way = rng.normal(size=given.shape) * np.mean(np.abs(given)) * 1e-6
        sides = [[pose, twist, dt] for _ in range(2)]
        sides[0][which], sides[1][which] = given - way, given + way
        difference = end(*sides[1]) - end(*sides[0])
        along = way.T[: len(slope), :, None] if slope.ndim == 3 else way[:, None]
        want = 2 * np.sum(slope * along, axis=tuple(range(slope.ndim - 1)))
        np.testing.assert_allclose(want, difference, rtol=1e-4, atol=1e-13)


def test_random_cycles_turn_discs_as_the_simulator_does():
    rng = np.random.default_rng(2)
    family = SinusoidFamily(sinusoid_basis(3, 0.1, True), Limits.of(RIG))
    turns, places = [], []
    for _ in range(12):
        cycle = family.cycle(family.random(rng))
        place = rng.uniform(-0.8, 0.8, (1, 2)) * RIG.plate.half
        true = run_cycle(WorldState.at_rest(("a_1",), place), cycle, RIG)
        still = np.zeros((1, 2))
        end, _, turn, _ = end_disc(
            place, still, np.zeros(1), *finely_sampled(cycle), FRICTION, RADIUS * POINTS
        )
        turns.append((turn[0], true.angle[0]))
        places.append(np.hypot(*(end - true.position)[0]))
    foreseen, true = np.array(turns).T
    assert np.sqrt(np.mean(true**2)) > 0.005
    assert np.sqrt(np.mean((foreseen - true) ** 2)) < 0.05 * np.sqrt(np.mean(true**2))
    assert max(places) < 5e-5


@pytest.mark.parametrize("method", ["sinusoids", "rotations"])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.15, -0.07)])
def test_a_part_turns_in_place(method, place):
    """One part, half a turn in steps of 0.06 rad; images without noise."""
    controller, running = Controller(RIG, method), PlateCycle.rest(0.1)
    world = WorldState.at_rest(("a_1",), np.array([place]))
    spin, before, furthest = np.zeros(1), world, 0.0
    for _ in range(40):
        drift = -0.5 * (world.position - place) / running.period
        now = (world.position - before.position) / running.period
        force = RIG.parts.mass_kg * np.clip(drift - now, -0.02, 0.02) / running.period
        torque = INERTIA * (0.6 - spin) / running.period
        parts = Parts.make(world.ids, world.position, now, world.angle, spin)
        answer = controller.answer(Wanted.make(parts, force, torque=torque), running)
        assert usage(RIG, answer.cycle).worst <= 1 + 1e-9
        before, world = world, run_cycle(world, running, RIG)
        spin = (world.angle - before.angle) / running.period
        running = answer.cycle
        furthest = max(furthest, float(np.hypot(*(world.position - place)[0])))
    assert world.angle[0] > 0.8 * 38 * 0.06
    assert furthest < 1e-3


def test_without_torque_parts_are_points():
    controller = Controller(RIG)
    parts = Parts.make(("a_1",), np.zeros((1, 2)))
    plain = Wanted.make(parts, [[1e-3, 0]])
    turning = Wanted.make(replace(parts, spin=np.array([2.0])), [[1e-3, 0]])
    cycle = controller.answer(turning, None).cycle
    np.testing.assert_array_equal(
        cycle.knot_pose, Controller(RIG).answer(plain, None).cycle.knot_pose
    )
