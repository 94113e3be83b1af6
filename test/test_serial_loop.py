"""The closed loop over the serial line in simulated time: it ends well, whatever befalls it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from plate_sim.device import Accidents, Trouble

BENCH = str(Path(__file__).resolve().parents[1] / "bench")
TASK = {
    "description": "One part goes to its side.",
    "parts": [{"class": "black", "positions_m": [[-0.10, 0.0]]}],
    "task": {"kind": "sort", "sides": {"black": "left"}, "goal_fraction": 0.5, "hold_s": 0.3},
    "time_limit_s": 60,
}


@pytest.fixture(name="bench")
def _bench(monkeypatch):
    monkeypatch.syspath_prepend(BENCH)
    import loop
    import serial_loop

    yield loop, serial_loop
    for name in ("loop", "serial_loop"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("trouble", "event"),
    [
        (Trouble(), ""),
        (Trouble(corrupted=0.005, dropped=0.005, delay=0.02, baud=921_600.0), ""),
        (Trouble(), "disconnect"),
        (Trouble(), "reset"),
    ],
)
def test_the_task_goes_on(bench, tmp_path, trouble, event):
    loop, serial_loop = bench
    file = tmp_path / "task.yaml"
    file.write_text(yaml.safe_dump(TASK), encoding="utf-8")
    accidents = replace(Accidents(trouble), disconnect_s=0.8)
    ending = serial_loop.serial_run(loop.Setup(str(file), 3), accidents, event, 1.5)
    assert (ending.phase, ending.dropped) == ("done", 0), ending.text
    assert ending.watch.kept
    assert ending.watch.stroke > 0.2
    assert ending.resting
    assert bool(ending.troubles) == bool(event)
    assert (ending.retries > 50) == bool(trouble.corrupted)


def test_the_judge_sees_what_is_outside(bench):
    _, serial_loop = bench
    from plate_core import load_rig

    at = np.zeros((3, 4))
    for row, value in ((0, 0.0101), (1, 1.01), (2, 101.0)):
        watch = serial_loop.Watch(load_rig())
        wrong = at.copy()
        wrong[row, 2] = value
        watch.see(0.0, wrong)
        assert not watch.kept
    watch = serial_loop.Watch(load_rig())
    jumped = at.copy()
    jumped[0, 1] = 1e-5
    watch.see(0.0, at)
    assert watch.kept
    watch.see(0.001, jumped)
    assert not watch.kept
