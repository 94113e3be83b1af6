"""Camera files against one that ROS's camera_calibration wrote, and there and back; pictures."""

import cv2
import numpy as np
import pytest
import yaml

from plate_core import load_rig
from plate_vision import CalibrationError, ImageError, Lens, make_vision
from plate_vision.camera import load_lens, read_pictures, rig_of_picture, save_lens

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
        return load_lens(path, (640, 480))

    return load


def test_a_file_of_the_usual_form(load):
    lens = load(FILE)
    assert lens.matrix[0].tolist() == [438.783367, 0, 305.593336]
    assert lens.distortion.tolist() == [-0.361976, 0.110510, 0.001014, 0.000505, 0]


@pytest.mark.parametrize("count", [4, 5, 8])
def test_there_and_back(tmp_path, rng, count):
    lens = Lens(
        np.array([[612.3, 0, 320.1], [0, 1 / 3e-3, 0.1], [0, 0, 1]]), rng.normal(size=count)
    )
    path = tmp_path / "camera.yaml"
    save_lens(path, "plate", (1280, 720), lens)
    again = load_lens(path, (1280, 720))
    assert np.array_equal(again.matrix, lens.matrix)
    assert np.array_equal(again.distortion, lens.distortion)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert list(data) == list(yaml.safe_load(FILE))  # every key that the parsers want, in order
    assert data["camera_name"] == "plate"
    assert data["projection_matrix"]["data"][:4] == [612.3, 0, 320.1, 0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("image_width: 640", "image_width: wide", "image_width is 'wide', allowed"),
        ("image_width: 640", "image_width: 641", "641 x 480 px, allowed: 640 x 480"),
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
        assert len(load(FILE.replace(old, new)).distortion) == 4
        return
    with pytest.raises(CalibrationError, match=words):
        load(FILE.replace(old, new))


def test_pictures_come_by_their_names(tmp_path):
    for name, grey in (("b.PNG", 20), ("a.png", 10), ("c.bmp", 30)):
        cv2.imwrite(str(tmp_path / name), np.full((6, 8), grey, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture", encoding="utf-8")
    seen = [(name, int(pixels[0, 0, 0])) for name, pixels in read_pictures(tmp_path)]
    assert seen == [("a.png", 10), ("b.PNG", 20), ("c.bmp", 30)]
    ((name, pixels),) = read_pictures(tmp_path / "a.png")
    assert name == "a.png"
    assert pixels.shape == (6, 8, 3)


def test_a_film(tmp_path):
    path = tmp_path / "film.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    if not film.isOpened():
        pytest.skip("OpenCV cannot write films here")
    for grey in (50, 100, 150):
        film.write(np.full((48, 64, 3), grey, np.uint8))
    film.release()
    frames = list(read_pictures(path))
    assert len(frames) == 3
    assert [round(float(pixels.mean()), -1) for _, pixels in frames] == [50, 100, 150]


@pytest.mark.parametrize("name", ["none.png", "empty", "damaged.png", "notes.txt"])
def test_what_cannot_be_read_is_told(tmp_path, name):
    (tmp_path / "empty").mkdir()
    for file in ("damaged.png", "notes.txt"):
        (tmp_path / file).write_text("no picture", encoding="utf-8")
    with pytest.raises(ImageError, match=r"allowed: |no pictures"):
        list(read_pictures(tmp_path / name))


def test_a_picture_of_another_size_is_the_whole_plate():
    rig = load_rig()
    assert rig_of_picture(rig, (640, 480)) == (rig, "")
    taken, text = rig_of_picture(rig, (1200, 900))
    assert text.startswith("1200 x 900 px, not 640 x 480 px as the rig's camera: taken for a view")
    assert "plate of 0.6 x 0.45 m that fills it; the rig's is 0.6 x 0.3 m. If this is" in text
    vision = make_vision(taken)
    assert vision.region.size_px == (1200, 900)
    corners = np.array([[-0.5, 899.5], [1199.5, -0.5], [599.5, 449.5]])
    assert np.allclose(vision.calibration.to_home(corners), [[-0.3, -0.225], [0.3, 0.225], [0, 0]])
