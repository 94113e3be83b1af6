"""Rigs seen from elsewhere, against OpenCV's projection."""

import cv2
import numpy as np
import pytest

from plate_bringup.loop import Setup, with_settings, with_setup_camera
from plate_bringup.views import MARGIN_PX, view_from, with_height
from plate_core import PlateError, load_rig
from plate_core.rig import camera_position, rig_warnings


@pytest.mark.parametrize(("tilt", "towards"), [(0, 0), (25, 0), (25, 180), (40, -90), (15, 70)])
@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02, 1e-3, -1e-3, 0.0)])
def test_the_camera_is_where_it_is_set(tilt, towards, distortion):
    rig = view_from(
        load_rig(), tilt_deg=tilt, towards_deg=towards, focal_px=500, distance_m=0.9,
        distortion=distortion,
    )  # fmt: skip
    a, b = np.radians([tilt, towards])
    position = 0.9 * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])
    assert np.allclose(camera_position(rig), position, atol=1e-9)
    # OpenCV's camera there, whose rows look as its axis x without a part along z of plate_home.
    ahead = -position / 0.9
    right = np.array([1.0, 0, 0]) - ahead[0] * ahead
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1.0]])
    corners = np.column_stack([rig.plate.corners, np.zeros(4)])
    seen = cv2.projectPoints(
        corners, cv2.Rodrigues(rotation)[0], -rotation @ position, matrix,
        np.array(distortion or np.zeros(5)),
    )[0][:, 0]  # fmt: skip
    assert np.allclose(rig.camera.corners_px, seen, atol=1e-6)
    assert not [doubt for doubt in rig_warnings(rig, "camera") if doubt.impossible]


def test_as_near_as_shows_all_of_the_plate():
    rig = view_from(load_rig(), tilt_deg=25, focal_px=500)
    corners = np.array(rig.camera.corners_px)
    away = np.minimum(corners, [639, 479] - corners).min()
    assert away == pytest.approx(MARGIN_PX, abs=1e-6)


def test_a_camera_beside_the_plate_is_refused():
    with pytest.raises(PlateError, match=r"0\.2 m and a tilt of 60 degrees.* behind the camera"):
        view_from(load_rig(), tilt_deg=60, distance_m=0.2)


def test_settings_of_the_loop():
    rig = load_rig("shapes")
    settings = {"camera_tilt_deg": "25", "camera_focal_px": "500", "rig_height_m": "0.01"}
    seen = with_setup_camera(with_settings(Setup("sort_shapes"), settings), rig)
    expected = with_height(view_from(rig, tilt_deg=25, focal_px=500), 0.01)
    assert seen == expected
    assert seen.part_type("nut").height_m == seen.parts.height_m == 0.01
    assert with_setup_camera(Setup("sort_shapes"), rig) is rig
    with pytest.raises(PlateError, match="camera_tilt_deg is 70, allowed: 0 to 60"):
        with_settings(Setup("sort_10"), {"camera_tilt_deg": "70"})
