"""The device's plate on flexures, tick by tick, against the simulator's whole cycles."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_core.motion import motor_state
from plate_core.rig import Suspension, mass_matrix, modal_matrices
from plate_sim import PlateState
from plate_sim.device import SuspendedPlate
from plate_sim.plate import motor_record, realise

RIG = load_rig()
MASS = mass_matrix(RIG.plate.mass_kg, 0.075, (0.01, -0.005))
DAMPING, STIFFNESS = modal_matrices(MASS, np.full(3, 35.0), np.full(3, 0.03))
TICK_S = 1e-3


def swinging(period: float) -> PlateCycle:
    """A motion along all axes, at rest at both ends."""
    t = np.linspace(0, period, 41)
    w = 2 * np.pi / period
    axes = np.array([1e-3, -7e-4, 2e-3])
    states = [
        np.outer(wave, axes)
        for wave in ((1 - np.cos(w * t)), w * np.sin(w * t), w * w * np.cos(w * t))
    ]
    states[0][-1] = states[1][0] = states[1][-1] = 0
    return PlateCycle.from_knots(t, *states)


@pytest.mark.parametrize("bandwidth", [200.0, np.inf])
def test_sensors_measure_the_simulated_plate(bandwidth):
    hung = replace(
        RIG,
        suspension=Suspension(
            MASS, DAMPING, STIFFNESS, (0, 0, 1), (1.15, 0.85, 1.15, 0.85), bandwidth
        ),
    )
    plate, state, cycle = SuspendedPlate(hung, TICK_S), PlateState.at_rest(), swinging(0.1)
    t = TICK_S * np.arange(1, 101)
    q, qd, qdd = motor_state(RIG, cycle.pose(t), cycle.twist(t), cycle.accel(t))
    start = motor_state(RIG, cycle.pose(0), cycle.twist(0), cycle.accel(0))
    plate.moved(np.stack([row[0] for row in start]))  # the jump in acceleration is a tick's ramp
    # From the second cycle on both have the same past, except for that tick.
    for _ in range(30):
        motion, state = realise(hung, state, cycle)
        reported = np.array([plate.moved(np.stack(at)) for at in zip(q, qd, qdd, strict=True)])
    travel, _, accel = motor_record(hung, motion, t)
    # Both motions are far from the command, and equal except for the changed levers away from home.
    assert np.max(np.abs(travel - q)) > 2e-4
    np.testing.assert_allclose(reported[:, 0], travel, atol=0.01 * np.max(np.abs(travel)))
    np.testing.assert_allclose(reported[:, 1], accel, atol=0.01 * np.max(np.abs(accel)))
