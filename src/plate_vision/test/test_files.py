"""Camera files against one that ROS's camera_calibration wrote, and there and back; pictures."""

import contextlib
import re
import struct
import zlib

import cv2
import numpy as np
import pytest
import yaml
from shown_text import says

from plate_core import RigError, config_path, load_rig
from plate_vision import CalibrationError, ImageError, Lens, make_vision
from plate_vision.camera import load_lens, read_pictures, rig_of_picture, save_lens
from plate_vision.camera.headers import read_header, reset_orientation

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
def test_a_saved_lens_is_loaded_without_changes(tmp_path, rng, count):
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
        ("plumb_bob", "equidistant", r"camera\.yaml: lens: distortion has 5 values, allowed: 4"),
        ("plumb_bob", "fisheye", r"camera\.yaml: lens: distortion_model is 'fisheye', allowed: pl"),
        ("cols: 5\n  data: [-0.361976, ", "cols: 4\n  data: [", None),
        ("cols: 5", "cols: 6", "data is .*allowed: 6 numbers"),
        ("plumb_bob", "rational_polynomial", None),
        ("438.783367", ".nan", "camera_matrix: data is"),
        ("438.783367", "-1", "focal lengths are -1 and 437.303 px, allowed: 1"),
        ("438.783367", "0", r"camera\.yaml: lens: focal lengths are 0 and"),
        ("438.783367, 0.000000", "438.7, 0.5", r"camera\.yaml: lens: K is .*allowed: \[fx, 0, cx"),
        ("camera_matrix:\n  rows: 3", "camera_matrix:\n  rows: 1", "1 x 3, allowed: 3 x 3"),
        ("distortion_model: plumb_bob", "", "distortion_model is missing"),
    ],
)
def test_wrong_files_are_refused(load, old, new, words):
    if words is None:  # four parameters are allowed too, and five of a rational polynomial
        assert len(load(FILE.replace(old, new)).distortion) == (4 if "4" in new else 5)
        return
    with pytest.raises(CalibrationError, match=words):
        load(FILE.replace(old, new))


OPENCV_FILE = """%YAML:1.0
---
calibration_time: "Sun 29 Nov 2026 10:00:00 UTC"
nr_of_frames: 20
image_width: 640
image_height: 480
board_width: 9
square_size: 3.0000001192092896e-02
flags: 0
fisheye_model: 0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 4.3878336700000000e+02, 0., 3.0559333600000002e+02, 0.,
       4.3730287600000000e+02, 2.4373835200000000e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.6197600000000002e-01, 1.1051000000000000e-01,
       1.0139999999999999e-03, 5.0500000000000002e-04, 0. ]
avg_reprojection_error: 2.5e-01
"""

INI_FILE = """# Prosilica camera intrinsics

[image]

width
640

height
480

[narrow_stereo/left]

camera matrix
438.783367 0.000000 305.593336
0.000000 437.302876 243.738352
0.000000 0.000000 1.000000

distortion
-0.361976 0.110510 0.001014 0.000505 0.000000

rectification
1.000000 0.000000 0.000000
0.000000 1.000000 0.000000
0.000000 0.000000 1.000000

projection
393.6 0.0 322.8 0.0
0.0 393.6 241.1 0.0
0.0 0.0 1.0 0.0
"""


@pytest.mark.parametrize("text", [OPENCV_FILE, INI_FILE])
def test_camera_files_of_others(load, text):
    """The same camera as in the file of ROS."""
    lens, same = load(text), load(FILE)
    assert lens.matrix.tolist() == same.matrix.tolist()
    assert lens.distortion.tolist() == same.distortion.tolist()
    assert lens.model == "plumb_bob"
    with pytest.raises(CalibrationError, match="320 x 480 px, allowed: 640 x 480 px"):
        load(text.replace("640", "320"))
    with pytest.raises(CalibrationError, match=r"camera\.yaml.*allowed|camera\.yaml.*expected"):
        load(text.replace("437.302876", "0.0").replace("4.3730287600000000e+02", "0."))
    for spoilt in (text[:200], text.replace("istortion", "istort"), text.replace("5", "x")):
        with pytest.raises(CalibrationError, match=r"camera\.yaml: "):
            load(spoilt)


