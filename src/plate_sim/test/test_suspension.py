"""The plate on its flexures, compared with integration, transfer functions and energy bounds."""

from dataclasses import replace
from math import inf, pi, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.rig import Suspension, mass_matrix, modal_matrices
from plate_sim import PlateState
from plate_sim.plate.response import (
    ACCEL_ERROR,
    POSE_ERROR,
    TWIST_ERROR,
    motor_record,
    overtravel,
    realise,
)

RIG = load_rig()
FREQUENCY, RATIO = 35.0, 0.03
OMEGA = 2 * pi * FREQUENCY
MASS = mass_matrix(2.0, 0.075)
LOPSIDED = mass_matrix(2.0, 0.075, (0.03, -0.02))
DAMPING, STIFFNESS = modal_matrices(MASS, [FREQUENCY] * 3, [RATIO] * 3)
COUPLED = ((9e4, 2e4, 3e3), (2e4, 8e4, -1e3), (3e3, -1e3, 4e3))
PUSH = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [-0.1, 0.1, -0.2, 0.2]])  # of the default rig
UNEQUAL = (1.15, 0.85, 1.1, 0.9)
BY_HEART = (1, 1, 1)
STATIC = (0, 0, 1)
WEIGHED = (1, 0, 1)
FREE = (1, 0, 0)


def rig(**changes):
    """The default rig, hung at 35 Hz with 3 % damping; the drive pushes against flexures only."""
    facts = {"mass": MASS, "damping": DAMPING, "stiffness": STIFFNESS, "feedforward": STATIC}
    return replace(RIG, suspension=Suspension(**(facts | changes)))


def wave(frequency, amplitude, harmonic=1, samples=32):
    """A cycle of `harmonic` waves cos(w t) of the pose (3,) at `frequency` [Hz]."""
    t = np.arange(harmonic * samples) / (samples * frequency)
    w, amplitude = 2 * pi * frequency, np.asarray(amplitude)
    cos, sin = np.cos(w * t)[:, None], np.sin(w * t)[:, None]
    return PlateCycle.from_samples(
        harmonic / frequency, cos * amplitude, -w * sin * amplitude, -(w**2) * cos * amplitude
    )


def wild(seed=3, knots=12, period=0.1):
    """A cycle from rest to rest with unequal pieces and jumps of the jerk."""
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0], np.sort(rng.uniform(0, period, knots - 2)), [period]])
    pose, twist, accel = rng.normal(size=(3, knots, 3)) * [1, 1, 4]
    scale = np.array([1e-3, 0.05, 10])
    for state in (pose, twist, accel):
        state[[0, -1]] = 0
    return PlateCycle.from_knots(times, scale[0] * pose, scale[1] * twist, scale[2] * accel)


def move(pose, time, period=0.1):
    """A cycle that moves to a pose (3,) and back, each in `time` [s], by smooth ramps."""
    times = np.array([0, time, period - time, period])
    poses = np.array([0, 1, 1, 0])[:, None] * np.asarray(pose)
    return PlateCycle.from_knots(times, poses, np.zeros((4, 3)), np.zeros((4, 3)))


