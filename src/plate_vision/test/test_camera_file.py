"""Camera files against one that ROS's camera_calibration wrote, and there and back."""

import numpy as np
import pytest
import yaml

from plate_vision import CalibrationError, Lens
from plate_vision.camera_file import CameraFile, load_camera, save_camera

FILE = """
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000,
         0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.6, 0, 322.8, 0, 0, 393.6, 241.1, 0, 0, 0, 1, 0]
"""


@pytest.fixture
def load(tmp_path):
    def load(text):
        path = tmp_path / "camera.yaml"
        path.write_text(text, encoding="utf-8")
        return load_camera(path)

    return load


def test_a_file_of_the_usual_form(load):
    camera = load(FILE)
    assert camera.name == "narrow_stereo"
    assert camera.size_px == (640, 480)
    assert camera.lens.matrix[0].tolist() == [438.783367, 0, 305.593336]
    assert camera.lens.distortion.tolist() == [-0.361976, 0.110510, 0.001014, 0.000505, 0]


@pytest.mark.parametrize("count", [4, 5, 8])
def test_there_and_back(tmp_path, rng, count):
    lens = Lens(
        np.array([[612.3, 0, 320.1], [0, 1 / 3e-3, 0.1], [0, 0, 1]]), rng.normal(size=count)
    )
    path = tmp_path / "camera.yaml"
    save_camera(path, CameraFile("plate", (1280, 720), lens))
    again = load_camera(path)
    assert (again.name, again.size_px) == ("plate", (1280, 720))
    assert np.array_equal(again.lens.matrix, lens.matrix)
    assert np.array_equal(again.lens.distortion, lens.distortion)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert list(data) == list(yaml.safe_load(FILE))  # every key that the parsers want, in order
    assert data["projection_matrix"]["data"][:4] == [612.3, 0, 320.1, 0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("image_width: 640", "image_width: wide", "image_width is 'wide', allowed"),
        ("plumb_bob", "equidistant", "'equidistant', allowed: one of plumb_bob, rational"),
        ("cols: 5\n  data: [-0.361976, ", "cols: 4\n  data: [", None),
        ("cols: 5", "cols: 6", "data is .*allowed: 6 numbers"),
        ("plumb_bob", "rational_polynomial", "5 distortion_coefficients, allowed: 8"),
        ("438.783367", ".nan", "camera_matrix: data is"),
        ("438.783367", "-1", "allowed: more than 0"),
        ("camera_matrix:\n  rows: 3", "camera_matrix:\n  rows: 1", "1 x 3, allowed: 3 x 3"),
        ("distortion_model: plumb_bob", "", "distortion_model is missing"),
    ],
)
def test_wrong_files_are_refused(load, old, new, words):
    if words is None:  # four parameters are allowed too
        assert len(load(FILE.replace(old, new)).lens.distortion) == 4
        return
    with pytest.raises(CalibrationError, match=words):
        load(FILE.replace(old, new))
