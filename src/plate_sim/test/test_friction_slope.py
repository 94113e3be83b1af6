"""Friction that changes with the slip, against closed forms of a part that comes to rest alone."""

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError
from plate_sim import Disturbances, simulate, simulate_bodies
from plate_sim.friction import disc, polygon
from plate_sim.plate import Ground

MU, G = 0.25, 9.81
MU_G = MU * G
RADIUS = 0.008
SQUARE = polygon([[-0.01, -0.01], [0.01, -0.01], [0.01, 0.01], [-0.01, 0.01]])


def stopping(speed, slope):
    """Time [s] and way [m] to rest of a point: v' = -mu g (1 + k v), or -mu g/(1 + c v)."""
    if slope > 0:
        return (
            np.log1p(slope * speed) / (slope * MU_G),
            (speed / slope - np.log1p(slope * speed) / slope**2) / MU_G,
        )
    c = -slope
    return (speed + c * speed**2 / 2) / MU_G, (speed**2 / 2 + c * speed**3 / 3) / MU_G


def run(part, velocity, spin, slope, time, cycle=None):
    """The part after a time [s], from (0, 0)."""
    return simulate_bodies(
        cycle or PlateCycle.rest(time), part, [[0, 0]], 0, [velocity], spin, MU, G,
        samples=0, ground=Ground(friction_slope=slope),
    )  # fmt: skip


@pytest.mark.parametrize("part", [disc(RADIUS), SQUARE], ids=["disc", "square"])
@pytest.mark.parametrize("slope", [3.0, 0.4, -0.4, -3.0])
def test_a_part_alone_comes_to_rest_when_and_where_the_closed_form_says(part, slope):
    heading = np.array([0.6, 0.8])
    time, way = stopping(0.5, slope)
    ends = run(part, 0.5 * heading, 0, slope, 1.2 * time)
    np.testing.assert_allclose(ends.position[-1, 0], way * heading, atol=2e-7)
    assert not ends.velocity.any()
    before = run(part, 0.5 * heading, 0, slope, 0.9 * time).velocity[-1, 0] @ heading
    # What is left of the way is what the rest of the velocity takes.
    left = way - run(part, 0.5 * heading, 0, slope, 0.9 * time).position[-1, 0] @ heading
    assert left == pytest.approx(stopping(before, slope)[1], abs=2e-7)
    assert stopping(before, slope)[0] == pytest.approx(0.1 * time, rel=1e-3)


@pytest.mark.parametrize("slope", [3.0, -3.0])
def test_a_disc_that_turns_in_place_feels_the_root_mean_square_of_its_slip(slope):
    """I w' = -2/3 mu m g R share(w R/sqrt 2), I = m R^2/2: a point with 4/3 sqrt(1/2) mu g."""
    spin = 60.0
    time = stopping(spin * RADIUS / np.sqrt(2), slope)[0] / (4 / 3 / np.sqrt(2))
    assert run(disc(RADIUS), [0, 0], spin, slope, 1.01 * time).spin[-1, 0] == 0
    assert run(disc(RADIUS), [0, 0], spin, slope, 0.99 * time).spin[-1, 0] > 0.1


def shaken(gamma):
    """Sine along x at 20 Hz with peak acceleration gamma mu g."""
    t = np.arange(64) / 64
    pose = np.zeros((64, 3))
    pose[:, 0] = -gamma * MU_G / (40 * np.pi) ** 2 * np.sin(2 * np.pi * t)
    return PlateCycle.from_samples(0.05, pose)


@pytest.mark.parametrize("slope", [5.0, -5.0])
def test_a_part_rides_on_what_it_does_not_slip(slope):
    cycle = shaken(0.98)
    ends = run(disc(RADIUS), cycle.twist(0.0)[0, :2], 0, slope, None, cycle)
    np.testing.assert_allclose(ends.position[-1], 0, atol=1e-12)


def test_a_slope_of_next_to_nothing_changes_next_to_nothing():
    """Discs are then moved one by one, not together: by the same law."""
    cycle = shaken(30)
    with_it, without = (
        run(disc(RADIUS), [0.2, 0.3], 20, slope, None, cycle) for slope in (1e-9, 0)
    )
    np.testing.assert_allclose(with_it.position, without.position, atol=1e-7)
    np.testing.assert_allclose(with_it.spin, without.spin, atol=1e-3)


def test_what_is_out_of_range_or_not_there_is_refused():
    with pytest.raises(PlateError, match=r"friction_slope is 6\.0, allowed: -5 to 5"):
        Ground(friction_slope=6.0)
    assert Disturbances(friction_slope=-1).ground == Ground(friction_slope=-1)
    with pytest.raises(PlateError, match="friction_slope is 1, allowed: 0 for point parts"):
        simulate(PlateCycle.rest(0.1), [[0, 0]], [[0, 0]], MU, ground=Ground(friction_slope=1))
