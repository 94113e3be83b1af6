"""Curves as polygons: on the circle or spline to a micrometre, in the right sense."""

import numpy as np
import pytest

from plate_core.tasks.curves import SAGITTA_M, circle_points, spline_points


def polygon_area(point: np.ndarray) -> float:
    x, y = point.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


@pytest.mark.parametrize("leftwards", [True, False])
@pytest.mark.parametrize("radius", [0.001, 0.06, 0.3])
def test_a_circle_is_a_circle_to_a_micrometre(leftwards, radius):
    point = circle_points((0.1, -0.02), radius, np.pi / 2, leftwards)
    middle = (point + np.roll(point, -1, axis=0)) / 2
    assert point[0] == pytest.approx([0.1, -0.02 + radius])
    assert np.hypot(*(point - [0.1, -0.02]).T) == pytest.approx(np.full(len(point), radius))
    assert np.max(radius - np.hypot(*(middle - [0.1, -0.02]).T)) <= 1.001 * SAGITTA_M
    area = polygon_area(point) * (1 if leftwards else -1)
    assert area == pytest.approx(np.pi * radius**2, rel=3e-3)


def test_a_spline_goes_through_its_points_and_bends_smoothly():
    given = np.array([[0.16, 0.07], [0.23, 0.05], [0.20, 0.0], [0.22, -0.06], [0.14, -0.06]])
    for closed in (False, True):
        point = spline_points(given, closed)
        gap = np.hypot(*(point[:, None] - given[None]).transpose(2, 0, 1))
        assert np.max(np.min(gap, axis=0)) < 1e-9
        round_ = np.vstack([point, point[:2]]) if closed else point
        step = np.diff(round_, axis=0)
        angle = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        assert np.max(np.abs(np.diff(angle))) < 0.1  # no corner, and none where it closes
        # Bends between chords estimate the arc's height over each chord.
        sagitta = np.abs(np.diff(angle)) * np.hypot(*step.T)[1:] / 8
        assert np.max(sagitta) < 2 * SAGITTA_M


def test_a_periodic_spline_through_a_circle_is_nearly_that_circle():
    angle = 2 * np.pi * np.arange(16) / 16
    point = spline_points(0.1 * np.column_stack([np.cos(angle), np.sin(angle)]), closed=True)
    # A cubic spline errs by about (h^4/384) x''''; h = 2 pi/16, so 6e-5 of the radius.
    assert np.hypot(*point.T) == pytest.approx(np.full(len(point), 0.1), abs=1e-5)


def test_a_straight_spline_is_a_line():
    point = spline_points(np.array([[0.0, 0.0], [0.1, 0.1], [0.3, 0.3]]), closed=False)
    assert point[:, 0] == pytest.approx(point[:, 1])
    assert np.all(np.diff(point[:, 0]) > 0)
    assert tuple(point[-1]) == pytest.approx((0.3, 0.3))
