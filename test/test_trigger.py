"""The camera's trigger line: when it is high, and the loop that it closes."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from device_orders import (
    ENABLE,
    GENTLE,
    HELLO,
    HOMEWARD,
    PERIOD_S,
    alive,
    run,
    say,
    upload,
    wave,
)  # fmt: skip
from short_task import MIDDLE

from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Heartbeat,
    Hello,
    State,
    Status,
    Stop,
    Trigger,
    frame,
)


def ready(phase: float, pulse_ms: int = 2) -> list[bytes | float]:
    return [HELLO, say(100, Trigger(int(phase * 2**16), pulse_ms)), ENABLE, *HOMEWARD]


def edges(done, high: bool = True) -> np.ndarray:
    """When the line has risen, or fallen [us]."""
    return np.array([at for at, level in done.line if level is high])


def first_start(done) -> int:
    """The tick in which the first table has begun [us]."""
    moving = np.flatnonzero(done.setpoints[:, 2].any(axis=1))
    return round(done.times[moving[0]] * 1e6) - 1_000


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.4005, 0.98, 0.999])
def test_each_play_has_one_pulse_at_its_phase(device, phase):
    """Also where a table is taken over, and where the phase is beyond the last tick."""
    orders = [*ready(phase), upload(1, GENTLE, 110, 3), *alive(0.2)]
    done = run(device, *orders, upload(2, wave(0.002), 210, 3), *alive(0.5))
    assert done.state is State.READY
    start, period = first_start(done), round(PERIOD_S * 1e6)
    rises = edges(done)
    plays = 6
    due = start + period * (np.arange(plays) + phase)
    expected = 1000 * np.ceil((due - 1e-6) / 1000)
    playing = rises[(rises >= start) & (rises < start + plays * period + 1000)]
    if phase == 0.999:  # in the tick that ends a play; the last one then rests
        expected = expected[: len(playing)]
    np.testing.assert_array_equal(playing[:plays], expected[: len(playing)])
    assert len(playing) >= plays - 1
    assert set(edges(done, high=False) - rises[: len(done.line) // 2]) == {2_000}


def test_at_rest_and_while_it_brakes_a_camera_sees_ten_images_a_second(device):
    done = run(device, *ready(0.5), *alive(0.5), upload(1, GENTLE, 110), 0.03, say(200, Stop(0)),
               *alive(1.5))  # fmt: skip
    assert done.state is State.OFF
    assert set(np.diff(edges(done))) == {100_000}  # no table came to its phase
    assert len(edges(done)) > 20


def test_without_a_trigger_the_line_is_low(device):
    assert run(device, HELLO, ENABLE, *HOMEWARD, upload(1, GENTLE, 110), *alive(0.3)).line == []
    assert run(device, *ready(0.0, 0), upload(1, GENTLE, 110), *alive(0.3)).line == []
    # It is the session's: another host has to ask for it again; and so has anyone after a reset.
    for other in ([say(1, Hello(VERSION, 78))], ["reset", HELLO]):
        done = run(device, *ready(0.0), 0.15, *other, 0.05, say(1, Heartbeat(1)), 0.3)
        assert not done.line[-1][1]
        assert done.line[-1][0] < 800_000


def test_only_pulses_that_end_before_the_next_are_taken(device):
    right, wrong = say(102, Trigger(7, 8)), b"\x06\x67\0" + b"\x07\0" + b"\x09"
    assert run(device, HELLO, right, 0.2).answers()[102] is Status.DONE
    done = run(device, HELLO, frame(wrong), 0.2)
    assert 103 not in done.answers()
    assert done.line == []


TRIES, ENOUGH = 6, 15
"""Tasks in which images and this number of cycles are collected: on a busy computer a task may end
early."""


def test_images_are_taken_at_half_of_each_cycle_over_a_serial_line(tmp_path):
    """Camera, all nodes and the device in real time: images at half of each cycle."""
    pytest.importorskip("rclpy")
    from graph.session import session
    from light_graph import LightOptions
    from sensor_msgs.msg import Image
    from trajectory_msgs.msg import JointTrajectory

    from plate_bringup import GraphError
    from plate_core import config_path
    from plate_core.ros import DATA, IMAGE, msg_to_cycle, seconds

    rig = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    rig["camera"]["trigger_phase"] = 0.5
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(rig, sort_keys=False), encoding="utf-8")
    images, starts = [], []

    def first_start(msg: JointTrajectory) -> None:
        cycle = msg_to_cycle(msg)
        if cycle.knot_pose.any():
            starts.append((seconds(msg.header.stamp), cycle.period))

    scenario = tmp_path / "middle.yaml"
    scenario.write_text(yaml.safe_dump(MIDDLE), encoding="utf-8")
    options = LightOptions(
        scenario=str(scenario), transport="serial", rig_file=str(file), autostart=False,
        link=str(tmp_path / "port"),
    )  # fmt: skip

    def collect(folder: Path) -> None:
        with session(options, folder, pictures=False) as graph:
            node, record = graph.observer.node, graph.observer.record
            node.create_subscription(
                Image, "image_raw", lambda msg: images.append(seconds(msg.header.stamp)), IMAGE
            )
            node.create_subscription(JointTrajectory, "cycle_started", first_start, DATA)
            try:
                graph.begin()
            except GraphError as error:
                # On a busy computer the driver may send nothing for 0.25 s while the motors go
                # home, and the device then stops them.
                if "host silent" in str(error):
                    return
                raise
            assert graph.observer.until(lambda: record.ended or len(starts) > ENOUGH, 90)

    for task in range(TRIES):
        if len(starts) <= ENOUGH:
            collect(tmp_path / str(task))
    taken = np.array(images)
    phases = [
        (at - begin) / period
        for begin, period in starts
        for at in taken[(taken >= begin) & (taken < begin + period)]
    ]
    assert len(phases) > 5, (len(starts), len(images))
    assert np.median(phases) == pytest.approx(0.5, abs=0.1)
    assert len(phases) < 1.2 * len(starts)  # one in each cycle
