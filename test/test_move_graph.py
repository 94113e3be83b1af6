"""The task of move in the real graph: a script drags a part, puts one down, and takes one off."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from graph.session import session
from light_graph import LightOptions

from plate_core import PlateError
from plate_core.ros import DATA, LATCHED, msg_to_parts
from plate_core.tasks import PartTarget, load_scenario
from plate_interfaces.msg import Parts, Targets, TaskStatus
from plate_interfaces.srv import PlacePart, RemovePart

CLEAR_M = 0.03
"""A place is clear of a part whose centre is further away."""


def clear_place(parts, near=None):
    """The clear place that is nearest to another; without one that which is furthest from all."""
    grid = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 21), np.linspace(-0.08, 0.08, 9)), -1)
    places = grid.reshape(-1, 2)
    away = np.hypot(*(places[:, None] - parts.position).transpose(2, 0, 1)).min(axis=1)
    if near is not None:
        away = np.where(away > CLEAR_M, -np.hypot(*(places - near).T), -np.inf)
    return tuple(places[int(np.argmax(away))].tolist())


def nearest(parts, place):
    """Id of the part that is nearest to a place, and how far it is [m]."""
    away = np.hypot(*(parts.position - place).T)
    return parts.ids[int(np.argmin(away))], float(np.min(away))


def test_a_script_drags_parts_of_the_real_graph(tmp_path):
    options = LightOptions(scenario="play", seed=1, lockstep=True, autostart=False)
    with session(options, tmp_path, pictures=False) as graph:
        observer, latest = graph.observer, {"part_targets": Targets()}  # no target published yet
        for kind, topic, qos in (
            (Parts, "ground_truth", DATA), (Parts, "parts", DATA),
            (Targets, "part_targets", LATCHED), (TaskStatus, "task_status", LATCHED),
        ):  # fmt: skip
            observer.node.create_subscription(
                kind, topic, lambda msg, topic=topic: latest.update({topic: msg}), qos
            )
        graph.free()
        observer.await_ready()
        plate = observer.client
        task = plate.start(load_scenario("play"))

        def text():
            return latest["task_status"].text

        def truth():
            return msg_to_parts(latest["ground_truth"])

        assert observer.until(lambda: {"parts", "ground_truth", "task_status"} <= latest.keys(), 10)
        seen = msg_to_parts(latest["parts"])
        start = seen.position[seen.ids.index("black_1")]
        for place in ((0.15, 0.05), clear_place(seen, start)):  # the second while it is on its way
            with pytest.raises(PlateError, match=r"black_77 is unknown, allowed: black_1, .*grey"):
                plate.move_targets([PartTarget("black_1", place), PartTarget("black_77", place)])
            assert observer.until(
                lambda place=place: [(t.id, t.x, t.y) for t in latest["part_targets"].targets]
                == [("black_1", *place)], 10
            )  # fmt: skip
        assert observer.until(lambda: text().startswith("running: 1 of 1 at their"), 100), text()
        # Within tolerance_m, as the camera sees it; the truth of that image may be on its way.
        assert observer.until(lambda: nearest(truth(), place)[1] < 2.3e-3, 20)
        assert nearest(truth(), place)[0].startswith("black_")

        x, y = clear_place(truth())
        request = PlacePart.Request(type="grey", x=x, y=y)
        answer = observer.call(PlacePart, "simulator/place_part", request)
        assert answer.success, answer.message
        assert observer.until(lambda: len(latest["parts"].parts) == 11, 20)
        assert latest["task_status"].state == TaskStatus.RUNNING
        new, away = nearest(msg_to_parts(latest["parts"]), (x, y))
        assert away < 0.01
        place = clear_place(truth(), (x, y))
        plate.move_targets([PartTarget(new, place)])
        assert observer.until(lambda: text().startswith("running: 2 of 2 at their"), 100), text()
        assert not task.ended

        true, _ = nearest(truth(), place)
        answer = observer.call(RemovePart, "simulator/remove_part", RemovePart.Request(id=true))
        assert answer.success, answer.message
        status = plate.wait(task, 30.0)
        assert (status.state, status.reason) == (TaskStatus.LOST, TaskStatus.PART_UNSEEN)
        assert f"{new} was last detected at (" in status.text
