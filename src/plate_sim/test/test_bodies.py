"""Finite parts against exact results, scipy with a quadrature of its own, and invariants."""

from itertools import pairwise

import numpy as np
import pytest
from footprints import on_feet
from harmonic import MU, G, TwoHarmonics, waves
from scipy.integrate import solve_ivp

from plate_core import PlateCycle, PlateError
from plate_core.rig import to_plate
from plate_sim import Ground, PlateMotion, simulate, simulate_bodies
from plate_sim.contacts import Contacts
from plate_sim.friction import bar, disc, union

L_SHAPE = union(
    [
        [[0, 0], [0.03, 0], [0.03, 0.01], [0, 0.01]],
        [[0, 0.01], [0.01, 0.01], [0.01, 0.03], [0, 0.03]],
    ]
)
TRIPOD = on_feet(disc(0.01), [[0.008, 0], [-0.004, 0.007], [-0.004, -0.007]])


def random_cycle(seed, scale=1.0):
    sine, cosine = np.random.default_rng(seed).normal(size=(2, 2, 3)) * [0.1, 0.1, 0.7] * scale
    return waves(0.05, sine, cosine)


def test_a_disc_that_spins_in_place_stops_on_time():
    # Torque 2/3 mu m g R on an inertia m R^2 / 2
    radius, spin = 0.02, 30.0
    stop = 0.75 * radius * spin / (MU * G)
    cycle = PlateCycle.rest(1.2 * stop)
    run = simulate_bodies(cycle, disc(radius), [[0, 0]], 0, [[0, 0]], spin, MU, G, 1, 600)
    assert run.time[np.argmax(run.spin[:, 0] == 0)] == pytest.approx(stop, rel=4e-3)
    assert run.angle[-1, 0] == pytest.approx(0.5 * spin * stop, rel=2e-3)
    assert run.spin[-1, 0] == 0
    assert run.position == pytest.approx(0, abs=1e-12)


def test_a_disc_that_slides_and_spins_agrees_with_scipy():
    radius, start = 0.02, np.array([0.3, 20.0])
    # Midpoints of cells of equal area, unlike the footprint's rule
    ring = radius * np.sqrt((np.arange(40) + 0.5) / 40)
    angle = 2 * np.pi * (np.arange(120) + 0.5) / 120
    x, y = np.outer(ring, np.cos(angle)).ravel(), np.outer(ring, np.sin(angle)).ravel()

    def slope(_, state):
        u, v = state[1] - state[3] * y, state[3] * x
        size = np.hypot(u, v)
        return [
            state[1], -MU * G * np.mean(u / size), state[3],
            -MU * G * np.mean((x * v - y * u) / size) / (radius**2 / 2),
        ]  # fmt: skip

    truth = solve_ivp(slope, (0, 0.12), [0, start[0], 0, start[1]], rtol=1e-8, atol=1e-10)
    x, v, phi, w = truth.y[:, -1]
    run = simulate_bodies(
        PlateCycle.rest(0.12), disc(radius), [[0, 0]], 0, [[start[0], 0]], start[1], MU
    )
    assert run.position[-1, 0] == pytest.approx([x, 0], rel=5e-4, abs=3e-6)
    assert run.velocity[-1, 0] == pytest.approx([v, 0], rel=2e-3, abs=1e-4)
    assert run.angle[-1, 0] == pytest.approx(phi, rel=1e-3)
    assert run.spin[-1, 0] == pytest.approx(w, rel=5e-3)


def test_sliding_and_spinning_end_together_at_a_known_ratio():
    # v / (R spin) -> 0.653 for any start (Farkas, Bartels, Unger, Wolf, PRL 90, 248302, 2003).
    radius = 0.02
    run = simulate_bodies(
        PlateCycle.rest(0.25), disc(radius), np.zeros((2, 2)), 0,
        [[0.4, 0], [0.2, 0]], [15, 25], MU, samples=2000,
    )  # fmt: skip
    for i in range(2):
        v, w = run.velocity[:, i, 0], run.spin[:, i]
        late = np.argmin(np.abs(w - 0.05))
        assert v[late] / (radius * w[late]) == pytest.approx(0.653, rel=0.03)
    assert run.velocity[-1] == pytest.approx(0, abs=1e-9)
    assert run.spin[-1] == pytest.approx(0, abs=1e-9)


