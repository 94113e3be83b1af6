"""Polygon paths: constant speed, corners, laps, ends."""

import numpy as np
import pytest

from plate_core.scenario import PathTask
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
