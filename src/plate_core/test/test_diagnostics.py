"""Diagnostics come by the steady clock, whatever comes in and whatever ROS time does."""

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from stepped_clock import SteppedExecutor  # noqa: E402

from plate_core.ros import (  # noqa: E402
    DATA,
    DIAGNOSTICS_PERIOD_S,
    Diagnostics,
    msg_to_reports,
)
from plate_core.status import Finding, Level  # noqa: E402


@pytest.fixture
def talker(clock):
    """A node whose simulated clock is stopped, and its received diagnostics."""
    words = ["--ros-args", "-p", "use_sim_time:=true", "-r", "__ns:=/diagnostics_test"]
    rclpy.init(args=words)
    node, executor, received = rclpy.create_node("talker"), SteppedExecutor(clock), []
    executor.add_node(node)
    node.create_subscription(DiagnosticArray, "diagnostics", received.append, DATA)
    yield node, received, executor
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


def test_reports_are_published_while_simulated_time_stands_still(talker, clock):
    node, received, executor = talker
    periods = []
    began = clock.monotonic()
    Diagnostics(
        node,
        lambda now: Finding(Level.OK, "all well"),
        lambda: {"count": len(periods), "share": 0.5},
        lambda: "plate",
        lambda: periods.append(1),
    )
    executor.until(lambda: len(received) >= 2)
    assert clock.monotonic() - began == pytest.approx(2 * DIAGNOSTICS_PERIOD_S)
    status = received[-1].status[0]
    assert (status.name, status.hardware_id) == ("/diagnostics_test/talker", "plate")
    assert (status.level, status.message) == (b"\x00", "all well")
    assert {item.key: item.value for item in status.values} == {"count": "1", "share": "0.5"}


@pytest.mark.parametrize("namespace", ["/left", "/cell/left", "/"])
def test_diagnostics_are_read_also_those_of_others_but_not_of_other_plates(namespace):
    """Several plates can share the topic."""
    own = f"{namespace}/driver".replace("//", "/")
    names = ["/driver", "/left/driver", "/cell/left/driver", "/cell/driver", "/left/cell/driver"]
    both = [DiagnosticStatus(name=each, level=DiagnosticStatus.WARN) for each in names]
    reports = [*msg_to_reports(DiagnosticArray(status=both), namespace)]
    assert reports == [("driver", Level.WARN, "", {}, True)]
    assert own in names
    ours = DiagnosticStatus(name=own, level=DiagnosticStatus.STALE, message="?")
    ours.values = [KeyValue(key="cycles", value="3")]
    theirs = DiagnosticStatus(
        name="camera: frame rate", level=DiagnosticStatus.WARN, message="slow"
    )
    strange = DiagnosticStatus(name="lidar", level=b"\x09", message="?")
    assert list(msg_to_reports(DiagnosticArray(status=[ours, strange, theirs]), namespace)) == [
        ("driver", Level.STALE, "?", {"cycles": "3"}, True),
        ("camera: frame rate", Level.WARN, "slow", {}, False),
    ]


def test_a_worse_level_is_reported_at_once_and_only_once(talker):
    node, received, executor = talker
    level = [Level.OK]
    reports = []
    Diagnostics(node, lambda now: Finding(level[0], ""), dict, reported=lambda: reports.append(1))
    executor.until(lambda: len(received) == 1)
    for worse in (Level.WARN, Level.STALE, Level.ERROR):
        level[0], count = worse, len(reports)
        executor.until(lambda worse=worse: received[-1].status[0].level == bytes([worse]))
        if len(reports) == count:  # published between two reports, which continue to count
            before = len(received)
            executor.until(lambda count=count: len(reports) > count)
            executor.until(lambda before=before: len(received) > before)
            assert len(received) == before + 1
    level[0] = Level.OK
    executor.until(lambda: received[-1].status[0].level == b"\x00")