def test_files_that_opencv_writes(tmp_path):
    """As cv::FileStorage of the installed OpenCV does, of a fisheye lens too."""
    path = tmp_path / "camera.yml"
    for fisheye, values, model in (
        (0, [0.1, 0.2, 0.0, 0.0], "plumb_bob"),
        (0, [0.1, 0.2, 0.0, 0.0, 0.1, 0.2, 0.3, 0.1], "rational_polynomial"),
        (1, [0.1, 0.02, 0.003, 0.001], "equidistant"),
    ):
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        file.write("image_width", 640)
        file.write("image_height", 480)
        file.write("fisheye_model", fisheye)
        file.write("camera_matrix", np.array([[600.5, 0, 320], [0, 601, 240], [0, 0, 1.0]]))
        file.write("distortion_coefficients", np.array(values))
        file.release()
        lens = load_lens(path, (640, 480))
        assert lens.matrix[0, 0] == 600.5
        assert lens.distortion.tolist() == values
        assert lens.model == model


@pytest.mark.parametrize("kind", ["yml", "json"])
def test_four_values_of_an_unknown_model_are_refused(tmp_path, kind):
    """A program of one's own that calls cv2.fisheye.calibrate writes K and D, but no model."""
    path = tmp_path / f"camera.{kind}"
    for model in (None, "equidistant", "plumb_bob"):
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        file.write("image_width", 640)
        file.write("image_height", 480)
        file.write("K", np.array([[600.5, 0, 320], [0, 601, 240], [0, 0, 1.0]]))
        file.write("D", np.array([[0.1], [0.02], [0.003], [0.001]]))
        if model is not None:
            file.write("distortion_model", model)
        file.release()
        if model is not None:
            assert load_lens(path).model == model
            continue
        with pytest.raises(CalibrationError, match=r"distortion_model is missing, .* equidistant"):
            load_lens(path)


@pytest.mark.parametrize("kind", ["json", "xml"])
def test_other_files_that_opencv_writes(tmp_path, kind):
    path = tmp_path / f"camera.{kind}"
    for values in ([0.1, 0.2, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3, 0.4]):
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        file.write("image_width", 640)
        file.write("image_height", 480)
        file.write("camera_matrix", np.array([[600.5, 0, 320], [0, 601, 240], [0, 0, 1.0]]))
        file.write("distortion_coefficients", np.array([values]))
        file.release()
        if len(values) == 5:
            assert load_lens(path, (640, 480)).matrix.tolist()[1] == [0, 601, 240]
            assert load_lens(path).distortion.tolist() == values
            continue
        with pytest.raises(CalibrationError, match="distortion_model is missing"):
            load_lens(path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: len(text) // 2], encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"^.*camera\.(xml|json): "):
        load_lens(path)


KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.361976, 0.110510, 0.001014, 0.000505]
  distortion_model: radtan
  intrinsics: [438.783367, 437.302876, 305.593336, 243.738352]
  resolution: [640, 480]
  rostopic: /camera/image_raw
"""

COLMAP = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 1
1 OPENCV 640 480 438.783367 437.302876 306.093336 244.238352 -0.361976 0.110510 0.001014 0.000505
"""

