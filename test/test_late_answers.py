"""Answers that begin late, on a computer or a line that is too slow: in the closed loop without
ROS, with a camera that runs free, and with one that is triggered."""

import copy

import pytest
import yaml
from short_task import FEW_STARTS, MIDDLE, short_task, with_few

from plate_bringup.loop import Direct, Setup, run, with_settings

FREE = {"image_rate": "30", "friction_spread": "0.1", "friction_patches": "0.1"}


class Late(Direct):
    """Each answer comes after the end of the cycle that it answers, and waits for that of the
    next."""

    def __init__(self):
        super().__init__()
        self.on_its_way = []

    def send(self, table):
        self.on_its_way.append((self.began, table))

    def play(self, until):
        for began, table in self.on_its_way:
            if began < self.began:
                super().send(table)
        self.on_its_way = [one for one in self.on_its_way if one[0] == self.began]
        return super().play(until)


class Erratic(Direct):
    """Each answer takes 0 to 3 cycles more than it should, by turns; they come in order."""

    EXTRA = (0, 2, 1, 3, 0, 0, 1, 2)

    def __init__(self):
        super().__init__()
        self.on_its_way, self.sent = [], 0

    def send(self, table):
        late = self.EXTRA[self.sent % len(self.EXTRA)]
        self.on_its_way.append((self.began + late * table.cycle.period, table))
        self.sent += 1

    def play(self, until):
        while self.on_its_way and self.on_its_way[0][0] <= self.began:
            super().send(self.on_its_way.pop(0)[1])
        return super().play(until)


def late_run(scenario, seed, method="sinusoids", effort=FEW_STARTS):
    setup = with_settings(Setup(scenario, seed, method, effort=effort), FREE)
    *_, last = run(setup, transport=Late())
    return last


def test_parts_are_not_lost():
    last = late_run(with_few("sort_4"), 2, "rotations", {})
    assert last.progress.phase == "done", last.progress.text
    assert last.world.dropped == 0


def test_a_path_is_followed_nearly_as_fast_and_exactly():
    """With answers that come in time: 0.08 mm in 15.6 s."""
    progress = late_run("follow_2", 0).progress
    assert progress.phase == "done", progress.text
    assert progress.rms_error_m < 0.3e-3
    assert progress.time_s < 20


@pytest.mark.parametrize("settings", [FREE, {}], ids=["free", "triggered"])
def test_a_path_is_followed_though_delays_vary(tmp_path, settings):
    """One correction must not be made as often as the plate repeats its cycle: parts swung to and
    fro by 26 mm."""
    scenario = tmp_path / "short.yaml"
    task = short_task(0.036, 60)
    task["task"]["paths"][0]["speed_mps"] = 0.02
    scenario.write_text(yaml.safe_dump(task), encoding="utf-8")
    setup = with_settings(Setup(str(scenario), 0, effort=FEW_STARTS), settings)
    *_, last = run(setup, transport=Erratic())
    assert last.progress.phase == "done", last.progress.text
    assert last.progress.max_error_m < 0.01


def test_places_are_reached(tmp_path):
    scenario = tmp_path / "middle.yaml"
    near = copy.deepcopy(MIDDLE)  # half of the way
    for group, x in zip(near["parts"], (-0.05, 0.05), strict=True):
        group["positions_m"][0][0] = x
        near["task"]["places_m"][group["class"]][0][0] = -x
    scenario.write_text(yaml.safe_dump(near), encoding="utf-8")
    progress = late_run(str(scenario), 0).progress
    assert progress.phase == "done", progress.text
    assert progress.rms_error_m == pytest.approx(0, abs=2.5e-3)
