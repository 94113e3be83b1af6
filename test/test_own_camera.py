"""`make demo` with a film in place of a camera, and the simulated board: no image is simulated."""

import contextlib
import json
import os
import pty
import select
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from demo import arguments
from graph.demo import await_consent, demo

from plate_core import PlateError, config_path, load_rig
from plate_core.tasks import load_scenario, start_positions
from plate_sim.camera import Camera, Lighting, part_greys

ROOT = Path(__file__).resolve().parents[1]
HEIGHT_M = 0.004
SECONDS, RATE = 60, 10
"""Duration [s] and image rate [1/s] of the film. The film is longer than the task, even if a busy
computer starts the nodes slowly."""

TIME_LIMIT_S = 3.0
PICTURES = 20
"""That differ: the film shows them again and again."""

MAX_S = 300
TRIES = 6


def film(folder):
    """Write a film of four parts, of some height, under a lamp and through a lens that bends; and
    the rig file that knows of them."""
    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    data["parts"]["height_m"] = HEIGHT_M
    data["camera"]["distortion"] = [-0.12, 0.03, 0.0005, -0.0003, 0.0]
    data["friction"]["mu"] = 0.2371
    (folder / "rig.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    rig, rng = load_rig(str(folder / "rig.yaml")), np.random.default_rng(3)
    labels, place = start_positions(load_scenario("sort_4"), rig, rng)
    camera, greys = Camera(rig), part_greys(list(labels))
    light = Lighting(highlights=0.03, shadows=0.2, level=0.9)
    size = (rig.camera.width_px, rig.camera.height_px)
    code = cv2.VideoWriter_fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(folder / "film.mp4"), code, RATE, size)
    height = np.full(len(place), HEIGHT_M)
    images = [
        camera.render(place, greys, rng, height=height, lighting=light) for _ in range(PICTURES)
    ]
    for k in range(SECONDS * RATE):
        writer.write(cv2.cvtColor(images[k % PICTURES], cv2.COLOR_GRAY2BGR))
    writer.release()


def test_a_film_is_seen_answered_and_sent_but_no_task_is_done(tmp_path):
    """Unmeasured values are listed before anything starts."""
    film(tmp_path)
    scenario = yaml.safe_load(config_path("scenarios/sort_4.yaml").read_text(encoding="utf-8"))
    scenario["time_limit_s"] = TIME_LIMIT_S
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    words = ["--rig", tmp_path / "rig.yaml", "--camera", tmp_path / "film.mp4"]
    words += ["--scenario", tmp_path / "short.yaml", "--out", tmp_path / "out"]
    words += ["--no-view", "--no-pictures"]
    for _ in range(TRIES):
        done = subprocess.run(
            [sys.executable, "tools/demo.py", *map(str, words)],
            cwd=ROOT, capture_output=True, text=True, timeout=MAX_S, check=False,
        )  # fmt: skip
        # On a busy computer the driver may send nothing for 0.25 s before the task begins, and the
        # device then stops the motors. Or all first cycles are late, and the task does not begin.
        if not any(text in done.stderr for text in ("host silent", "the task never began")):
            break
    assert done.returncode == 1, done.stdout + done.stderr
    assert not done.stderr, done.stderr
    before, after = done.stdout.split("\nStarting ")
    assert "\n  - corners: corners_px are unchanged " in before
    assert "lens:" not in before
    assert "friction:" not in before
    assert "does not react to the plate" in before
    assert after.startswith("device, camera, detector, planner, solver, driver.")
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert (result["parts"], result["dropped"]) == (4, 0)
    assert ", 4 detected at the end; all " in after
    assert result["parts_sorted"] < 4
    assert result["motor_setpoints"] > 0
    assert result["setpoints_within_limits"]
    assert set(result["exit_codes"].values()) == {0}
    assert not result["success"]
    assert result["message"].startswith(("stuck after ", "aborted after "))


class Person:
    """Replaces the observer: when the program waits, types the next text at its terminal."""

    def __init__(self, typed):
        self.master, slave = pty.openpty()
        self.stdin, self.typed = os.fdopen(slave, encoding="utf-8"), [*typed]

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.stdin.close()
        os.close(self.master)

    def until(self, true, timeout_s):
        if not self.typed:
            raise KeyboardInterrupt
        os.write(self.master, self.typed.pop(0))
        select.select([self.stdin], [], [], timeout_s)

    def hang_up(self, true, timeout_s):
        os.close(self.master)
        self.master = os.open(os.devnull, os.O_RDONLY)


@pytest.mark.parametrize(
    ("typed", "ended"),
    [
        ([b"\n"], None),
        ([b"no\n", b"\n"], None),
        ([b"no\n"], KeyboardInterrupt),
        ([b"\x04"], PlateError),
        ([], KeyboardInterrupt),
    ],
)
def test_only_an_empty_line_after_the_question_enables_the_motors(monkeypatch, typed, ended):
    with Person(typed) as person:
        os.write(person.master, b"\n")  # while the nodes started
        monkeypatch.setattr(sys, "stdin", person.stdin)
        with contextlib.nullcontext() if ended is None else pytest.raises(ended):
            await_consent(person)
        assert not person.typed


def test_a_terminal_that_is_closed_enables_nothing(monkeypatch):
    with Person(()) as person:
        monkeypatch.setattr(sys, "stdin", person.stdin)
        monkeypatch.setattr(person, "until", person.hang_up)
        with pytest.raises(PlateError, match="input ended before Enter: the motors stay off"):
            await_consent(person)


def test_the_demo_does_not_start_if_nobody_can_enable_the_motors(monkeypatch, capsys):
    master, slave = pty.openpty()  # in place of a motor controller
    monkeypatch.setattr(sys, "argv", ["demo.py", "--port", os.ttyname(slave)])
    with open(os.devnull, encoding="utf-8") as nobody:
        monkeypatch.setattr(sys, "stdin", nobody)
        assert demo(arguments()) == 2
    os.close(master)
    os.close(slave)
    output, errors = capsys.readouterr()
    assert "nobody can enable the motors" in errors
    assert "Starting" not in output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--camera", "nowhere.mp4"], "nowhere.mp4: no such device or file, allowed: a number or"),
        (["--camera", "/dev/video99"], "/dev/video99: no such device; check that it is plugged in"),
        (["--camera", "0", "--transport", "sim"], "camera is '0', but with transport sim "),
        (["--camera", "0", "--image-rate", "30"], "image rate is 30, but --camera requires"),
    ],
)
def test_options_that_exclude_a_camera_are_refused_before_the_start(
    monkeypatch, capsys, words, message
):
    monkeypatch.setattr(sys, "argv", ["demo.py", *words])
    assert demo(arguments()) == 2
    output, errors = capsys.readouterr()
    assert "Starting" not in output
    assert message in errors