MESSAGE = """header:
  stamp:
    sec: 12
    nanosec: 5
  frame_id: camera
height: 480
width: 640
distortion_model: plumb_bob
d: [-0.361976, 0.110510, 0.001014, 0.000505, 0.0]
k: [438.783367, 0.0, 305.593336, 0.0, 437.302876, 243.738352, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [438.783367, 0.0, 305.593336, 0.0, 0.0, 437.302876, 243.738352, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""

JSON_MESSAGE = """{"width": 640, "height": 480, "distortion_model": "plumb_bob",
"D": [-0.361976, 0.110510, 0.001014, 0.000505, 0.0],
"K": [438.783367, 0, 305.593336, 0, 437.302876, 243.738352, 0, 0, 1]}"""


@pytest.mark.parametrize("text", [FILE, OPENCV_FILE, INI_FILE, KALIBR, COLMAP, MESSAGE])
def test_files_of_a_windows_editor(tmp_path, text):
    """With a byte order mark, and carriage returns."""
    path = tmp_path / "camera.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + text.lstrip().replace("\n", "\r\n").encode())
    assert load_lens(path, (640, 480)).matrix[0, 0] == 438.783367


@pytest.mark.parametrize("text", [KALIBR, COLMAP, MESSAGE, MESSAGE * 2, JSON_MESSAGE])
def test_files_of_other_tools(load, text):
    """The same camera as in the file of ROS. COLMAP counts pixels from the corner of the first."""
    lens, same = load(text), load(FILE)
    assert lens.matrix == pytest.approx(same.matrix, abs=1e-9)
    assert lens.distortion.tolist()[:4] == same.distortion.tolist()[:4]
    assert lens.model == "plumb_bob"
    with pytest.raises(CalibrationError, match="320 x 480 px, allowed: 640 x 480 px"):
        load(text.replace("640", "320"))


@pytest.mark.parametrize(
    ("text", "model", "values"),
    [
        (KALIBR.replace("radtan", "equidistant"), "equidistant", [-0.361976, 0.11051, 0.001014]),
        (re.sub("coeffs: .*", "coeffs: []", KALIBR.replace("radtan", "none")), "plumb_bob", [0.0]),
        (COLMAP.replace("CV 640", "CV_FISHEYE 640"), "equidistant", [-0.361976, 0.11051, 0.001014]),
        ("3 SIMPLE_RADIAL 640 480 600.0 320.0 240.0 -0.1", "plumb_bob", [-0.1, 0, 0]),
        ("3 PINHOLE 640 480 600.0 600.0 320.0 240.0", "plumb_bob", [0, 0, 0]),
    ],
)  # fmt: skip
def test_models_of_other_tools(load, text, model, values):
    lens = load(text)
    assert lens.model == model
    assert lens.distortion.tolist()[: len(values)] == values


def test_a_message_of_a_part_of_the_sensor(load):
    """A region of 640 x 480 px at (320, 100), every pixel of which is 2 x 2 of the sensor's."""
    text = MESSAGE.replace("height: 480\nwidth: 640", "height: 2000\nwidth: 2000")
    text = text.replace("binning_x: 0\nbinning_y: 0", "binning_x: 2\nbinning_y: 2")
    text = text.replace("x_offset: 0\n  y_offset: 0", "x_offset: 320\n  y_offset: 100")
    lens = load(text.replace("height: 0\n  width: 0", "height: 960\n  width: 1280"))
    assert lens.matrix[0].tolist() == [438.783367 / 2, 0, (305.593336 - 320 + 0.5) / 2 - 0.5]
    assert lens.matrix[1].tolist() == [0, 437.302876 / 2, (243.738352 - 100 + 0.5) / 2 - 0.5]
    with pytest.raises(CalibrationError, match=r"camera\.yaml: roi is 1800 x 960 px at \(320, 100"):
        load(text.replace("height: 0\n  width: 0", "height: 960\n  width: 1800"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (KALIBR + KALIBR.replace("cam0", "cam1"), "the cameras cam0, cam1 of Kalibr, allowed"),
        (KALIBR.replace("pinhole", "omni"), "cam0: camera_model is 'omni', allowed"),
        (KALIBR.replace("radtan", "fov"), "cam0: distortion_model is 'fov', allowed"),
        (KALIBR.replace("437.302876, ", ""), "cam0: intrinsics is .* allowed: 4"),
        (COLMAP.replace("OPENCV", "FOV"), "camera model of COLMAP is FOV, allowed: SIMPLE_PINH"),
        (COLMAP.replace("OPENCV", "PINHOLE"), "PINHOLE has 8 parameters, allowed: 4"),
        (COLMAP + "2 PINHOLE 640 480 600 600 320 240", "contains 2 cameras of COLMAP, allowed"),
        (MESSAGE.replace("438.783367", "0.0"), "camera of this message is not calibrated"),
        ('{"RadialDistortion": [-0.3, 0.1], "ImageSize": [480, 640]}', "of MATLAB, .*ToOpenCV"),
        ("MATLAB 5.0 MAT-file, Platform: GLNXA64", "a .mat file of MATLAB, .*ToOpenCV"),
        ('{"width": 640, "ppx": 320, "ppy": 240}', "of librealsense, .* camera_info"),
        ("<?xml version='1.0'?>\n<calibration><f>1</f></calibration>", "XML with the element cal"),
        ("PK\x03\x04", "a ZIP archive, as .npz of numpy"),
        ("fx: 600\nfy: 600\n", "image_width is missing, allowed: a camera file of ROS .*Kalibr"),
        (INI_FILE.replace(" 0.000505 0.000000", " 0.000505"), "distortion_model is missing"),
    ],
)  # fmt: skip
def test_files_that_are_not_read_are_named(load, text, words):
    with pytest.raises(CalibrationError, match=f"camera.yaml: .*{words}"):
        load(text)


