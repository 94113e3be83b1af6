"""`feasible` before a task starts: its rehearsals, and the command."""

import re
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from plate_bringup.feasible import main
from plate_bringup.rehearsal import rehearse, rehearse_task
from plate_core import PlateCycle, config_path, load_rig
from plate_core.tasks import load_scenario
from plate_planner import Phase
from plate_solver import EFFORT

RIG = load_rig()


def with_few(name):
    """A scenario with one part of each class."""
    scenario = load_scenario(name)
    return replace(scenario, parts=tuple(replace(group, count=1) for group in scenario.parts))


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    """Verdicts are the same with fewer starts of each motion, and with more of a task estimated."""
    monkeypatch.setitem(EFFORT["sinusoids"], "restarts", 10)
    monkeypatch.setattr("plate_bringup.rehearsal.MAX_CYCLES", 20)


def shaken(gamma):
    return replace(RIG, limits=replace(RIG.limits, accel=gamma * RIG.friction.accel))


@pytest.mark.parametrize(
    "scenario", [load_scenario("sort_4"), with_few("sort_corners_12"), load_scenario("assemble_8")]
)
def test_a_strong_rig_is_likely_to_finish_the_task(scenario):
    done = rehearse(RIG, scenario, 0)
    assert not done.lost
    assert done.time_s < scenario.time_limit_s


def test_the_time_of_a_path_is_proportional_to_its_length(monkeypatch):
    """Two rectangles of 0.56 m at 40 mm/s; references start slowly until the latency is known."""
    monkeypatch.setattr("plate_bringup.rehearsal.MAX_CYCLES", 150)  # to its end
    path = rehearse(RIG, load_scenario("follow_2"), 0)
    assert not path.lost
    assert 0 < path.time_s - 0.56 / 0.04 < 1
    assert path.speed == pytest.approx(0.04, rel=0.05)


def test_a_weak_rig_is_unlikely_to_finish_the_task(monkeypatch):
    """No part goes 40 mm/s where the bound is 10: mu g T/16 (G - 1/G), T being 0.1 s."""
    monkeypatch.setattr("plate_bringup.rehearsal.MAX_CYCLES", 40)
    verdict = rehearse_task(shaken(1.2), load_scenario("follow_2"), 1)
    assert not verdict.likely
    assert verdict.speed < RIG.friction.accel * 0.1 / 16 * (1.2 - 1 / 1.2)
    assert verdict.limit_use.binding_limit == "acceleration"


TO_GO_M = [0.0, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3]
"""One value each second; the first is from before the task."""


@pytest.mark.parametrize(
    ("to_go_m", "phase", "left_s", "speed"),
    [
        (TO_GO_M, Phase.RUNNING, 3.0, 0.4 / 4 / 4),  # 0.1 m/s in the second half
        (TO_GO_M, Phase.DONE, None, 0.4 / 4 / 4),
        (TO_GO_M, Phase.LOST, np.inf, 0.4 / 4 / 4),
        (TO_GO_M, Phase.STUCK, np.inf, 0.4 / 4 / 4),
        ([0.0, 0.8, 0.7, 0.7, 0.6, 0.6, 0.6], Phase.RUNNING, np.inf, 0.2 / 4 / 5),
        ([0.0, 0.8, 0.4, 0.4, 0.3, 0.2, 0.1], Phase.RUNNING, 1.0, 0.4 / 4 / 1),
    ],
)
def test_the_rest_of_a_rehearsal_is_estimated_from_its_second_half(
    monkeypatch, to_go_m, phase, left_s, speed
):
    def run(*_, **__):
        for second, left in enumerate(to_go_m):
            last = second == len(to_go_m) - 1
            progress = SimpleNamespace(
                to_go_m=left, time_s=float(second), phase=phase if last else Phase.RUNNING,
                parts_total=5, parts_sorted=1,
            )  # fmt: skip
            yield SimpleNamespace(
                progress=progress, result=SimpleNamespace(cycle=PlateCycle.rest(0.1))
            )

    monkeypatch.setattr("plate_bringup.rehearsal.run", run)
    scenario = load_scenario("sort_4")
    result = rehearse(RIG, scenario, 0)
    expected = 6.0 if left_s is None else 6.0 + scenario.task.hold_s + left_s
    assert result.time_s == pytest.approx(expected)
    assert result.speed == pytest.approx(speed)
    assert result.lost == (phase is Phase.LOST)
    assert result.limit_use == (0, 0, 0, 0, 0)


def test_a_lower_acceleration_limit_lengthens_the_task():
    times = [rehearse(shaken(g), with_few("sort_4"), 0).time_s for g in (8.0, 16.0, 40.0)]
    assert times == sorted(times, reverse=True)
    assert times[0] > 1.5 * times[2]


