"""Recorded runs: the state shown at a time, and playback."""

import os
import sqlite3
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")
rosbag2 = pytest.importorskip("rosbags.rosbag2")

from ament_index_python.packages import get_package_share_directory  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from plate_core import PlateError  # noqa: E402
from plate_core.ros import start_nodes  # noqa: E402
from plate_interfaces.msg import Part, Parts, TaskStatus  # noqa: E402
from plate_view.commands import Command  # noqa: E402
from plate_view.node import PageNode  # noqa: E402
from plate_view.ros import Replay  # noqa: E402

KINDS = {"parts": Parts, "task_status": TaskStatus}
BEGIN_S = 1_700_000_000.0


def _types():
    types = get_typestore(Stores.ROS2_JAZZY)
    for path in Path(get_package_share_directory("plate_interfaces")).glob("msg/*.msg"):
        name = f"plate_interfaces/msg/{path.stem}"
        types.register(get_types_from_msg(path.read_text(encoding="utf-8"), name))
    return types


@pytest.fixture
def bag(tmp_path):
    """Five seconds: a part that moves 1 mm each 0.1 s, and a task that begins after 0.05 s."""
    types = _types()
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        lines = {
            topic: writer.add_connection(
                f"/left/{topic}", f"plate_interfaces/msg/{kind.__name__}", typestore=types
            )
            for topic, kind in KINDS.items()
        }

        def say(topic, t, msg):
            writer.write(lines[topic], round(1e9 * (BEGIN_S + t)), serialize_message(msg))

        for k in range(51):
            say("parts", 0.1 * k, Parts(parts=[Part(id="a_1", x=1e-3 * k)]))
            if k == 0:
                say("task_status", 0.05, TaskStatus(text="begun"))
    return tmp_path / "bag"


@pytest.fixture
def received():
    return []


MIXED = KINDS | {"rosout": String, "image_raw": String}


def mixed_bag(folder, *topics):
    """A bag with one message on each topic that contains the name of the topic. A topic of the
    robot has another type than that of a plate."""
    types = _types()
    with rosbag2.Writer(folder, version=9) as writer:
        for topic in topics:
            kind = String if topic.startswith("/robot/") else MIXED[topic.rpartition("/")[2]]
            msg = Parts(parts=[Part(id=topic)]) if kind is Parts else kind()
            if kind is not Parts:
                setattr(msg, "text" if kind is TaskStatus else "data", topic)
            name = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
            line = writer.add_connection(topic, name, typestore=types)
            writer.write(line, round(1e9 * BEGIN_S), serialize_message(msg))
    return folder


@pytest.mark.parametrize(
    ("namespace", "topics", "shown"),
    [
        ("/", ["/a/parts", "/rosout"], {"/a/parts", "/rosout"}),
        ("/b", ["/a/parts", "/rosout"], {"/a/parts", "/rosout"}),
        ("/b", ["/a/parts", "/b/parts", "/a/task_status"], {"/b/parts"}),
        ("/", ["/parts", "/a/parts", "/a/image_raw"], {"/parts"}),
        ("/a", ["/a/parts", "/b/parts", "/eye/image_raw"], {"/a/parts", "/eye/image_raw"}),
        ("/a", ["/a/parts", "/a/image_raw", "/eye/image_raw"], {"/a/parts", "/a/image_raw"}),
        ("/a", ["/a/parts", "/ear/image_raw", "/eye/image_raw"], {"/a/parts"}),
        ("/a", ["/a/parts", "/robot/parts"], {"/a/parts"}),
        ("/robot", ["/parts", "/robot/parts"], {"/parts"}),
    ],
)
def test_the_replay_shows_only_one_of_several_plates(tmp_path, namespace, topics, shown):
    received = []
    replay = Replay(
        mixed_bag(tmp_path / "bag", *topics),
        MIXED,
        lambda key, msg: received.append(msg),
        namespace,
    )
    received.clear()
    replay.seek(BEGIN_S)
    replay.close()
    names = {str(getattr(msg, "data", getattr(msg, "text", ""))) for msg in received} - {""}
    assert names | {part.id for msg in received for part in getattr(msg, "parts", ())} == shown
    space = next(name for name in shown if name.endswith("parts")).removesuffix("/parts")
    assert replay.namespace == (space or "/")


def test_a_bag_of_several_plates_needs_a_namespace(tmp_path):
    bag = mixed_bag(tmp_path / "bag", "/a/parts", "/b/task_status")
    with pytest.raises(
        PlateError, match=r"several plates, allowed: .* \(/a, /b\), such as -r __ns:=/a"
    ):
        Replay(bag, MIXED, print, "/cell")


