"""How warm the motors are, against the solution of its equation."""

import numpy as np
import pytest

from plate_core import load_rig
from plate_driver.setpoints.thermal import AMBIENT_C, ThermalState

RIG = load_rig()


def test_heat_follows_its_equation():
    limits = RIG.limits
    heat = ThermalState().under(np.array([0.5, 1.0, 2.0, 0.0]))
    later = heat.at_time(RIG, limits.thermal_time_s)
    np.testing.assert_allclose(later.rise, (1 - np.exp(-1)) * heat.load)
    steps = ThermalState().under(heat.load)
    for k in range(1, 11):
        steps = steps.at_time(RIG, k * limits.thermal_time_s / 10)
    np.testing.assert_allclose(steps.rise, later.rise)
    assert later.celsius(RIG) == pytest.approx(
        AMBIENT_C + 2 * (1 - np.exp(-1)) * limits.heat_rise_k
    )
    # The clock was put back: nothing has happened yet.
    np.testing.assert_array_equal(later.at_time(RIG, 0.0).rise, later.rise)


@pytest.mark.parametrize("rise", [0.0, 0.5, 0.999, 1.0])
def test_the_allowed_load_leads_exactly_to_the_limit(rise):
    heat = ThermalState(rise=np.full(4, rise))
    room = heat.allowed_load(RIG, 3.0)
    assert np.all(room >= 1)
    np.testing.assert_allclose(heat.under(room).at_time(RIG, 3.0).rise, 1.0)