def test_a_short_stroke_is_reported_as_the_limit():
    rig = replace(RIG, limits=replace(RIG.limits, stroke_m=0.001))
    assert rehearse(rig, with_few("sort_4"), 0).limit_use.binding_limit == "stroke"


def test_a_rehearsal_keeps_the_limits():
    used = rehearse(RIG, load_scenario("sort_4"), 1).limit_use
    assert 0.5 < max(used) <= 1


@pytest.fixture(name="command")
def _command(monkeypatch, capsys):
    """The command in this process: returns exit code, output and errors."""

    def command(*arguments):
        monkeypatch.setattr("sys.argv", ["feasible", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capsys.readouterr()

    return command


def test_command_reports_likely_success(command):
    code, out, _ = command("--scenario", "sort_4", "--rig", "desk")
    assert code == 0
    assert "desk.yaml: shaking ratio Gamma = 24.5, limited by accel_mps2" in out
    assert "sort_4: likely: 3 of 3 rehearsals end within 120 s (time_limit_s)" in out
    assert "one part on a line: " in out


def test_command_takes_the_rig_of_the_scenario():
    words = [sys.executable, "-m", "plate_bringup.feasible", "--scenario", "align_6"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    assert "shapes.yaml: shaking ratio Gamma = " in done.stdout
    assert "align_6: unknown: feasible cannot rehearse tasks of kind pose" in done.stdout


def test_command_reports_failure_and_a_remedy(command, tmp_path, monkeypatch):
    monkeypatch.setattr("plate_bringup.rehearsal.MAX_CYCLES", 20)  # in the first it is clear
    text = config_path("rig.yaml").read_text(encoding="utf-8")
    assert "accel_mps2: 100.0" in text
    path = tmp_path / "weak.yaml"
    path.write_text(text.replace("accel_mps2: 100.0", "accel_mps2: 3.68"), encoding="utf-8")
    code, out, _ = command("--scenario", "follow_1", "--rig", path)
    assert code == 1
    assert "follow_1: not likely: 0 of 3 rehearsals" in out
    assert (
        "the plate shakes too little: shaking ratio 1.5, limited by accel_mps2, advised: 5" in out
    )


def test_command_reports_that_the_task_does_not_fit(command):
    code, out, _ = command("--scenario", "follow_2", "--rig", "desk")
    assert code == 1
    assert "follow_2: impossible: follow_2.yaml: parts: positions_m of black is (-0.22, -0" in out


def test_command_reports_the_speed_of_parts(command):
    code, out, _ = command("--rig", "desk")
    assert code == 0
    speeds = [float(line.split()[2]) for line in out.splitlines() if line.startswith("  ")]
    assert len(speeds) == 4
    assert speeds[0] > speeds[-1] > 0
    assert np.max(speeds) < float(out.split("at most ")[1].split()[0])


@pytest.mark.parametrize("words", [("--scenario", "sort_3"), ("--rig", "desc"), ("--seed", "1")])
def test_command_refuses(command, words):
    code, out, err = command(*words)
    assert (code, out) == (2, "")
    assert words[0].strip("-") in err


@pytest.mark.parametrize("speed", [0.4, 3.0])
def test_a_path_that_no_part_can_follow_is_followed_more_slowly(speed):
    """As in the loop, where the planner's references slow down."""
    scenario = load_scenario("follow_2")
    paths = tuple(replace(path, speed=speed) for path in scenario.task.paths)
    done = rehearse(RIG, replace(scenario, task=replace(scenario.task, paths=paths)), 0)
    assert done.speed < speed / 2
    assert 2 * 0.56 / speed < done.time_s < np.inf


def test_targets_at_the_minimum_allowed_distance_are_reached():
    scenario = load_scenario("assemble_8")
    near = 2.5 * RIG.parts.radius_m * np.array([[-1, 0], [1, 0], [0, 1], [0, -1], [0, 0]])
    task = replace(scenario.task, labels=("black",) * 5, place=tuple(map(tuple, near)))
    parts = (replace(scenario.parts[0], label="black", count=5),)
    assert rehearse_task(RIG, replace(scenario, parts=parts, task=task), 1).likely


def test_command_reports_a_sufficient_time_limit(command, tmp_path):
    text = config_path("scenarios/sort_4.yaml").read_text(encoding="utf-8")
    path = tmp_path / "soon.yaml"
    path.write_text(re.sub("time_limit_s: .*", "time_limit_s: 1.5", text), encoding="utf-8")
    code, out, _ = command("--scenario", path)
    assert code == 1
    assert re.search(r"; or a time_limit_s of \d+ s", out)