def integrated(suspension, cycle, samples):
    """The textbook's equations of motion by DOP853, from rest: q, q', q'' at times `samples`."""
    mass, damping, stiffness = (
        np.array(getattr(suspension, name)) for name in ("mass", "damping", "stiffness")
    )
    gain, corner = np.array(suspension.motor_gain), 2 * pi * suspension.motor_bandwidth_hz
    fraction, lags = np.linalg.pinv(PUSH), np.isfinite(suspension.motor_bandwidth_hz)
    of_mass, of_damping, of_stiffness = suspension.feedforward

    def required_force(t, q, v):
        c, cd, cdd = cycle.pose(t)[0], cycle.twist(t)[0], cycle.accel(t)[0]
        ahead = of_mass * mass @ cdd + of_damping * damping @ cd + of_stiffness * stiffness @ c
        stiff, damped = suspension.servo
        return gain * (fraction @ ahead + PUSH.T @ (stiff * (c - q) + damped * (cd - v)))

    def rates(t, z):
        q, v = z[:3], z[3:6]
        force = z[6:] if lags else required_force(t, q, v)
        accel = np.linalg.solve(mass, PUSH @ force - damping @ v - stiffness @ q)
        return np.concatenate(
            [v, accel, corner * (required_force(t, q, v) - force) if lags else []]
        )

    z, rows = np.zeros(10 if lags else 6), []
    for begin, end in zip(cycle.times[:-1], cycle.times[1:], strict=True):
        inside = samples[(samples >= begin) & (samples < end)]
        run = solve_ivp(
            rates, (begin, end), z, method="DOP853", rtol=1e-10, atol=1e-13,
            t_eval=np.append(inside, end),
        )  # fmt: skip
        z = run.y[:, -1]
        rows += [(y[:3], y[3:6], rates(t, y)[3:6]) for t, y in zip(inside, run.y.T, strict=False)]
    return np.array(rows).swapaxes(0, 1)


DRIVES = {
    "static": {},
    "coupled and uneven": {
        "mass": LOPSIDED, "stiffness": COUPLED, "feedforward": WEIGHED, "motor_gain": UNEQUAL,
    },
    "slow motors with a servo": {
        "feedforward": (0.9, 0.2, 1.1), "motor_gain": UNEQUAL, "motor_bandwidth_hz": 150.0,
        "servo": (1e4, 60.0),
    },
    "free, held by its servo": {
        "stiffness": np.zeros((3, 3)), "damping": np.zeros((3, 3)), "feedforward": FREE,
        "servo": (4e4, 300.0), "motor_gain": UNEQUAL,
    },
    "fast motors": {"motor_bandwidth_hz": 800.0, "feedforward": BY_HEART},
}  # fmt: skip


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_the_motion_is_that_of_the_equations(drive):
    cycle, hung = wild(), rig(**drive)
    samples = np.linspace(0, cycle.period, 300, endpoint=False)
    truth = integrated(hung.suspension, cycle, samples)
    motion, _ = realise(hung, PlateState.at_rest(), cycle)
    found = (motion.pose(samples), motion.twist(samples), motion.accel(samples))
    for got, want, error in zip(found, truth, (POSE_ERROR, TWIST_ERROR, ACCEL_ERROR), strict=True):
        np.testing.assert_allclose(got, want, rtol=0, atol=2 * error)
        assert np.max(np.abs(want - got)) < 0.02 * np.max(np.abs(want))
    assert np.max(np.abs(truth[0] - cycle.pose(samples))) > 1e-5  # it is not the command
    assert len(motion.times) < 30 * len(cycle.times)


def test_a_rigid_plate_does_as_commanded_to_the_last_bit():
    cycle = wild()
    motion, end = realise(RIG, PlateState.at_rest(), cycle)
    np.testing.assert_array_equal(motion.coefficients, cycle.coefficients)
    np.testing.assert_array_equal(motion.times, cycle.times)
    np.testing.assert_allclose(end.pose, 0, atol=1e-15)
    assert end.overtravel_m == 0


@pytest.mark.parametrize("changes", [{}, {"mass": LOPSIDED, "stiffness": COUPLED}])
def test_a_drive_that_knows_the_plate_moves_it_as_commanded(changes):
    cycle, state = wild(), PlateState.at_rest()
    hung = rig(feedforward=BY_HEART, servo=(1e4, 60.0), **changes)
    t = np.linspace(0, cycle.period, 100)
    for _ in range(3):
        motion, state = realise(hung, state, cycle)
        np.testing.assert_array_equal(motion.times, cycle.times)
        np.testing.assert_allclose(motion.pose(t), cycle.pose(t), rtol=0, atol=1e-16)
        np.testing.assert_allclose(motion.twist(t), cycle.twist(t), rtol=0, atol=1e-13)
        np.testing.assert_allclose(motion.accel(t), cycle.accel(t), rtol=0, atol=1e-10)