def test_a_small_disc_moves_as_a_point():
    cycle = random_cycle(3)
    point = simulate(cycle, [[0.2, -0.1]], [[0.02, -0.03]], MU, cycles=4, tolerance=1e-9)
    small = simulate_bodies(
        cycle, disc(1e-6), [[0.2, -0.1]], 0.3, [[0.02, -0.03]], 0, MU, cycles=4, step=5e-5
    )
    assert small.position[-1] == pytest.approx(point.position[-1], abs=3e-8)
    assert small.time == pytest.approx(point.time)


@pytest.mark.parametrize(("gamma", "exact"), [(4, 4.997416048e-3), (20, 65.3462e-3)])
def test_a_disc_on_a_line_travels_as_the_exact_point(gamma, exact):
    # Sticking and reversals; translation alone does not turn it.
    cycle = TwoHarmonics(gamma).cycle()
    run = simulate_bodies(cycle, disc(0.008), [[0, 0.1]], 0, [[0, 0]], 0, MU, cycles=30)
    assert run.position[-1, 0, 0] == pytest.approx(exact, rel=1e-4)
    assert run.angle[-1, 0] == pytest.approx(0, abs=1e-9)


def test_converges_in_second_order():
    def end(step):
        run = simulate_bodies(
            random_cycle(3), bar(0.04, 0.008), [[0.2, -0.1]], 0.3, [[0.02, -0.03]], 0, MU,
            cycles=4, samples=20, step=step,
        )  # fmt: skip
        return np.array([*run.position[-1, 0], 0.02 * run.angle[-1, 0]])

    truth = end(1.25e-5 / 4)
    errors = [np.linalg.norm(end(step) - truth) for step in (2e-4, 1e-4, 5e-5)]
    for coarse, fine in pairwise(errors):
        assert fine < coarse / 3.3
    assert errors[0] < 5e-7


@pytest.mark.parametrize("shape", [disc(0.01), bar(0.08, 0.005), L_SHAPE, TRIPOD])
def test_no_energy_comes_from_a_still_plate(shape):
    rng = np.random.default_rng(5)
    count = 12
    run = simulate_bodies(
        PlateCycle.rest(0.1), shape, rng.normal(size=(count, 2)), rng.normal(size=count),
        rng.normal(size=(count, 2)) * 0.2, rng.normal(size=count) * 10, MU, step=1e-3, samples=100,
    )  # fmt: skip
    energy = (run.velocity**2).sum(-1) + shape.gyration2 * run.spin**2
    assert np.all(np.diff(energy, axis=0) <= 1e-12)
    assert energy[-1].max() < energy[0].max()


@pytest.mark.parametrize("shape", [disc(0.008), bar(0.08, 0.005), L_SHAPE, TRIPOD])
def test_a_part_on_a_gently_shaken_plate_rides_with_it(shape):
    cycle = random_cycle(7, 0.02)
    start, angle = np.array([[0.2, 0.1]]), 0.4
    pose, twist = cycle.pose(0)[0], cycle.twist(0)[0]
    arm = start[0] - pose[:2]
    velocity = twist[:2] + twist[2] * np.array([-arm[1], arm[0]])
    run = simulate_bodies(cycle, shape, start, angle, [velocity], twist[2], MU, cycles=20)
    poses = np.concatenate([np.tile(cycle.pose(run.time[:64])[:64], (20, 1)), [pose]])
    inside = [to_plate(p, x)[0] for p, x in zip(poses, run.position, strict=True)]
    assert np.ptp(inside, axis=0) == pytest.approx(0, abs=1e-12)
    assert np.ptp(run.angle[:, 0] - poses[:, 2]) == pytest.approx(0, abs=1e-12)