@pytest.mark.parametrize("model", ["equidistant", "rational_polynomial"])
def test_models_there_and_back(tmp_path, model):
    values = [0.1, 0.02, 0.003, 0.001, *([] if model == "equidistant" else [0.1] * 4)]
    lens = Lens(np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), np.array(values), model)
    save_lens(tmp_path / "camera.yaml", "plate", (640, 480), lens)
    again = load_lens(tmp_path / "camera.yaml")
    assert (again.model, again.distortion.tolist()) == (model, values)


def test_a_lens_that_folds_is_refused_from_every_source(load, tmp_path):
    """r (1 - r2 / 2) with f 350 folds at 190 px, inside the default plate's image."""
    words = r"lens: distortion is .* folds the image of the plate, 191 px from the optical centre, "
    rig = load_rig()
    text = FILE.replace("-0.361976, 0.110510, 0.001014, 0.000505", "-0.5, 0, 0, 0")
    lens = load(text.replace("438.783367", "350").replace("437.302876", "350"))
    with pytest.raises(CalibrationError, match=f"^camera.yaml: {words}"):
        make_vision(rig, lens=lens)  # of a camera file
    with pytest.raises(CalibrationError, match=f"^{words}"):  # of camera_info
        make_vision(rig, lens=Lens(lens.matrix, lens.distortion, "plumb_bob"))
    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    data["camera"] |= {
        "focal_px": [350, 350], "centre_px": [305.6, 243.7], "distortion": [-0.5, 0, 0, 0, 0]
    }  # fmt: skip
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(RigError, match=f"^rig.yaml: camera: {words}"):
        load_rig(path)