def test_equal_but_weak_motors_scale_the_motion():
    """The drive's forces are correct except for one factor, and the system is linear."""
    weak = rig(feedforward=BY_HEART, motor_gain=(0.9,) * 4)
    motion, _ = realise(weak, PlateState.at_rest(), wild())
    t = np.linspace(0, 0.1, 101)
    np.testing.assert_allclose(motion.pose(t), 0.9 * wild().pose(t), atol=2 * POSE_ERROR)


def steady(hung, cycle, amplitude, frequency):
    """Complex response (3,) per unit of amplitude after 5 s: transients are at e^-30."""
    state = PlateState.at_rest()
    for _ in range(round(5 / cycle.period)):
        motion, state = realise(hung, state, cycle)
    t = np.arange(256) / 256 * cycle.period
    phase = np.exp(-2j * pi * frequency * t)
    return 2 * np.mean(motion.pose(t) * phase[:, None], axis=0) / amplitude


@pytest.mark.parametrize("frequency", [10.0, FREQUENCY, 60.0])
@pytest.mark.parametrize("bandwidth", [inf, 120.0])
def test_steady_waves_follow_the_transfer_function(frequency, bandwidth):
    """K / (K - M w^2 + i w C) for flexures pushed by position, times the motors' lag."""
    cycle = wave(frequency, [1e-4, -2e-4, 3e-4], harmonic=max(1, round(0.1 * frequency)))
    response = steady(rig(motor_bandwidth_hz=bandwidth), cycle, [1e-4, -2e-4, 3e-4], frequency)
    ratio = frequency / FREQUENCY
    expected = 1 / (1 - ratio**2 + 2j * RATIO * ratio) / (1 + 1j * frequency / bandwidth)
    np.testing.assert_allclose(response, expected, rtol=1e-5)
    if frequency == FREQUENCY and bandwidth == inf:
        np.testing.assert_allclose(abs(response), 1 / (2 * RATIO), rtol=1e-5)
        np.testing.assert_allclose(np.angle(response), -pi / 2, atol=1e-4)


def test_the_peak_is_where_the_suspension_resonates():
    frequencies = FREQUENCY * np.array([0.98, sqrt(1 - 2 * RATIO**2), 1.02])
    low, peak, high = (
        abs(steady(rig(), wave(f, [1e-4] * 3, harmonic=3), [1e-4] * 3, f)[0]) for f in frequencies
    )
    assert peak == pytest.approx(1 / (2 * RATIO * sqrt(1 - RATIO**2)), rel=1e-5)
    assert low < 0.95 * peak
    assert high < 0.95 * peak


@pytest.mark.parametrize("drive", [{}, {"feedforward": WEIGHED, "motor_bandwidth_hz": 60.0}])
def test_an_abrupt_rotation_rings_at_the_natural_frequency(drive):
    hung, rest = rig(**drive), PlateCycle.rest(0.5)
    _, state = realise(hung, PlateState.at_rest(), move([0, 0, 0.01], 0.008, 0.05))
    _, state = realise(hung, state, PlateCycle.rest(0.05))  # the motors' own lag dies out
    motion, state = realise(hung, state, rest)
    t = np.linspace(0, 0.5, 5001)
    theta = motion.pose(t)[:, 2]
    assert np.max(np.abs(theta)) > 1e-4
    np.testing.assert_allclose(motion.pose(t)[:, :2], 0, atol=1e-12)
    crossings = np.flatnonzero(np.diff(np.signbit(theta)))
    zeros = t[crossings] - theta[crossings] * 1e-4 / np.diff(theta)[crossings]
    damped = FREQUENCY * sqrt(1 - RATIO**2)
    np.testing.assert_allclose(np.diff(zeros), 1 / (2 * damped), rtol=1e-3)
    early, late = motion.pose(zeros[[0, 10]] + 1 / (4 * damped))[:, 2]
    assert late / early == pytest.approx(np.exp(-RATIO * OMEGA * 5 / damped), rel=1e-3)


