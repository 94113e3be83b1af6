"""Parts that turn: the cycle map, its derivatives, and motions that turn parts.

Truth is the simulator's bodies: friction over their whole area, by other code.
"""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import AngleTargets, CycleRequest, Parts, PlateCycle, Targets, load_rig
from plate_core.motion import usage
from plate_sim.friction import bar
from plate_sim.world import WorldState, run_cycle, simulate_bodies
from plate_solver import Controller, Limits
from plate_solver._kernels import TURNING_TRACE, adjoint_turning, trace_turning
from plate_solver.cycle_map import (
    LANES,
    end_turning,
    end_turning_gradient,
    finely_sampled,
    home_spread,
    turning_blocks_of,
)
from plate_solver.sinusoids import SinusoidFamily, sinusoid_basis

RIG = load_rig()
RADIUS, ACCEL = RIG.parts.radius_m, RIG.friction.accel
FRICTION = np.full(2, ACCEL)
DISC, BAR = np.eye(2)[None] * RADIUS**2 / 4, np.diag([4.8e-5, 1.2e-5])[None]
COAST = 0.03
INERTIA = RIG.parts.mass_kg * RADIUS**2 / 2


def turned(footprint_spread, angle, position, velocity, spin, motion):
    spread = home_spread(footprint_spread, angle)
    return end_turning(position, velocity, spin, spread, *motion, FRICTION)


def test_a_part_that_turns_on_the_spot_spins_down():
    """At a constant rate: torque mu m g sqrt(J), J half of the square of the radius of gyration;
    a disc's true torque is 2/3 mu m g R, where this has R/2."""
    n, dt, spin = 2000, 5e-6, 6.0
    still, at_rest = np.zeros((n, 3)), np.zeros((1, 2))
    rate = ACCEL / (RADIUS / 2) / 2
    motion = still, still, np.full(n, dt)
    _, _, turn, left = turned(DISC, np.zeros(1), at_rest, at_rest, np.array([spin]), motion)
    assert left[0] == pytest.approx(spin - rate * n * dt, rel=1e-3)
    assert turn[0] == pytest.approx(spin * n * dt - rate * (n * dt) ** 2 / 2, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 0.7])
def test_a_bar_that_slides_is_turned_most_along_its_length(angle):
    """Sliding at v along x, the torque is mu m g c <x^2>/v, x along the slide."""
    n = 100
    dt = 1e-5
    speed = 1.0
    spin = 0.5
    twist, still = np.tile([speed, 0, 0], (n, 1)), np.zeros((1, 2))
    motion = np.zeros((n, 3)), twist, np.full(n, dt)
    after = turned(BAR, np.array([angle]), still, still, np.array([spin]), motion)[3]
    along = BAR[0, 0, 0] * np.cos(angle) ** 2 + BAR[0, 1, 1] * np.sin(angle) ** 2
    rate = ACCEL / speed * along / np.trace(BAR[0])
    assert 1 - after[0] / spin == pytest.approx(rate * n * dt, rel=0.02)


def state(rng, count):
    spread = rng.uniform(0.2, 1.0, (count, 3)) * [4e-5, 1e-5, 4e-5]
    return (
        rng.normal(size=(count, 2)) * 0.1, rng.normal(size=(count, 2)) * 0.02,
        rng.normal(size=count), spread,
    )  # fmt: skip