@pytest.fixture
def replay(bag, received):
    made = Replay(bag, KINDS, lambda topic, msg: received.append((topic, msg)))
    yield made
    made.close()


def test_a_jump_restores_the_messages_of_that_time(replay, received):
    received.clear()
    replay.seek(BEGIN_S + 4.02)
    shown = dict(received)
    assert shown["parts"].parts[0].x == pytest.approx(0.040)
    assert shown["task_status"].text == "begun"  # latched: published long before
    assert len(received) == 2
    received.clear()
    replay.seek(BEGIN_S - 7)
    assert (replay.now, dict(received)["parts"].parts[0].x) == (replay.begin, 0.0)
    assert "task_status" not in dict(received)
    replay.seek(BEGIN_S + 99)
    assert replay.now == replay.end == pytest.approx(BEGIN_S + 5)


def test_a_replay_runs_at_its_rate_and_ends(replay, received, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("plate_view.ros.replay.time.monotonic", lambda: clock[0])
    replay.step()
    received.clear()
    clock[0] += 1.0
    replay.step()
    assert received == []  # it does not play yet
    replay.set_rate(2.0)
    replay.play(True)
    clock[0] += 0.5
    replay.step()
    assert replay.now == pytest.approx(BEGIN_S + 1.0)
    assert dict(received)["parts"].parts[0].x == pytest.approx(0.010)
    clock[0] += 60
    replay.step()
    assert not replay.playing
    assert dict(received)["parts"].parts[0].x == pytest.approx(0.050)
    replay.play(True)
    assert replay.now == replay.begin  # from the beginning again
    with pytest.raises(PlateError, match="rate is 100, allowed"):
        replay.set_rate(100.0)


def test_a_folder_without_a_recorded_run_is_refused(tmp_path, bag):
    with pytest.raises(PlateError, match="allowed: the folder of a recorded run"):
        Replay(tmp_path / "nothing", KINDS, print)
    with pytest.raises(PlateError, match="allowed: a bag with topics of image"):
        Replay(bag, {"image": Parts}, print)
    (data,) = bag.glob("*.db3")
    data.write_bytes(data.read_bytes()[:100])
    with pytest.raises(PlateError, match="allowed"):
        Replay(bag, KINDS, print)
    for file in (data, bag / "metadata.yaml"):
        file.unlink()
        os.mkfifo(file)  # a pipe without a writer
        with pytest.raises(PlateError, match=f"{file.name}: is a FIFO, allowed: a regular file"):
            Replay(bag, KINDS, print)
        file.unlink()
        file.touch()


def test_a_damaged_record_is_reported(replay, monkeypatch):
    def messages(*wanted):
        raise rosbag2.ReaderError("truncated record")
        yield

    monkeypatch.setattr(replay._reader, "messages", messages)
    why = r"bag is damaged \(.*truncated record.*\), allowed: an intact bag"
    with pytest.raises(PlateError, match=why):
        replay.seek(BEGIN_S + 1)


def test_a_bag_that_is_damaged_in_the_middle_plays_up_to_there(bag, received, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("plate_view.ros.replay.time.monotonic", lambda: clock[0])
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as lines:
        lines.execute(
            "UPDATE messages SET data = ? WHERE timestamp = ?",
            (b"\x00\x01\x00\x00\xff", round(1e9 * (BEGIN_S + 3.0))),
        )
    lines.close()
    replay = Replay(bag, KINDS, lambda topic, msg: received.append((topic, msg)))
    replay.play(True)
    for _ in range(60):
        clock[0] += 0.1
        replay.step()
    assert not replay.playing
    assert replay.now == pytest.approx(BEGIN_S + 3.0, abs=0.11)
    assert "bag is damaged (" in replay.problem
    assert "), allowed: an intact bag" in replay.problem
    assert received[-1][1].parts[0].x == pytest.approx(0.029, abs=0.0015)
    replay.play(True)  # the rest of it is whole
    assert replay.problem == ""
    for _ in range(60):
        clock[0] += 0.1
        replay.step()
    assert (received[-1][1].parts[0].x, replay.problem) == (pytest.approx(0.050), "")
    replay.close()


def test_the_page_shows_what_was_recorded(bag):
    rclpy.init(args=["--ros-args", "-p", f"bag:={bag}"])
    try:
        node = PageNode()
        try:
            start_nodes(node)
            node._replay.seek(BEGIN_S + 4.02)
            assert node._listener.task.text == "begun"
            assert node._listener._newest["parts"].parts[0].x == pytest.approx(0.040)
            node.trigger_deactivate()
            node._queue_command(
                None, Command("replay", 1, {})
            )  # received before, by the server's thread
            node._process_next()
            assert not node._inbox
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