def test_parts_without_contact_move_like_single_parts():
    """To the last bit, in whatever group they are moved: discs, a bar and a tripod among them."""
    rng, count = np.random.default_rng(8), 69
    parts = [disc(0.008), disc(0.012)] * 34 + [disc(0.01)]
    parts[20], parts[41] = bar(0.04, 0.008), TRIPOD
    position, angle = rng.uniform(-0.2, 0.2, (count, 2)), rng.uniform(-3, 3, count)
    speed, spin = 0.1 * rng.normal(size=(count, 2)), rng.normal(size=count)
    mu = rng.uniform(0, 0.4, count)
    run = simulate_bodies(
        random_cycle(4), parts, position, angle, speed, spin, mu, samples=0, cycles=2
    )
    for i in range(count):
        own = slice(i, i + 1)
        one = simulate_bodies(
            random_cycle(4), parts[i], position[own], angle[own], speed[own], spin[own], mu[own],
            samples=0, cycles=2,
        )  # fmt: skip
        for name in ("position", "angle", "velocity", "spin"):
            assert np.array_equal(getattr(one, name)[:, 0], getattr(run, name)[:, i])


@pytest.mark.parametrize("walls", [False, True])
def test_the_recording_interval_does_not_change_the_motion(walls):
    """Discs meet, and leave a turning plate where they pass its edge."""
    rng, half = np.random.default_rng(9), np.array([0.1, 0.07])
    position = np.stack(np.meshgrid([-0.09, -0.03, 0.03, 0.09], [-0.06, 0, 0.06]), -1).reshape(
        -1, 2
    )
    cycle, speed = random_cycle(4, 2.0), 6 * position + 0.1 * rng.normal(size=(12, 2))
    every, some, end = (
        simulate_bodies(
            cycle, disc(0.01), position, 0, speed, 0, MU, cycles=3, samples=samples, half=half,
            contacts=Contacts(0.5, 0.2, walls=walls),
        )
        for samples in (250, 50, 0)
    )  # fmt: skip
    for name in ("position", "angle", "velocity", "spin"):
        assert np.array_equal(getattr(every, name)[::5], getattr(some, name))
        assert np.array_equal(getattr(every, name)[-1:], getattr(end, name))
    poses = cycle.pose(every.time[:250])
    poses = np.concatenate([np.tile(poses, (3, 1)), poses[:1]])
    inside = np.array([to_plate(p, x) for p, x in zip(poses, every.position, strict=True)])
    beyond = np.any(np.abs(inside) > half, axis=2)
    gone = beyond.any(axis=0)
    assert np.array_equal(every.on_plate, ~gone)
    assert walls or 0 < np.count_nonzero(gone) < 12
    for i in np.flatnonzero(gone):
        assert not np.ptp(every.position[np.argmax(beyond[:, i]) :, i], axis=0).any()


def test_turned_frame_and_order_of_parts():
    sine, cosine = np.random.default_rng(2).normal(size=(2, 2, 3)) * [0.1, 0.1, 0.7]
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    position, speed = np.array([[0.1, 0.02], [-0.2, 0.1]]), np.array([[0.05, 0], [0, 0.1]])
    parts = [bar(0.05, 0.01), L_SHAPE]
    angle = np.array([0.3, 1.0])
    one = simulate_bodies(waves(0.05, sine, cosine), parts, position, angle, speed, 0, MU)
    other = simulate_bodies(
        waves(0.05, sine @ turn.T, cosine @ turn.T), parts[::-1], position[::-1] @ turn[:2, :2].T,
        angle[::-1] + np.arctan2(0.8, 0.6), speed[::-1] @ turn[:2, :2].T, 0, MU,
    )  # fmt: skip
    assert other.position[-1, ::-1] == pytest.approx(one.position[-1] @ turn[:2, :2].T, abs=1e-9)
    assert other.spin[-1, ::-1] == pytest.approx(one.spin[-1], abs=1e-6)


def test_without_friction_a_part_flies_on():
    run = simulate_bodies(random_cycle(1), disc(0.01), [[0, 0]], 0, [[1, 2]], 3, 0, cycles=2)
    assert run.position[-1, 0] == pytest.approx([0.1, 0.2])
    assert run.angle[-1, 0] == pytest.approx(0.3)


@pytest.mark.parametrize("shape", [disc(0.01), bar(0.05, 0.01), TRIPOD])
def test_parts_on_a_tilted_plate_stay_or_slide_down(shape):
    ground = Ground(tilt=(0.12, -0.16))
    pull = np.array(ground.effect(G)[:2])
    held, slides = (
        simulate_bodies(
            PlateCycle.rest(0.2), shape, [[0, 0]], 0.3, [[0, 0]], 0, mu, ground=ground
        )
        for mu in (0.21, 0.15)
    )  # fmt: skip
    assert np.hypot(*pull) / G == pytest.approx(0.2, abs=1e-3)
    assert held.position[-1, 0].tolist() == [0, 0]
    size = np.hypot(*pull)
    way = 0.5 * (size - 0.15 * G) * slides.time[:, None] ** 2 * pull / size
    assert slides.position[:, 0] == pytest.approx(way, abs=1e-6)
    assert slides.angle[-1, 0] == pytest.approx(0.3, abs=1e-6)


