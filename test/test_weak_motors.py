"""The closed loop on a plate whose motors are weak: nothing lost, force and heat kept, judged by
Newton's law on the motions that were sent."""

from dataclasses import replace

import numpy as np
import pytest
from short_task import FEW_STARTS, with_few

from plate_bringup.loop import Setup, run
from plate_core import Rig, load_rig
from plate_core.rig import CYCLE_HZ
from plate_solver import RotationSolver, SinusoidSolver

SAMPLES = 400


def forces(rig: Rig, cycle) -> np.ndarray:
    """Forces (n, 4) [N] of least squares that accelerate a uniform plate as the cycle does."""
    point = np.array([motor.point for motor in rig.motors])
    way = np.array([motor.direction for motor in rig.motors])
    turn = point[:, 0] * way[:, 1] - point[:, 1] * way[:, 0]
    plate = rig.plate
    inertia = plate.mass_kg * (plate.length_m**2 + plate.width_m**2) / 12
    accel = cycle.accel((np.arange(SAMPLES) + 0.5) / SAMPLES * cycle.period)
    wrench = accel * [plate.mass_kg, plate.mass_kg, inertia]
    return np.linalg.lstsq(np.column_stack([way, turn]).T, wrench.T, rcond=None)[0].T


@pytest.mark.parametrize(("method", "effort"), [("sinusoids", FEW_STARTS), ("rotations", {})])
def test_parts_are_sorted_within_force_and_heat(method, effort):
    rig, peak, continuous = load_rig(), 10.0, 5.0
    limits = replace(rig.limits, force=peak, continuous_force=continuous, thermal_time_s=1.0)
    rig = replace(rig, limits=limits)
    warm = np.zeros(4)
    max_force = 0.0
    moments = []
    for moment in run(Setup(with_few("sort_4"), 3, method, effort=effort), rig):
        moments.append(moment)
        force = forces(rig, moment.result.cycle)
        max_force = max(max_force, float(np.max(np.abs(force))))
        load = np.mean(force**2, axis=0) / continuous**2
        warm = load + (warm - load) * np.exp(-moment.result.cycle.period / limits.thermal_time_s)
        assert np.max(warm) <= 1
        assert not moment.scaled, "the solver knew better than the driver"
    assert 0.8 * peak < max_force <= peak
    assert moments[-1].progress.phase == "done"
    assert moments[-1].world.dropped == 0


@pytest.mark.parametrize("solver", [RotationSolver, SinusoidSolver])
def test_reported_frequencies_are_those_of_the_cycles(solver):
    """The values of check_rig for stroke and speed apply to waves that the solvers produce."""
    made, kinds = solver(load_rig()), (False, True)
    periods = [made.steering_period(n, multi_cycle=kind) for n in range(1, 8) for kind in kinds]
    assert min(1 / period for period in periods) == pytest.approx(CYCLE_HZ[0])
    assert max(4 / period for period in periods) >= CYCLE_HZ[1]