def test_blended_rotations_ring_less_than_abrupt_ones():
    """Section 3.2: low-pass filtered motions are a partial cure."""
    ringing = []
    for time in (0.006, 0.045):
        _, state = realise(rig(), PlateState.at_rest(), move([0, 0, 0.01], time))
        motion, _ = realise(rig(), state, PlateCycle.rest(0.1))
        ringing.append(np.max(np.abs(motion.pose(np.linspace(0, 0.1, 500))[:, 2])))
    assert ringing[0] > 1e-3
    assert ringing[1] < ringing[0] / 5


@pytest.mark.parametrize("bandwidth", [inf, 300.0])
def test_energy_only_falls_at_rest(bandwidth):
    hung = rig(mass=LOPSIDED, stiffness=COUPLED, motor_bandwidth_hz=bandwidth)
    mass, stiffness = np.array(LOPSIDED), np.array(COUPLED)
    state = PlateState(np.array([1e-3, -2e-3, 4e-3]), np.array([0.1, 0.2, -0.5]), np.zeros(4))
    energies = []
    for _ in range(5):
        motion, state = realise(hung, state, PlateCycle.rest(0.04))
        t = np.linspace(0, 0.04, 200)
        pose, twist = motion.pose(t), motion.twist(t)
        energies.append(
            (np.sum(twist @ mass * twist, axis=1) + np.sum(pose @ stiffness * pose, axis=1)) / 2
        )
    energy = np.concatenate(energies)
    assert energy[0] > 0.1
    assert np.all(np.diff(energy) < 1e-9 * energy[0])
    assert energy[-1] < 0.2 * energy[0]


def test_unequal_motors_rotate_the_plate_as_in_statics():
    """Pushed slowly along x: K_theta theta = 0.1 m (f_2 - f_1), f_i = g_i K_x x / 2."""
    cycle = wave(0.5, [1e-3, 0, 0])
    x, y, theta = steady(rig(motor_gain=(1.15, 0.85, 1.0, 1.0)), cycle, 1e-3, 0.5)
    turn = 0.1 * (0.85 - 1.15) / 2 * STIFFNESS[0][0] / STIFFNESS[2][2]
    assert theta == pytest.approx(turn, rel=1e-3)
    assert x == pytest.approx(1, rel=1e-3)
    assert abs(y) < 1e-12


