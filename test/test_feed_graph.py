"""The feeder in the real graph: a robot takes parts over TCP; stops, and how to continue."""

import json
import re

import pytest
import yaml

pytest.importorskip("rclpy")

from graph.observer import Record
from graph.robot import Grip, Robot, feed_result
from graph.session import session
from light_graph import LightOptions
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core import config_path
from plate_core.ros import DATA
from plate_interfaces.srv import PartQuantity

PICKS = 4


@pytest.fixture(name="graph", scope="module")
def _graph(tmp_path_factory):
    """With half as many parts as `feed`: a purge is over sooner."""
    folder = tmp_path_factory.mktemp("feed")
    few = yaml.safe_load(config_path("scenarios/feed.yaml").read_text(encoding="utf-8"))
    few["parts"][0]["count"] = 4
    few["task"]["hopper"] |= {"fill": 6, "least": 5}
    (folder / "feed.yaml").write_text(yaml.safe_dump(few), encoding="utf-8")
    options = LightOptions(
        scenario=str(folder / "feed.yaml"), seed=1, autostart=False, robot_port=0, rate=0.5
    )
    with session(options, folder, pictures=False) as graph:
        graph.free()
        graph.observer.await_ready()
        yield graph


@pytest.fixture(name="robot")
def _robot(graph):
    observer = graph.observer
    assert observer.until(lambda: bool(observer.record.last("feeder", "port")), 10)
    port = int(observer.record.last("feeder", "port"))
    with Robot(observer, port, cycle_s=1.5) as robot:
        yield robot


def moves(observer):
    """List that is filled with the tables in which a motor moves."""
    found = []

    def on_table(msg):
        if any(any(point.positions) for point in msg.points):
            found.append(msg)

    observer.node.create_subscription(JointTrajectory, "motor_setpoints", on_table, DATA)
    return found


def test_a_robot_takes_parts_from_the_reported_places(graph, robot):
    table = moves(graph.observer)
    graph.observer.until(lambda: False, 2.0)
    assert not table, "nothing moves before somebody asks"
    assert all(grip is robot.grips[-1] for grip in robot.work(PICKS))
    assert table, "parts were led to the window"
    result = feed_result(robot.grips, graph.observer.record, PICKS, ["black"])
    assert result["success"], result
    answer = graph.observer.call(PartQuantity, "part_quantity", PartQuantity.Request())
    assert (answer.taken, answer.lost) == (PICKS, 0)
    code, text = robot.ask("part_quantity")
    assert code == 200
    assert f"taken={PICKS}" in text


def test_a_plate_with_a_reserved_part_rests_and_a_stop_is_reported_at_once(graph, robot):
    observer = graph.observer
    code, text = robot.ask("get_part")
    assert code == 200, text
    table = moves(observer)
    observer.until(lambda: False, 0.3)
    table.clear()
    observer.until(lambda: False, 2.0)
    assert not table, "a robot may stand over the plate"
    assert "state=reserved" in robot.ask("state")[1]
    assert robot.ask("part_taken failed")[0] == 200
    assert robot.ask("part_taken failed")[0] == 410, "no part is reserved any more"
    observer.call(Trigger, "simulator/reset", Trigger.Request())
    robot.send("get_part")
    observer.until(lambda: False, 0.05)
    observer.trigger("stop")
    code, text = robot.answer(2.0)
    assert code in (200, 503), text
    if code == 503:
        assert "stopped" in text
    assert observer.until(lambda: "call=resume_feeding" in robot.ask("state")[1], 5)
    observer.until(lambda: False, 1.0)
    table.clear()
    for _ in range(5):  # a robot does not cease to ask
        code, text = robot.ask("get_part")
        assert code == 503, text
        assert "resume_feeding" in text
        observer.until(lambda: False, 0.3)
    assert not table, "after a stop nothing moves before a person says so"
    observer.trigger("resume_feeding")
    code, text = robot.ask("get_part")
    assert code == 200, text
    assert robot.ask("part_taken failed")[0] == 200


@pytest.mark.parametrize(("error_m", "success"), [(1e-4, True), (2e-3, False)])
def test_a_grip_error_above_the_limit_is_no_success(error_m, success):
    grip = Grip(0.0, True, error_m, 0.0, 2.0)
    result = feed_result([grip], Record(), 1, ["black"])
    assert json.loads(json.dumps(result)) == result
    assert result["success"] is success


def test_a_second_client_does_not_end_the_reservation_of_another(graph, robot):
    code, text = robot.ask("get_part")
    assert code == 200, text
    name = re.search(r"id=(\S+)", text)[1]
    with Robot(graph.observer, robot.port) as other:
        assert "id=" not in other.ask("state")[1]
        for deed in ("part_taken", f"part_taken {name}", f"part_taken {name} failed"):
            code, text = other.ask(deed)
            assert (code, name in text) == (410, False), text
        code, text = other.ask("get_part")
        assert (code, name in text) == (409, False), text
    assert "state=reserved" in robot.ask("state")[1]
    assert robot.ask(f"part_taken {name} failed")[0] == 200


def test_a_purge_empties_the_plate(graph, robot):
    code, text = robot.ask("purge 60", 70)
    assert (code, text) == (200, "left=0"), text
    quantity = graph.observer.call(PartQuantity, "part_quantity", PartQuantity.Request())
    assert not any(each.count for each in quantity.seen)
    assert quantity.lost == 0
