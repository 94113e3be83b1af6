"""The program `calibrate`, from pictures in a folder to the files it writes."""

import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from plate_core import config_path
from plate_vision.camera import Board, calibrate_camera, draw_board, find_markers, load_lens
from plate_vision.camera.calibrate_camera import main

BOARD = ["--board", "9x7", "--square", "0.03", "--marker", "0.022"]
MATRIX = np.array([[620.0, 0, 331.0], [0, 610.0, 236.0], [0, 0, 1]])


def test_from_pictures_to_a_camera_file(make_scene, rng, tmp_path, capsys):
    picture = draw_board(Board(9, 7, 0.03, 0.022), 60)
    size = np.array(picture.shape[::-1]) / 60 * 0.03
    scene = make_scene(picture, size, MATRIX, [-0.2, 0.05, 0.0, 0.0, 0.0])
    folder = tmp_path / "pictures"
    folder.mkdir()
    for k in range(8):
        tilt = 0.5 * np.array([np.cos(0.8 * k), np.sin(0.8 * k), 0.2])
        turn = cv2.Rodrigues(tilt)[0] @ np.diag([1.0, -1, -1])
        move = np.array([0.09 * np.cos(2.4 * k), 0.06 * np.sin(2.4 * k), 0.4])
        cv2.imwrite(str(folder / f"{k}.png"), scene.take(turn, move, rng))
    cv2.imwrite(str(folder / "nothing.png"), np.full((480, 640), 90, np.uint8))
    (folder / "notes.txt").write_text("no picture", encoding="utf-8")
    out, errors = tmp_path / "camera.yaml", tmp_path / "errors.png"
    main(
        ["lens", str(folder), *BOARD, "--name", "mine", "--out", str(out), "--errors", str(errors)]
    )
    lens = load_lens(out, (640, 480))
    assert "camera_name: mine" in out.read_text(encoding="utf-8")
    assert np.allclose(np.diag(lens.matrix)[:2], [620, 610], rtol=0.02)
    assert abs(lens.distortion[0] + 0.2) < 0.03
    drawn = cv2.imread(str(errors))
    assert drawn.shape == (480, 640, 3)
    assert np.count_nonzero(drawn < 255) > 1000
    output = capsys.readouterr().out
    assert "nothing.png: 0 of 48 corners" in output
    assert "px rms in 8 pictures" in output
    assert "focal_px: [6" in output


def test_a_long_film_is_done_by_forty_frames(make_scene, rng, tmp_path, capsys, monkeypatch):
    """Of a film with long rests: frames that differ, searched ever less often."""
    board = Board(8, 6, 0.03, 0.022, white_first=True)
    picture = draw_board(board, 60)
    scene = make_scene(picture, np.array(picture.shape[::-1]) / 60 * 0.03, MATRIX)
    path = tmp_path / "film.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (640, 480))
    if not film.isOpened():
        pytest.skip("OpenCV cannot write films here")
    for k in range(10):
        tilt = 0.5 * np.array([np.cos(0.8 * k), np.sin(0.8 * k), 0.2])
        turn = cv2.Rodrigues(tilt)[0] @ np.diag([1.0, -1, -1])
        move = np.array([0.09 * np.cos(2.4 * k), 0.06 * np.sin(2.4 * k), 0.4])
        frame = cv2.cvtColor(scene.take(turn, move, rng), cv2.COLOR_GRAY2BGR)
        for _ in range(10):
            film.write(frame)
    film.release()
    monkeypatch.setattr(calibrate_camera, "FRAMES_SEARCHED", 30)
    out = tmp_path / "camera.yaml"
    files = ["--out", str(out), "--errors", str(tmp_path / "errors.png")]
    main(["lens", str(path), "--board", "8x6", "--square", "0.03", "--marker", "0.022", *files])
    output = capsys.readouterr().out
    frames = r"^100 of 100 frames read, 6[2-5] searched, board detected in [56]\d$"
    assert re.search(frames, output, re.M)
    assert "first square is white" in output
    assert "fitted to the 40 pictures that differ most" in output
    assert "px rms in 40 pictures" in output
    assert np.allclose(np.diag(load_lens(out).matrix)[:2], [620, 610], rtol=0.02)


def test_a_large_folder_is_searched_in_part(rng, tmp_path, capsys, monkeypatch):
    for k in range(12):
        cv2.imwrite(str(tmp_path / f"{k:02}.png"), rng.integers(0, 255, (48, 64), np.uint8))
    monkeypatch.setattr(calibrate_camera, "PICTURES_SEARCHED", 4)
    with pytest.raises(SystemExit):
        main(["lens", str(tmp_path), *BOARD])
    output = capsys.readouterr().out.splitlines()
    names = [line.split(".")[0] for line in output[:-1]]
    assert names == ["00", "01", "02", "03", "05", "07", "09", "11"]
    assert output[-1] == "12 of 12 pictures read, 8 searched, board detected in 0"