def test_derivatives_agree_with_differences():
    rng = np.random.default_rng(1)
    n = 60
    start = state(rng, 2)
    pose = rng.normal(size=(n, 3)) * 1e-3
    twist = rng.normal(size=(n, 3)) * [0.1, 0.1, 1.0]
    twist[: n // 3] *= 0.01  # some steps stick
    dt = rng.uniform(2e-4, 6e-4, n)

    def end(*motion):
        position, velocity, turn, spin = end_turning(*start, *motion, FRICTION)
        return np.concatenate([(position + COAST * velocity).T.ravel(), turn + COAST * spin])

    slopes = end_turning_gradient(*start, pose, twist, dt, FRICTION, COAST)
    for which, (given, slope) in enumerate(zip((pose, twist, dt), slopes, strict=True)):
        way = rng.normal(size=given.shape) * np.mean(np.abs(given)) * 1e-6
        sides = [[pose, twist, dt] for _ in range(2)]
        sides[0][which], sides[1][which] = given - way, given + way
        difference = end(*sides[1]) - end(*sides[0])
        along = way.T[: len(slope), :, None] if slope.ndim == 3 else way[:, None]
        want = 2 * np.sum(slope * along, axis=tuple(range(slope.ndim - 1)))
        np.testing.assert_allclose(want, difference, rtol=1e-4, atol=1e-13)


@pytest.mark.parametrize("count", [3, LANES + 1])
def test_blocks_are_the_same_map(through_twist, count):
    rng = np.random.default_rng(3)
    n, dt, each = 40, 4e-4, 4
    position, velocity, spin, spread = state(rng, count)
    friction = rng.uniform(2, 3, count)
    pose, twist = rng.normal(size=(n, 3)) * 1e-3, rng.normal(size=(n, 3)) * [0.1, 0.1, 1.0]
    motion = pose, twist, np.full(n, dt), friction
    place, _, turn, _ = end_turning(position, velocity, spin, spread, *motion)
    blocks = turning_blocks_of(position, velocity, friction, dt, spin, spread)
    steps = np.empty((n, len(blocks), TURNING_TRACE), np.float32)
    trace_turning(blocks, pose, twist, dt, steps)
    rows = blocks.reshape(len(blocks), -1, LANES).transpose(0, 2, 1).reshape(-1, 10)[:count]
    np.testing.assert_allclose(rows[:, :2], place, atol=1e-7)
    np.testing.assert_allclose(rows[:, 5], turn, rtol=1e-4, atol=1e-7)
    by_twist = np.empty((n // each, len(blocks), 3, 3 * LANES), np.float32)
    adjoint_turning(steps, twist, dt, COAST, by_twist)
    on_pose, on_twist, _ = end_turning_gradient(position, velocity, spin, spread, *motion, COAST)
    want = through_twist(on_pose, on_twist, dt).reshape(3, n // each, each, 3, count).sum(2)
    got = by_twist.reshape(n // each, len(blocks), 3, 3, LANES).transpose(3, 0, 2, 1, 4)
    got = got.reshape(3, n // each, 3, -1)[..., :count]
    np.testing.assert_allclose(got, want, rtol=1e-3, atol=1e-4 * np.abs(want).max())


@pytest.mark.parametrize(("length", "width"), [(0.016, 0.016), (0.024, 0.012), (0.028, 0.006)])
def test_random_cycles_turn_bars_as_the_simulator_does(length, width):
    rng = np.random.default_rng(2)
    family = SinusoidFamily(sinusoid_basis(3, 0.1, True), Limits.of(RIG))
    footprint = bar(length, width, points=192)
    spread = np.diag([length**2, width**2])[None] / 12
    turns, places = [], []
    for _ in range(20):
        cycle = family.cycle(family.random(rng))
        position, angle = rng.uniform(-0.8, 0.8, (1, 2)) * RIG.plate.half, rng.uniform(0, np.pi, 1)
        still = np.zeros((1, 2))
        true = simulate_bodies(
            cycle, footprint, position, angle, still, 0.0, RIG.friction.mu, samples=0
        )
        end, _, turn, _ = turned(spread, angle, position, still, np.zeros(1), finely_sampled(cycle))
        turns.append((turn[0], true.angle[-1, 0] - angle[0]))
        places.append(np.hypot(*(end - true.position[-1])[0]))
    predicted, true = np.array(turns).T
    assert np.sqrt(np.mean(true**2)) > 0.004
    assert np.sqrt(np.mean((predicted - true) ** 2)) < 0.12 * np.sqrt(np.mean(true**2))
    assert max(places) < 8e-5


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
        result = controller.solve(CycleRequest.make(parts, force, torque=torque), running)
        assert usage(RIG, result.cycle).worst <= 1 + 1e-9
        before, world = world, run_cycle(world, running, RIG)
        spin = (world.angle - before.angle) / running.period
        running = result.cycle
        furthest = max(furthest, float(np.hypot(*(world.position - place)[0])))
    assert world.angle[0] > 0.8 * 38 * 0.06
    assert furthest < 1e-3


def test_without_torque_parts_are_points():
    controller = Controller(RIG)
    parts = Parts.make(("a_1",), np.zeros((1, 2)))
    plain = CycleRequest.make(parts, [[1e-3, 0]])
    turning = CycleRequest.make(replace(parts, spin=np.array([2.0])), [[1e-3, 0]])
    cycle = controller.solve(turning, None).cycle
    np.testing.assert_array_equal(
        cycle.knot_pose, Controller(RIG).solve(plain, None).cycle.knot_pose
    )


def loop_to_angles(method, ids, position, angle, request, cycles):
    """Ask for angles of parts, of any place; returns the true angles at the end."""
    rig = load_rig("shapes")
    controller, running = Controller(rig, method), PlateCycle.rest(0.1)
    world = replace(WorldState.at_rest(ids, position), angle=np.array(angle))
    free = np.full(position.shape, 0.0)
    for _ in range(cycles):
        parts = Parts.make(ids, world.position, angle=world.angle)
        to = AngleTargets(request - 0.01, request + 0.01, np.full(len(ids), 0.01))
        targets = Targets(world.position + free, world.position + free, free, 0.004, to)
        result = controller.solve(CycleRequest.make(parts, targets=targets), running)
        assert usage(rig, result.cycle).worst <= 1 + 1e-9
        world, running = run_cycle(world, running, rig), result.cycle
    return run_cycle(world, running, rig).angle


@pytest.mark.parametrize(("method", "cycles"), [("sinusoids", 12), ("rotations", 30)])
def test_two_bars_rotate_in_opposite_directions_at_the_same_time(method, cycles):
    position = np.array([[-0.1, 0.02], [0.05, -0.04]])
    request = np.array([0.5, -0.3])
    angle = loop_to_angles(method, ("bar_1", "bar_2"), position, [0.0, 0.2], request, cycles)
    np.testing.assert_allclose(angle, request, atol=0.05)
