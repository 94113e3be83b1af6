"""Polygon paths: constant speed, corners, laps, ends."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plate_core.tasks import PathTask
from plate_planner.trajectory import PolygonPath

SQUARE = ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1))


def square(**changes) -> PolygonPath:
    values = {"label": "black", "waypoint": SQUARE, "speed": 0.02, "closed": True, "laps": 1.0}
    return PolygonPath.from_task(PathTask(**(values | changes)))


@pytest.mark.parametrize("laps", [1.0, 2.5])
def test_arc_length_grows_at_the_speed_even_round_corners(laps):
    path = square(laps=laps)
    t = np.linspace(0, path.duration, 20001)
    travelled = np.sum(np.hypot(*np.diff(path.position(t), axis=0).T))
    assert travelled == pytest.approx(0.02 * path.duration, rel=1e-3)  # steps cut the corners
    assert path.duration == pytest.approx(laps * 0.4 / 0.02)


def test_corners_are_met_on_time():
    assert square().position(np.array([0.0, 5.0, 10.0, 15.0, 20.0])) == pytest.approx(
        np.array([*SQUARE, SQUARE[0]]), abs=1e-12
    )


def test_velocity_is_the_derivative_of_position_between_corners():
    path, step = square(laps=2.0), 1e-4
    t = np.arange(0.3, path.duration, 0.5)  # corners are at multiples of 5 s
    difference = (path.position(t + step) - path.position(t - step)) / (2 * step)
    assert path.velocity(t) == pytest.approx(difference, abs=1e-9)
    assert np.hypot(*path.velocity(t).T) == pytest.approx(0.02)


def test_it_rests_before_the_start_and_after_the_end():
    path = square(closed=False)
    assert path.duration == pytest.approx(15.0)
    for t, corner in ((-1.0, SQUARE[0]), (15.0 + 1e-9, SQUARE[-1]), (99.0, SQUARE[-1])):
        assert path.position(t) == pytest.approx(np.array(corner))
        assert path.velocity(t) == pytest.approx(np.zeros(2))


def test_a_corner_belongs_to_the_edge_that_begins_there():
    assert square().velocity(0.0) == pytest.approx(np.array([0.02, 0.0]))
    assert square().velocity(5.0 + 1e-9) == pytest.approx(np.array([0.0, 0.02]))


def test_laps_are_counted_when_complete():
    path = square(laps=2.5)
    assert [path.lap(t) for t in (-1.0, 0.0, 19.9, 20.0, 40.0, 50.0, 99.0)] == [0, 0, 0, 1, 2, 2, 2]
    assert path.position(99.0) == pytest.approx(np.array([0.1, 0.1]))


PROFILE = ((0.0, 0.002), (0.25, 0.02), (0.6, 0.02), (1.0, 0.005))


@pytest.mark.parametrize("laps", [1.0, 2.25])
def test_a_speed_profile_is_what_an_integrator_makes_of_it(laps):
    path = square(profile=PROFILE, laps=laps)
    share, speed = np.array(PROFILE).T
    ran = solve_ivp(
        lambda t, s: np.interp(np.mod(s / path.length, 1), share, speed),
        (0, path.duration), [0.0], rtol=1e-9, atol=1e-12, max_step=0.05, dense_output=True,
    )  # fmt: skip
    assert ran.y[0, -1] == pytest.approx(laps * path.length, abs=2e-5)
    t = np.linspace(0.01, path.duration * 0.999, 500)
    corner = np.vstack([path.corner[:-1]] * 3 + [path.corner[:1]])
    arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
    expected = np.column_stack([np.interp(ran.sol(t)[0], arc, axis) for axis in corner.T])
    assert path.position(t) == pytest.approx(expected, abs=2e-5)


def test_velocity_follows_the_profile_and_is_the_derivative():
    path = square(profile=PROFILE)
    step = 1e-4
    t = np.linspace(0.5, path.duration - 0.5, 41)
    difference = (path.position(t + step) - path.position(t - step)) / (2 * step)
    clear = np.min(np.abs(path._along(t)[:, None] - path.arc), axis=1) > 1e-4
    assert np.sum(clear) > 30
    assert path.velocity(t)[clear] == pytest.approx(difference[clear], abs=1e-7)
    assert np.hypot(*path.velocity(0.0)) == pytest.approx(0.002)


def test_a_flat_profile_is_a_constant_speed():
    flat, plain = square(profile=((0.0, 0.02), (1.0, 0.02)), laps=2.5), square(laps=2.5)
    t = np.linspace(-1, 60, 300)
    assert flat.duration == pytest.approx(plain.duration)
    assert flat.position(t) == pytest.approx(plain.position(t), abs=1e-12)