def test_pictures_come_by_their_names(tmp_path):
    for name, grey in (("b.PNG", 20), ("a.png", 10), ("c.bmp", 30)):
        cv2.imwrite(str(tmp_path / name), np.full((6, 8), grey, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture", encoding="utf-8")
    seen = [(name, int(pixels[0, 0, 0])) for name, pixels in read_pictures(tmp_path)]
    assert seen == [("a.png", 10), ("b.PNG", 20), ("c.bmp", 30)]
    ((name, pixels),) = read_pictures(tmp_path / "a.png")
    assert name == "a.png"
    assert pixels.shape == (6, 8, 3)


def test_numbers_in_names_are_sorted_by_value(tmp_path):
    """A film of frames that are not numbered with leading zeros must not play in another order."""
    order = ["2.png", "9_a.png", "10.png", "a.png", "a1_x9.png", "a1_x10.png", "a02.png", "a2.png"]
    for name in sorted(order):
        cv2.imwrite(str(tmp_path / name), np.zeros((6, 8), np.uint8))
    assert [name for name, _ in read_pictures(tmp_path)] == order


def test_other_pictures_in_a_folder_are_skipped_with_a_warning(tmp_path):
    for name in ("1.png", "2.PNG"):
        cv2.imwrite(str(tmp_path / name), np.zeros((6, 8), np.uint8))
    for name in ("3.HEIC", "4.gif", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    warnings = []
    assert [name for name, _ in read_pictures(tmp_path, warnings.append)] == ["1.png", "2.PNG"]
    assert len(warnings) == 1
    assert "skipped 3.HEIC and 1 more, allowed: .bmp" in warnings[0]


def test_a_film_is_read_frame_by_frame(tmp_path):
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
def test_unreadable_files_are_reported(tmp_path, name):
    (tmp_path / "empty").mkdir()
    for file in ("damaged.png", "notes.txt"):
        (tmp_path / file).write_text("no picture", encoding="utf-8")
    with pytest.raises(ImageError, match=r"allowed: |no pictures"):
        list(read_pictures(tmp_path / name))


def test_a_picture_of_another_size_is_the_whole_plate():
    rig = load_rig()
    assert rig_of_picture(rig, (640, 480)) == (rig, "")
    taken, text = rig_of_picture(rig, (1200, 900))
    assert says(text, "1200 x 900 px", "640 x 480 px", "0.6 x 0.45 m", "0.6 x 0.3 m")
    vision = make_vision(taken)
    assert vision.region.size_px == (1200, 900)
    corners = np.array([[-0.5, 899.5], [1199.5, -0.5], [599.5, 449.5]])
    assert np.allclose(vision.calibration.to_home(corners), [[-0.3, -0.225], [0.3, 0.225], [0, 0]])


def exif(orientation, order="<"):
    """EXIF data with an orientation alone."""
    mark = b"II" if order == "<" else b"MM"
    return mark + struct.pack(order + "HIHHHIHHI", 42, 8, 1, 274, 3, 1, orientation, 0, 0)


def oriented(kind, picture, orientation):
    """A file with an orientation, put together by hand from OpenCV's."""
    data = cv2.imencode(kind, picture)[1].tobytes()
    tags = exif(orientation, ">" if orientation % 2 else "<")
    if kind == ".jpg":
        body = b"Exif\0\0" + tags
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    if kind == ".png":
        chunk = b"eXIf" + tags
        chunk = struct.pack(">I", len(tags)) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return data[:33] + chunk + data[33:]
    if kind == ".webp":
        tags += b"\0" * (len(tags) % 2)
        height, width = picture.shape[:2]
        head = b"VP8X" + struct.pack("<IB3x", 10, 8)
        head += (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
        body = b"WEBP" + head + data[12:] + b"EXIF" + struct.pack("<I", len(tags)) + tags
        return b"RIFF" + struct.pack("<I", len(body)) + body
    return tiff(picture, orientation, ">" if orientation % 2 else "<")


def tiff(picture, orientation, order="<"):
    """An uncompressed TIFF file of grey levels."""
    height, width = picture.shape
    tags = [(256, width), (257, height), (258, 8), (259, 1), (262, 1), (273, 8)]
    tags += [(274, orientation), (277, 1), (278, height), (279, picture.size)]
    place = 8 + picture.size
    data = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, place)
    data += picture.tobytes() + struct.pack(order + "H", len(tags))
    for tag, value in tags:
        wide = tag in (273, 279)
        data += struct.pack(order + "HHI", tag, 4 if wide else 3, 1)
        data += struct.pack(order + ("I" if wide else "H2x"), value)
    return data + bytes(4)


def test_a_picture_of_12_bits_is_dark_with_a_warning(tmp_path):
    grey = np.tile(np.arange(0, 250, 10, dtype=np.uint16), (16, 1))
    warnings = []
    for name, factor in (("a.png", 257), ("b.png", 16), ("c.png", 0)):
        cv2.imwrite(str(tmp_path / name), grey * np.uint16(factor))
    assert len(list(read_pictures(tmp_path, warnings.append))) == 3
    (text,) = warnings
    assert text.startswith("b.png: only 12 of its 16 bits are used")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", [".jpg", ".png", ".webp", ".tif"])
def test_pictures_are_never_turned(tmp_path, capsys, rng, kind, orientation):
    """Pixels are where the sensor has them, whatever a viewer does."""
    picture = cv2.resize(rng.integers(0, 256, (6, 8), np.uint8), (64, 48))
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}{kind}").write_bytes(oriented(kind, picture, orientation))
    warnings = []
    seen = [pixels for _, pixels in read_pictures(folder, warnings.append)]
    assert len(seen) == 2
    for pixels in seen:
        assert pixels.shape == (48, 64, 3)
        assert np.abs(pixels[:, :, 1].astype(int) - picture).mean() < 8
    if orientation == 1:
        assert warnings == []
    else:
        (text,) = warnings
        assert text.startswith(f"a{kind}: orientation {orientation} is ignored: viewers ")
        assert "pixels are used as stored" in text
    next(read_pictures(folder))
    assert capsys.readouterr().err.count("warning: a") == (orientation > 1)


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_films_are_never_turned(tmp_path, turn):
    """The matrix in the header of a track of an MP4 file gives the players' rotation."""
    path = tmp_path / "film.mp4"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10, (64, 48))
    frame = np.zeros((48, 64, 3), np.uint8)
    frame[:24, :32] = 255
    for _ in range(3):
        film.write(frame)
    film.release()
    data = bytearray(path.read_bytes())
    cos, sin = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[turn]
    straight = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    place = data.index(straight, data.index(b"tkhd"))
    matrix = (cos << 16, sin << 16, 0, -sin << 16, cos << 16, 0, 0, 0, 1 << 30)
    data[place : place + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(data)
    warnings = []
    frames = [pixels for _, pixels in read_pictures(path, warnings.append)]
    assert len(frames) == 3
    assert frames[0].shape == (48, 64, 3)
    assert np.abs(frames[0].astype(int) - frame).mean() < 10
    assert len(warnings) == (turn > 0)


def test_an_unreadable_header_is_no_picture(tmp_path, rng):
    """Files that break off anywhere, and noise, are refused or read, never worse."""
    picture = rng.integers(0, 256, (48, 64), np.uint8)
    path = tmp_path / "a.png"
    for kind in (".jpg", ".png", ".webp", ".bmp", ".pgm", ".tif"):
        whole = tiff(picture, 6) if kind == ".tif" else cv2.imencode(kind, picture)[1].tobytes()
        for size in (*range(0, 64, 3), len(whole) // 2):
            path.write_bytes(whole[:size])
            with contextlib.suppress(ImageError):
                assert next(read_pictures(path))[1].shape == (48, 64, 3)
        path.write_bytes(whole)
        ((_, pixels),) = read_pictures(path)
        assert pixels.shape == (48, 64, 3)


def test_damaged_headers_are_never_a_crash(rng):
    """Bytes changed at random, in files with an orientation."""
    picture = rng.integers(0, 256, (16, 24), np.uint8)
    for kind in (".jpg", ".png", ".webp", ".tif"):
        whole = oriented(kind, picture, 6)
        assert read_header(whole)[1:4] == (24, 16, 6)
        for _ in range(3000):
            data = bytearray(whole)
            for place in rng.integers(0, min(len(data), 200), 4):
                data[place] = rng.choice([0, 1, 127, 128, 255])
            header = read_header(bytes(data))
            assert header is None or len(reset_orientation(bytes(data), header)) == len(data)
    big = b"II" + struct.pack("<HHHQ", 43, 8, 0, 2**64 - 1)  # a directory beyond all files
    assert read_header(big) is None


def bomb(kind, side):
    """A file that claims to hold side x side pixels."""
    small = np.zeros((16, 16), np.uint8)
    if kind == ".png":
        packed = zlib.compress(bytes(1000))  # a thousand times as many would follow
        head = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
        chunks = ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b""))
        return b"\x89PNG\r\n\x1a\n" + b"".join(
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
            for name, body in chunks
        )
    if kind == ".tif":
        return (
            tiff(small, 1)
            .replace(struct.pack("<HHIH", 256, 3, 1, 16), struct.pack("<HHIH", 256, 3, 1, side))
            .replace(struct.pack("<HHIH", 257, 3, 1, 16), struct.pack("<HHIH", 257, 3, 1, side))
        )
    if kind == ".ppm":
        return b"P6 # a comment\n%d\n%d 255\n" % (side, side)
    data = bytearray(cv2.imencode(kind, small)[1].tobytes())
    if kind == ".jpg":
        place = data.index(b"\xff\xc0") + 5
        data[place : place + 4] = struct.pack(">HH", side, side)
    if kind == ".bmp":
        data[18:26] = struct.pack("<ii", side, -side)
    return bytes(data)


@pytest.mark.parametrize("kind", [".png", ".jpg", ".bmp", ".ppm", ".tif"])
def test_picture_bombs_are_refused_by_their_size(tmp_path, kind, monkeypatch):
    """Before anything is unpacked."""
    path = tmp_path / f"bomb{kind}"
    path.write_bytes(bomb(kind, 20_000))
    assert path.stat().st_size < 1e6
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(ImageError, match=f"bomb{kind}: size is 20000 x 20000 px, allowed: .*50,00"):
        list(read_pictures(path))


@pytest.mark.parametrize("kind", [".png", ".tif"])
def test_pictures_of_all_depths_and_colours(tmp_path, kind):
    """16 bits, grey, with alpha: as 8 bits, blue, green, red."""
    grey = np.tile(np.arange(0, 240, 10, dtype=np.uint8), (16, 1))
    colour = np.dstack([grey, grey[::-1], grey])
    for pixels in (grey, colour, np.dstack([colour, 255 - grey]), grey.astype(np.uint16) * 257):
        path = tmp_path / f"a{kind}"
        cv2.imwrite(str(path), pixels)
        ((_, seen),) = read_pictures(path)
        expected = pixels // (257 if pixels.dtype == np.uint16 else 1)
        expected = expected[..., :3] if expected.ndim == 3 else np.dstack([expected] * 3)
        assert seen.dtype == np.uint8
        assert np.array_equal(seen, expected)
