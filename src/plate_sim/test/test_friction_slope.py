"""Friction that changes with the slip, or with a plate that moves up and down, against closed forms
of a part alone."""

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


def run(part, velocity, spin, slope, time, cycle=None, heave=0.0, samples=0):
    """The part after a time [s], from (0, 0)."""
    return simulate_bodies(
        cycle or PlateCycle.rest(time), part, [[0, 0]], 0, [velocity], spin, MU, G,
        samples=samples, ground=Ground(friction_slope=slope, heave=heave),
    )  # fmt: skip


@pytest.mark.parametrize("part", [disc(RADIUS), SQUARE], ids=["disc", "square"])
@pytest.mark.parametrize("slope", [3.0, 0.4, -0.4, -3.0])
def test_a_single_part_comes_to_rest_as_in_the_closed_form(part, slope):
    heading = np.array([0.6, 0.8])
    time, way = stopping(0.5, slope)
    ends = run(part, 0.5 * heading, 0, slope, 1.2 * time)
    np.testing.assert_allclose(ends.position[-1, 0], way * heading, atol=2e-7)
    assert not ends.velocity.any()
    before = run(part, 0.5 * heading, 0, slope, 0.9 * time).velocity[-1, 0] @ heading
    # The remaining distance is that of the remaining velocity.
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


@pytest.mark.parametrize("part", [disc(RADIUS), SQUARE], ids=["disc", "square"])
def test_a_part_that_slides_on_is_braked_by_its_changing_weight(part):
    """v' = -mu (g + r a): the part loses mu g t, and mu r times the plate's gain."""
    cycle, heave = shaken(30), 0.08
    ends = run(part, [3, 0], 0, 0, None, cycle, heave, samples=16)
    gained = cycle.twist(ends.time)[:, 0] - cycle.twist(0.0)[0, 0]
    assert np.ptp(gained) > 0.5
    expected = 3 - MU_G * ends.time - MU * heave * gained
    np.testing.assert_allclose(ends.velocity[:, 0, 0], expected, atol=2e-6)


@pytest.mark.parametrize("heave", [0.1, -0.1])
def test_a_part_rides_where_its_weight_is_least(heave):
    """mu (g - r a) holds it up to mu g/(1 + mu r), on whichever side of the swing."""
    maximum = 1 / (1 + MU * abs(heave))
    for gamma, rides in ((0.998 * maximum, True), (1.002 * maximum, False)):
        cycle = shaken(gamma)
        start = cycle.twist(0.0)[0, :2]
        ends = run(disc(RADIUS), start, 0, 0, None, cycle, heave)
        assert (np.abs(ends.position[-1]).max() < 1e-12) == rides


@pytest.mark.parametrize("name", ["slope", "heave"])
def test_tiny_values_of_both_effects_change_the_motion_little(name):
    """Discs are then moved one by one, not together: by the same law."""
    cycle = shaken(30)
    with_it, without = (
        run(disc(RADIUS), [0.2, 0.3], 20, time=None, cycle=cycle, **{"slope": 0.0, name: value})
        for value in (1e-9, 0)
    )
    np.testing.assert_allclose(with_it.position, without.position, atol=1e-7)
    np.testing.assert_allclose(with_it.spin, without.spin, atol=1e-3)


def test_ground_effects_out_of_range_or_not_modelled_are_refused():
    with pytest.raises(PlateError, match=r"friction_slope is 6\.0, allowed: -5 to 5"):
        Ground(friction_slope=6.0)
    assert Disturbances(friction_slope=-1).ground == Ground(friction_slope=-1)
    with pytest.raises(PlateError, match=r"heave is -0\.2, allowed: -0\.1 to 0\.1"):
        Ground(heave=-0.2)
    for name, value in (("friction_slope", 1), ("heave", 0.1)):
        with pytest.raises(PlateError, match=f"{name} is {value}, allowed: 0 for point parts"):
            simulate(PlateCycle.rest(0.1), [[0, 0]], [[0, 0]], MU, ground=Ground(**{name: value}))
