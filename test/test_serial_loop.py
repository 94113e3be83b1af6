"""The closed loop over the serial line in simulated time: it ends well, whatever goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from harness.serial import Operator, PlateCheck, Port, serial_run
from plate_bringup.loop import Setup
from plate_core import load_rig
from plate_core.motion import motor_state
from plate_core.serial_protocol import Fault, State
from plate_driver.transports import LATE_IN_MOTION, SerialTransport
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, LineFaults
from stages.device import shaking_table

TASK = {
    "description": "One part goes to its side.",
    "parts": [{"class": "black", "positions_m": [[0.1, 0.0]]}],
    "task": {"kind": "sort", "sides": {"black": "left"}, "goal_fraction": 0.5, "hold_s": 0.3},
    "time_limit_s": 60,
}


@pytest.mark.parametrize(
    ("trouble", "event"),
    [
        (LineFaults(), ""),
        (LineFaults(corrupted=0.005, dropped=0.005, delay=0.02, baud=921_600.0), ""),
        (LineFaults(), "disconnect"),
        (LineFaults(), "reset"),
    ],
)
def test_the_task_continues_after_a_fault(tmp_path, trouble, event):
    file = tmp_path / "task.yaml"
    file.write_text(yaml.safe_dump(TASK), encoding="utf-8")
    schedule = replace(FaultSchedule(trouble), disconnect_s=0.8)
    last, line = serial_run(Setup(str(file), 3, effort={"restarts": 10}), schedule, event, 1.5)
    assert (last.progress.phase, last.world.dropped) == ("done", 0), (last.progress, line.troubles)
    assert line.plate_check.verdict().kept
    assert line.plate_check.verdict().stroke > 0.2
    assert line.resting
    accidents = set(line.troubles) - ({LATE_IN_MOTION} if trouble.corrupted else set())
    assert bool(accidents) == bool(event)
    assert line.operator.enables == 1 + bool(event)  # after an accident it went on after an enable
    assert (line.transport.retries > 50) == bool(trouble.corrupted)


def verdict(*setpoints):
    judge = PlateCheck(load_rig())
    for k, at in enumerate(setpoints):
        judge.update(k * 1e-3, at)
    return judge.verdict()


@pytest.mark.parametrize(
    ("name", "row", "value"), [("stroke", 0, 0.01), ("speed", 1, 1.0), ("accel", 2, 100.0)]
)
def test_the_judge_detects_values_beyond_the_limits(name, row, value):
    at = np.zeros((3, 4))
    at[row, 2] = value * 1.01
    reported = verdict(at)
    assert getattr(reported, name) >= 1.01 * (1 - 1e-9)
    assert not reported.kept
    assert verdict(np.zeros((3, 4))).kept


def test_the_judge_detects_accelerations_of_corners_and_forces():
    """A turn: motors are nearer to the centre than the corners, and all push."""
    rig = load_rig()
    spin = 90.0  # rad/s2
    _, _, qdd = motor_state(rig, np.zeros((1, 3)), np.zeros((1, 3)), np.array([[0, 0, spin]]))
    reported = verdict(np.stack([np.zeros(4), np.zeros(4), qdd[0]]))
    assert reported.accel == pytest.approx(spin * np.hypot(*rig.plate.half) / rig.limits.accel)
    inertia = rig.plate.mass_kg * (rig.plate.length_m**2 + rig.plate.width_m**2) / 12
    lever = [abs(m.point[0] * m.direction[1] - m.point[1] * m.direction[0]) for m in rig.motors]
    assert reported.force * rig.limits.force >= inertia * spin / sum(lever)
    assert reported.force * rig.limits.force <= inertia * spin / min(lever)


def test_the_judge_detects_a_jump():
    still, moved = np.zeros((3, 4)), np.zeros((3, 4))
    moved[0, 1] = 1e-5
    assert verdict(still, still).kept
    assert verdict(still, moved).jump == pytest.approx(1e-5)
    assert not verdict(still, moved).kept


def test_a_host_that_was_held_up_finds_the_plate_at_rest_and_waits_for_a_person():
    """The line is not silent long enough for the link to fail: only the device has noticed."""
    emulator = Emulator(DeviceLimits.of_rig(load_rig()))
    host = [0.0]  # its time
    transport = SerialTransport(lambda: Port(emulator), lambda: host[0], 1)
    operator = Operator(transport)
    transport.open()

    def run(seconds: float, polls: bool = True) -> None:
        for tick in range(round(seconds * 1e3)):
            emulator.tick()
            host[0] += 1e-3
            if polls and tick % 5 == 0:
                transport.poll()

    run(0.2)
    operator.check(host[0])
    run(1.5)
    transport.send(shaking_table(48, 5e-4), 50)
    run(0.5)
    assert emulator.state is State.PLAYING
    run(0.4, polls=False)
    assert Fault.HOST_SILENT in emulator.faults
    run(3.0)
    assert emulator.state is State.OFF
    assert transport.troubles() == ["device has stopped: host silent"]
    for _ in range(3):  # a look, and one when it has lasted
        operator.check(host[0])
        run(1.0)
    assert operator.enables == 2
    assert emulator.state is State.READY
