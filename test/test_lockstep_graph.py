"""The real graph in lockstep, in which the simulator waits for the cycle of each image: it goes on
after stops in mid-task, and a measurement that it would never end is ended."""

import pytest

pytest.importorskip("rclpy")

from graph.session import session
from light_graph import LightOptions

from plate_core.ros import DATA, LATCHED, nanoseconds
from plate_interfaces.msg import Friction, Parts
from plate_interfaces.srv import MeasureFriction

WAIT_S = 60.0


def test_a_stop_in_mid_task_and_a_measurement_do_not_block_the_graph(tmp_path):
    options = LightOptions(scenario="sort_4", seed=3, lockstep=True, autostart=False)
    with session(options, tmp_path, pictures=False) as graph:
        observer, stamps, friction = graph.observer, [0], []
        for kind, topic, qos, on_message in (
            (Parts, "ground_truth", DATA, lambda m: stamps.append(nanoseconds(m.header.stamp))),
            (Friction, "friction", LATCHED, friction.append),
        ):
            observer.node.create_subscription(kind, topic, on_message, qos)

        def goes_on():
            """Whether two more images are taken: the first may be on its way."""
            later = len(set(stamps)) + 2
            return observer.until(lambda: len(set(stamps)) >= later, WAIT_S)

        graph.free()
        observer.await_ready()
        for stop in ("stop", "emergency_stop"):
            task = observer.client.start(graph.scenario)
            assert goes_on()
            observer.trigger(stop)
            assert observer.until(lambda task=task: task.ended, WAIT_S)
            if stop == "emergency_stop":
                observer.enable()
            assert goes_on(), stop
            observer.await_ready()

        request = MeasureFriction.Request(start=True)
        assert observer.call(MeasureFriction, "measure_friction", request).success
        assert observer.until(lambda: friction and friction[-1].state != Friction.RUNNING, WAIT_S)
        assert friction[-1].state == Friction.FAILED
        assert "simulated time has stopped" in friction[-1].text
        assert goes_on()