def test_unequal_motors_couple_as_in_the_transfer_matrix():
    hung = rig(mass=LOPSIDED, stiffness=COUPLED, motor_gain=UNEQUAL, feedforward=WEIGHED)
    w = 2 * pi * 25.0
    mass, damping, stiffness = np.array(LOPSIDED), np.array(DAMPING), np.array(COUPLED)
    requested = PUSH @ np.diag(UNEQUAL) @ np.linalg.pinv(PUSH) @ (stiffness - w**2 * mass)
    expected = np.linalg.solve(stiffness - w**2 * mass + 1j * w * damping, requested)
    assert np.min(np.abs(expected[~np.eye(3, dtype=bool)])) > 1e-3
    for column, amplitude in enumerate(1e-4 * np.eye(3)):
        response = steady(hung, wave(25.0, amplitude, harmonic=5), 1e-4, 25.0)
        np.testing.assert_allclose(response, expected[:, column], atol=1e-5)


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_a_cycle_continues_where_the_last_cycle_ended(drive):
    """Two runs of a cycle are one run of a cycle twice as long."""
    hung, cycle = rig(**drive), wild()
    first, state = realise(hung, PlateState.at_rest(), cycle)
    second, end = realise(hung, state, cycle)
    for order in ("pose", "twist", "accel"):
        before, after = getattr(first, order)(first.period), getattr(second, order)(0.0)
        np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)
    knots = (cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    times = np.concatenate([cycle.times, cycle.period + cycle.times[1:]])
    double = PlateCycle.from_knots(times, *(np.vstack([k, k[1:]]) for k in knots))
    long, state = realise(hung, PlateState.at_rest(), double)
    t = np.linspace(0, cycle.period, 50)
    np.testing.assert_allclose(second.pose(t), long.pose(t + cycle.period), atol=2 * POSE_ERROR)
    np.testing.assert_allclose(state.pose, end.pose, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(state.twist, end.twist, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(state.force, end.force, rtol=1e-9, atol=1e-9)


def test_a_realised_motion_can_be_commanded():
    """PlateMotion or PlateCycle: it does not matter which holds the command."""
    commanded, _ = realise(RIG, PlateState.at_rest(), wild())
    one, _ = realise(rig(), PlateState.at_rest(), commanded)
    other, _ = realise(rig(), PlateState.at_rest(), wild())
    np.testing.assert_array_equal(one.coefficients, other.coefficients)


def test_overtravel_is_reported():
    hung, state = rig(), PlateState.at_rest()
    cycle = wave(FREQUENCY, [1e-3, 0, 0], harmonic=2)
    reported = []
    for _ in range(60):
        motion, state = realise(hung, state, cycle)
        travel, _, _ = motor_record(hung, motion, np.linspace(0, motion.period, 401))
        reported.append(state.overtravel_m)
        expected = max(0.0, np.max(np.abs(travel)) - RIG.limits.stroke_m)
        assert state.overtravel_m == pytest.approx(expected, abs=2e-5)
    assert reported[0] == 0
    assert reported[-1] == pytest.approx(1e-3 / (2 * RATIO) - RIG.limits.stroke_m, rel=1e-2)
    far, _ = realise(RIG, PlateState.at_rest(), wave(5.0, [0.0, 0.011, 0.0]))
    assert overtravel(RIG, far) == pytest.approx(1e-3)


def test_unequal_motors_at_resonance_miss_what_was_commanded_by_half():
    """The errors that a learning drive must correct: every harmonic is wrong, and visible at the
    motors."""
    hung = rig(motor_gain=(1.15, 0.85, 1.15, 0.85))
    t = np.arange(256) / 256 * 0.1
    w = 2 * pi * 10 * np.array([1, 2, 3])
    waves = 1e-4 * (np.cos(w * t[:, None]) @ [1, 1, 1])[:, None] * [1, -1, 2]
    cycle, state = PlateCycle.from_samples(0.1, waves), PlateState.at_rest()
    for _ in range(30):
        motion, state = realise(hung, state, cycle)
    requested, got = (
        np.fft.rfft(motor_record(RIG, m, t)[2], axis=0)[1:4]
        for m in (realise(RIG, PlateState.at_rest(), cycle)[0], motion)
    )
    assert np.linalg.norm(got - requested) > 0.5 * np.linalg.norm(requested)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffness": np.zeros((3, 3))}, "leave the plate free to drift"),
        ({"stiffness": np.diag([9e4, 9e4, 0])}, r"free to drift, required: one of them holds it"),
        ({"servo": (3e4, 0.0), "motor_bandwidth_hz": 100.0}, "100 Hz is unstable: .* allowed: a"),
    ],
)
def test_a_plate_that_is_not_held_is_refused(changes, message):
    with pytest.raises(PlateError, match=message):
        realise(rig(**changes), PlateState.at_rest(), wild())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((np.zeros(3), [0, np.nan, 0], np.zeros(4)), "plate's twist is .*nan.*, allowed: 3 finite"),
        ((np.zeros(2), np.zeros(3), np.zeros(4)), "plate's pose is .*, allowed: 3 finite numbers"),
        ((np.zeros(3), np.zeros(3), [0, 0, 0, np.inf]), "plate's force is .*, allowed: 4 finite"),
    ],
)
def test_an_invalid_state_is_refused(values, message):
    with pytest.raises(PlateError, match=message):
        PlateState(*values)
