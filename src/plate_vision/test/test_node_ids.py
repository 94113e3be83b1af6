"""Ids of the detector's parts: reset, the planner's prediction, and ids that end."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, Graph, image, names, plan
from std_srvs.srv import Trigger

from plate_core import Parts
from plate_core.ros import msg_to_parts

pytestmark = pytest.mark.usefixtures("detector_time")


def test_reset_forgets_all_parts(graph, draw, rng):
    two = image(draw(CENTRE_PX, ["grey", "grey"], rng, radius=7.9), 1.0)
    one = [draw(CENTRE_PX[1:], ["grey"], rng, radius=7.9) for _ in range(2)]
    assert names(graph.answer(two)) == ["grey_1", "grey_2"]
    assert names(graph.answer(image(one[0], 1.1))) == ["grey_2"]
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    assert done.result().success
    assert done.result().message == "2 parts forgotten"
    assert names(graph.answer(image(one[1], 1.2))) == ["grey_1"]


def test_part_forces_identify_the_parts(graph, draw, rng):
    """A row moves on by its own spacing; without the prediction it seems to rest, and one to be
    gone at one end and another new at the other."""
    row = np.array([[150.0, 240.0], [185.0, 240.0], [220.0, 240.0]])

    def seen(places, stamp):
        frame = draw(places, ["grey"] * len(places), rng, radius=7.9)
        return msg_to_parts(graph.answer(image(frame, stamp)))

    seen(row, 1.0)
    before = seen(row, 1.2)
    calibration = graph.detector._vision.calibration
    moved = Parts.make(before.ids, calibration.to_home(row + [35.0, 0.0]))
    plan(graph, moved, 1.4)
    after = seen(row + [35.0, 0.0], 1.4)
    assert after.ids == before.ids == ("grey_1", "grey_2", "grey_3")
    assert np.abs(after.position - moved.position).max() < 1e-4
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    assert graph.detector._expected is None


def test_ids_that_end_are_reported(draw, rng):
    graph = Graph(max_missed=1)
    try:
        both = draw(CENTRE_PX, ["grey", "grey"], rng, radius=7.9)
        one = draw(CENTRE_PX[:1], ["grey"], rng, radius=7.9)
        for k, frame in enumerate((both, one, one)):
            graph.answer(image(frame, 1.0 + 0.1 * k))
        assert "lost after 2 images: grey_2" in graph.notes
        assert graph.detector._diagnostic_values()["ids_given_up"] == 1
        black = draw(CENTRE_PX[:1], ["black"], rng, radius=7.9)
        for k in range(8):
            graph.answer(image(black, 2.0 + 0.1 * k))
        assert "grey_1 has changed its class: its id is now black_1" in graph.notes
        assert graph.detector._diagnostic_values()["ids_renamed"] == 1
    finally:
        graph.close()
