"""Pictures and films for a camera."""

import cv2
import numpy as np
import pytest

from plate_core import load_rig
from plate_vision import ImageError, make_vision
from plate_vision.pictures import read_pictures, rig_of_picture


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
    assert rig_of_picture(rig, (640, 480)) is rig
    vision = make_vision(rig_of_picture(rig, (1200, 900)))
    assert vision.size_px == (1200, 900)
    corners = np.array([[-0.5, 899.5], [1199.5, -0.5], [599.5, 449.5]])
    assert np.allclose(vision.calibration.to_home(corners), [[-0.3, -0.225], [0.3, 0.225], [0, 0]])