def test_progress_on_a_terminal(monkeypatch, capsys):
    """One line that changes, on stderr; nothing of it in a file."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    progress = calibrate_camera.Progress(SimpleNamespace(is_film=True, place=7, count=50))
    progress.searched("film: 6", 40, 48)
    progress.searched("film: 7", 0, 48)
    progress.end()
    output = capsys.readouterr()
    assert output.out == ""
    line = "7 of 50 frames read, {} searched, board detected in 1"
    assert output.err == f"\r{line.format(1)}\r{line.format(2)}\n"


@pytest.mark.parametrize("model", ["rational_polynomial", "equidistant"])
def test_models_in_the_camera_file(model, make_scene, rng, tmp_path, capsys):
    picture = draw_board(Board(9, 7, 0.03, 0.022), 60)
    size = np.array(picture.shape[::-1]) / 60 * 0.03
    scene = make_scene(picture, size, MATRIX, [0.0, 0, 0, 0], model == "equidistant")
    for k in range(8):
        tilt = 0.5 * np.array([np.cos(0.8 * k), np.sin(0.8 * k), 0.2])
        turn = cv2.Rodrigues(tilt)[0] @ np.diag([1.0, -1, -1])
        move = np.array([0.09 * np.cos(2.4 * k), 0.06 * np.sin(2.4 * k), 0.4])
        cv2.imwrite(str(tmp_path / f"{k}.png"), scene.take(turn, move, rng))
    out = tmp_path / "camera.yaml"
    files = ["--out", str(out), "--errors", str(tmp_path / "errors.txt.bmp")]
    main(["lens", str(tmp_path), *BOARD, "--model", model, *files])
    lens = load_lens(out, (640, 480))
    assert lens.model == model
    assert np.allclose(np.diag(lens.matrix)[:2], [620, 610], rtol=0.03)
    assert f"  distortion_model: {model}" in capsys.readouterr().out


def test_board_for_the_printer(tmp_path, capsys):
    out = tmp_path / "board.png"
    main(["board", *BOARD, "--out", str(out)])
    picture = cv2.imread(str(out), cv2.IMREAD_GRAYSCALE)
    assert picture.shape[1] == pytest.approx(10 * 0.03 / 0.0254 * 300, rel=0.01)
    assert "squares of 30 mm" in capsys.readouterr().out


def test_markers_and_home(make_plate, rng, tmp_path, capsys):
    plate = make_plate()
    text = config_path("rig.yaml").read_text(encoding="utf-8") + "\n".join(
        ["", "fiducials:", "  dictionary: 4X4_50", "  side_m: 0.03", "  centre_m:"]
        + [f"    marker_{k}: [{x}, {y}]" for k, (x, y) in enumerate(plate.CENTRES)]
    )
    rig = tmp_path / "rig.yaml"
    rig.write_text(text, encoding="utf-8")
    main(["markers", "--rig-file", str(rig), "--out", str(tmp_path / "print")])
    for k in range(4):
        picture = cv2.imread(str(tmp_path / "print" / f"marker_{k}.png"), cv2.IMREAD_GRAYSCALE)
        assert list(find_markers(picture, "4X4_50")) == [k]
    folder = tmp_path / "pictures"
    folder.mkdir()
    for k in range(3):
        cv2.imwrite(str(folder / f"{k}.png"), plate.take(np.zeros(3), rng))
    capsys.readouterr()
    main(["home", str(folder), "--rig-file", str(rig)])
    line = capsys.readouterr().out.splitlines()[-1]
    seen = np.array(eval(line.split(":", 1)[1]))
    assert np.abs(seen - plate.rig.camera.corners_px).max() < 0.15
    cv2.imwrite(str(folder / "9.png"), cv2.resize(plate.take(np.zeros(3), rng), (1280, 960)))
    with pytest.raises(SystemExit):
        main(["home", str(folder), "--rig-file", str(rig)])
    assert "9.png: 1280 x 960 px, allowed: 640 x 480 px" in capsys.readouterr().err


def test_the_size_of_a_board_is_required(capsys):
    for text in ("9", "9x", "nine"):
        with pytest.raises(SystemExit):
            main(["board", "--board", text, "--square", "0.03"])
        assert (
            f"board is '{text}', allowed: the numbers of squares along x and y"
            in capsys.readouterr().err
        )


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("no such file or folder", ["lens", "/nowhere", *BOARD]),
        ("contains no pictures", ["lens", ".", *BOARD]),
        ("fiducials is missing", ["markers"]),
        ("is a FIFO, allowed: a regular file up to 64 MB", ["lens", "odd/a_fifo.png", *BOARD]),
        ("a_fifo.png: is a FIFO, allowed", ["lens", "odd", *BOARD]),
        ("fifo: is a FIFO, allowed: a regular file up to 4000 MB", ["lens", "odd/fifo", *BOARD]),
        ("/dev/zero: is a device, allowed", ["lens", "/dev/zero", *BOARD]),
        ("large.png: has 1000 MB, allowed", ["lens", "odd/large.png", *BOARD]),
        ("large: cannot be read, allowed: a video", ["lens", "odd/large", *BOARD]),
        ("empty.png: cannot be read, allowed: a complete pict", ["lens", "odd/empty.png", *BOARD]),
        ("2 x 7 squares, allowed", ["board", "--board", "2x7", "--square", "0.03"]),
        ("3 x 7 squares, allowed: 4 x 4 to", ["board", "--board", "3x7", "--square", "0.03"]),
        ("square is 30 m, allowed: 0.001 to 1", ["board", "--board", "9x7", "--square", "30"]),
        ("square is inf m, allowed", ["board", "--board", "9x7", "--square", "inf"]),
        ("pixels, allowed: at most 200,000,000", ["board", "--board", "40x40", "--square", "0.1"]),
        (
            "marker is 6 px, allowed in 5X5_100: at least 7 px",
            ["board", "--board", "9x7", "--square", "0.001", "--marker", "0.0005"],
        ),
        ("no/board.png: cannot be written", ["board", *BOARD, "--out", "no/board.png"]),
        ("board.sheet: cannot be written", ["board", *BOARD, "--out", "board.sheet"]),
    ],
)
def test_errors_are_reported_in_one_line(words, arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    odd = Path("odd")
    odd.mkdir()
    for name in ("fifo", "a_fifo.png"):
        os.mkfifo(odd / name)
    (odd / "empty.png").touch()
    for name in ("large", "large.png"):
        (odd / name).touch()
        os.truncate(odd / name, 10**9)
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert words in line
