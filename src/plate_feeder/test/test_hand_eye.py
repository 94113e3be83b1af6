"""The plate in the robot's frame."""

import math

import numpy as np
import pytest

from plate_feeder import ReadyPart
from plate_feeder.hand_eye import HandEye, HandEyeError, fit_hand_eye, load_hand_eye

CORNERS = np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]])


def moved(points, angle, x, y):
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]]) + (x, y)


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("angle", [0.0, 2.0, -3.1])
def test_a_motion_is_found_again(angle, count):
    points = CORNERS[:count]
    found = fit_hand_eye("base", points, moved(points, angle, 0.4, -0.3))
    assert (found.angle, found.x, found.y) == pytest.approx((angle, 0.4, -0.3))
    assert found.residual_m < 1e-12
    part = found.part(ReadyPart("black_1", *CORNERS[0], angle=0.5))
    assert (part.x, part.y) == pytest.approx(tuple(moved(CORNERS[:1], angle, 0.4, -0.3)[0]))
    assert math.remainder(part.angle - 0.5 - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_the_fitted_motion_has_the_smallest_error():
    rng = np.random.default_rng(1)
    robot = moved(CORNERS, 0.7, 0.1, 0.2) + rng.normal(0, 2e-4, CORNERS.shape)
    found = fit_hand_eye("base", CORNERS, robot)

    def squares(angle, x, y):
        return np.sum((moved(CORNERS, angle, x, y) - robot) ** 2)

    best = squares(found.angle, found.x, found.y)
    away = np.hypot(*(moved(CORNERS, found.angle, found.x, found.y) - robot).T)
    assert found.residual_m == pytest.approx(away.max())
    for change in (*np.eye(3), *-np.eye(3)):
        assert squares(*(np.array([found.angle, found.x, found.y]) + 1e-5 * change)) > best


def test_the_covariance_turns_with_the_plate():
    covariance = np.diag([4e-8, 1e-8, 1e-4])
    part = ReadyPart("black_1", 0.0, 0.0, 0.0, tuple(covariance.ravel()))
    turned = np.reshape(HandEye("base", math.pi / 2).part(part).covariance, (3, 3))
    np.testing.assert_allclose(turned, np.diag([1e-8, 4e-8, 1e-4]), atol=1e-20)
    unknown = HandEye("base", 1.0).part(ReadyPart("black_1", 0.0, 0.0))
    assert unknown.covariance[0] == -1


@pytest.mark.parametrize(
    ("plate", "robot", "named"),
    [
        (CORNERS[:1], CORNERS[:1], "2 or more"),
        (0.1 * CORNERS[1:3], CORNERS[1:3], "is 20.0 mm, allowed: "),
        (CORNERS[[0, 0]], CORNERS[[0, 1]], "is 0.0 mm, allowed: "),
        (CORNERS, CORNERS + 0.01 * np.eye(4)[:, :2], r"points\[\d\]"),
        (CORNERS, 1.02 * CORNERS, "points"),
        (CORNERS, moved(CORNERS * (1, -1), 1.0, 0.3, 0.1), "z of the robot's frame"),
    ],
)
def test_points_that_do_not_fit_are_refused(plate, robot, named):
    with pytest.raises(HandEyeError, match=named):
        fit_hand_eye("base", plate, robot)


def test_a_file_is_read(tmp_path):
    path = tmp_path / "hand_eye.yaml"
    path.write_text(
        "frame: base\n"
        "points:\n"
        "  - {plate_m: [-0.2, 0], robot_m: [0.5, -0.2]}\n"
        "  - {plate_m: [0.2, 0], robot_m: [0.5, 0.2]}\n"
    )
    found = load_hand_eye(path)
    assert (found.frame, found.angle) == ("base", pytest.approx(math.pi / 2))
    assert (found.x, found.y) == pytest.approx((0.5, 0.0))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("frame: base\n", "points"),
        ("frame: base\npoints: []\n", "2 or more"),
        ("frame: base\npoints: [{plate_m: [0, 0]}]\n", "robot_m"),
        ("frame: base\npoints: [{plate_m: [0, 0], robot_m: [.nan, 0]}]\n", "robot_m"),
        ("frame: 3\npoints: []\n", "frame"),
        ("frame: base\npoints: []\nunit: mm\n", "unit"),
    ],
)
def test_a_wrong_file_is_refused_and_named(tmp_path, text, named):
    path = tmp_path / "hand_eye.yaml"
    path.write_text(text)
    with pytest.raises(HandEyeError, match=named) as caught:
        load_hand_eye(path)
    assert "hand_eye.yaml" in str(caught.value)
