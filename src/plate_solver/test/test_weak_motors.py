"""Weak or hot motors: both methods stay within their limits, on both maps."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from plate_core import CycleError, Rig, load_rig
from plate_core.motion import usage
from plate_core.rig import PEAK_OVER_RMS, Suspension, mass_matrix, modal_matrices
from plate_solver import Goal, Limits, RotationSolver, SinusoidSolver
from plate_solver._kernels import ramps
from plate_solver.limits import HEADROOM, limit_use, within_limits
from plate_solver.sinusoids import SinusoidFamily, family_on_grid, sinusoid_basis


def with_motors(force, continuous, **facts) -> Rig:
    rig = load_rig()
    limits = replace(rig.limits, force=force, continuous_force=continuous)
    return replace(rig, limits=limits, **facts)


def hung() -> Suspension:
    mass = mass_matrix(2.0, 0.075)
    damping, stiffness = modal_matrices(mass, np.full(3, 18.0), np.full(3, 0.03))
    return Suspension(mass, damping, stiffness, (1.0, 1.0, 1.0))


RIGS = {
    "20 N": with_motors(20.0, 10.0),
    "10 N": with_motors(10.0, 5.0),
    "hot": with_motors(60.0, 6.0),
    "hung": with_motors(25.0, 12.0, suspension=hung()),
}
WEAK = pytest.mark.parametrize("name", RIGS)
SOLVERS = pytest.mark.parametrize("solver", [RotationSolver, SinusoidSolver])


def goal(rig: Rig, seed: int) -> Goal:
    rng = np.random.default_rng(seed)
    position = np.array([[-0.15, -0.05], [0.12, 0.06], [0.02, -0.09]])
    size = 0.2 * rig.friction.accel * 0.15**2
    return Goal(
        position=position + rng.uniform(-0.02, 0.02, position.shape),
        velocity=np.zeros((3, 2)),
        displacement=rng.uniform(-size, size, position.shape),
        tolerance=np.zeros((3, 2)),
        friction_accel=np.full(3, rig.friction.accel),
        part_rotations=None,
    )


@WEAK
@SOLVERS
def test_motions_are_designed_within_force_and_heat(name, solver):
    rig = RIGS[name]
    for seed in range(3):
        found = solver(rig, seed=seed, restarts=1)
        for cycle in (
            found.steer(goal(rig, seed), 2e-5, 1e-4).cycle,
            found.solve(goal(rig, seed).position, goal(rig, seed).displacement * 60).cycle,
        ):
            used = usage(rig, cycle)
            assert used.overall <= 1, "the driver would have to scale it"
            assert used.overall > 0.6, "the motors are not used"


@pytest.mark.parametrize("solver", [RotationSolver, SinusoidSolver])
def test_forces_peak_at_a_multiple_of_their_root_mean_square(solver):
    """`PEAK_OVER_RMS`, of the motor that has the highest peak."""
    rig, ratios = with_motors(20.0, 20.0), []
    for seed in range(8):
        cycle = solver(rig, seed=seed, restarts=1).steer(goal(rig, seed), 2e-5, 1e-4).cycle
        used = usage(rig, cycle)
        rms = np.sqrt(np.max(used.thermal_load)) * rig.limits.continuous_force
        ratios.append(used.force / rms)
    assert np.min(ratios) > 0.97 * PEAK_OVER_RMS
    assert np.median(ratios) < 1.5 * PEAK_OVER_RMS


@WEAK
def test_limits_of_the_rig_are_used(name):
    rig = RIGS[name]
    weight = np.array([2.0, 1, 1, 1, 1])
    limits = Limits.of(rig, 1.0)
    limited = SinusoidFamily(sinusoid_basis(3, 0.1, True, 200), Limits.of(rig))
    for seed in range(5):
        cycle = limited.cycle(limited.random(np.random.default_rng(seed)))
        points = (cycle.control_points(order) for order in range(3))
        used = limit_use(*points, weight, limits, False)
        assert used == pytest.approx(usage(rig, cycle).overall, rel=1e-2)
        assert used >= usage(rig, cycle).overall * (1 - 1e-5)


@WEAK
def test_a_cycle_in_motion_and_its_tail_keep_the_limits(name):
    rig, plate = RIGS[name], np.zeros((3, 3))
    full = Limits.of(rig, 1.0)
    for seed in range(6):
        family = family_on_grid(8, 0.1, Limits.of(rig), free_end=True, plate=plate)
        theta = 2 * family.random(np.random.default_rng(seed))
        resting = partial(family.cycle, 0 * theta)
        cycle = within_limits(family.cycle(theta), full, resting)
        assert 0.8 < usage(rig, cycle).overall <= 1
        assert usage(rig, resting()).overall <= 1
        plate = cycle.state(-1)
    far = family_on_grid(8, 0.1, Limits.of(rig), free_end=True, plate=100 * plate)
    with pytest.raises(CycleError, match="cannot stop within the rig's limits"):
        within_limits(far.cycle(theta), full, lambda: far.cycle(0 * theta))


@SOLVERS
def test_motors_above_the_headroom_need_no_force_check(solver):
    """At `HEADROOM`, by heat and by peak force: 1 m/s2 of the corners takes 1 N at most."""
    max_force = HEADROOM * load_rig().limits.accel
    for force, continuous in ((2 * max_force, max_force / PEAK_OVER_RMS), (max_force, max_force)):
        rig = with_motors(1.001 * force, 1.001 * continuous)
        assert not Limits.of(rig).forceful
        assert Limits.of(with_motors(0.999 * force, 0.999 * continuous)).forceful
        for seed in range(4):
            cycle = solver(rig, seed=seed, restarts=1).steer(goal(rig, seed), 2e-5, 1e-4).cycle
            assert usage(rig, cycle).overall <= 1


def test_strong_motors_change_nothing():
    rig, rng = load_rig(), np.random.default_rng(0)
    limits = Limits.of(rig)
    assert not limits.forceful
    state = rng.normal(size=(3, 50, 3)) * np.array([1e-3, 0.1, 20.0])[:, None, None]
    plain = limit_use(*state, np.ones(1), limits, False)
    assert plain == limit_use(*state, np.ones(1), limits._replace(forceful=True), False)


@WEAK
def test_slopes_are_derivatives_of_the_excess(name, check_excess_slopes):
    limits = Limits.of(RIGS[name])
    assert limits.forceful
    check_excess_slopes(limits)


def test_slopes_of_ramps_that_forces_limit():
    limits, rng = Limits.of(RIGS["20 N"]), np.random.default_rng(1)
    loads = limits.accel * limits.loads[2]
    turns = 0.2 * rng.normal(size=(4, 3))
    half = np.array([0.3, 0.15])
    length, slope = ramps(turns, half, loads, limits.accel)
    assert np.all(length > 2 * ramps(turns, half, np.empty((0, 3)), limits.accel)[0])
    step = 1e-7
    for j in range(4):
        for c in range(3):
            moved = turns.copy()
            moved[j, c] += step
            by = (ramps(moved, half, loads, limits.accel)[0] - length) / step
            np.testing.assert_allclose(by[j : j + 2], [slope[j, c], -slope[j + 1, c]], atol=1e-5)