def test_a_small_disc_on_rough_tilted_ground_moves_as_a_point():
    # 3 times mu g is felt: it sticks and comes loose in every cycle.
    cycle = random_cycle(3, 0.25)
    ground = Ground(static_ratio=1.6, tilt=(0.04, -0.02))
    start, speed = [[0.2, -0.1], [-0.1, 0.05]], np.zeros((2, 2))
    point = simulate(cycle, start, speed, MU, cycles=4, tolerance=1e-9, ground=ground)
    small = simulate_bodies(
        cycle, disc(1e-6), start, 0, speed, 0, MU, cycles=4, step=5e-5, ground=ground
    )
    slip = np.linalg.norm(np.diff(point.velocity, axis=0), axis=2) * 64 / 0.05 / (MU * G)
    assert slip.max() > 1.05
    assert small.position[-1] == pytest.approx(point.position[-1], abs=2e-6)


def test_a_spinning_part_that_rides_comes_loose_at_the_static_limit():
    # The plate turns at 2 sin wt about its centre: a disc there is held by torque alone.
    radius, w = 0.02, 2 * np.pi * 10
    t = np.arange(128) / 1280
    for ratio, slides in ((1.0, True), (1.4, False)):
        push = 1.2 * (2 / 3) * MU * G / (radius / 2)
        pose, twist, accel = np.zeros((3, 128, 3))
        pose[:, 2] = push / w**2 * (1 - np.cos(w * t))
        twist[:, 2], accel[:, 2] = push / w * np.sin(w * t), push * np.cos(w * t)
        cycle = PlateCycle.from_samples(0.1, pose, twist, accel)
        run = simulate_bodies(
            cycle, disc(radius), [[0, 0]], 0, [[0, 0]], 0, MU, cycles=2,
            ground=Ground(static_ratio=ratio),
        )  # fmt: skip
        follows = np.allclose(run.spin[:64, 0], cycle.twist(run.time[:64])[:, 2], atol=1e-9)
        assert follows is not slides


def test_runs_a_motion_that_does_not_close():
    cycle = random_cycle(3)
    half = PlateMotion(cycle.times[:129], cycle.coefficients[:128])
    whole = simulate_bodies(cycle, L_SHAPE, [[0.1, 0]], 0, [[0, 0]], 0, MU, samples=64)
    part = simulate_bodies(half, L_SHAPE, [[0.1, 0]], 0, [[0, 0]], 0, MU, samples=32)
    assert part.position == pytest.approx(whole.position[:33], abs=1e-9)
    with pytest.raises(PlateError, match="cycles is 2"):
        simulate_bodies(half, L_SHAPE, [[0, 0]], 0, [[0, 0]], 0, MU, cycles=2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cycle": None}, "cycle is a NoneType"),
        ({"footprint": [disc(1)] * 3}, "list of 3, allowed: one Footprint, or 2 of them"),
        ({"position": [[0, 0, 0]]}, "position has shape"),
        ({"velocity": [[0, np.nan], [0, 0]]}, "part 0"),
        ({"angle": [0, 0, 0]}, "angle has shape"),
        ({"spin": [0, np.inf]}, r"spin is \[0\.0, inf\], allowed: "),
        ({"friction": -1}, "friction is -1"),
        ({"samples": -1}, "samples is -1"),
        ({"cycles": 0.5}, "cycles is 0.5"),
        ({"step": 0}, "step is 0"),
    ],
)
def test_wrong_input_is_refused(change, message):
    good = {
        "cycle": PlateCycle.rest(0.1), "footprint": disc(0.01), "position": np.zeros((2, 2)),
        "angle": 0, "velocity": np.zeros((2, 2)), "spin": 0, "friction": MU,
    }  # fmt: skip
    with pytest.raises(PlateError, match=message):
        simulate_bodies(**{**good, **change})
