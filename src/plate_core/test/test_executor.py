"""The nodes' executor: messages at once, events of the middleware once a second."""

import time
from types import SimpleNamespace

import pytest

rclpy = pytest.importorskip("rclpy")
from rclpy.event_handler import PublisherEventCallbacks  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from plate_core.ros import CAMERA, DATA, NodeExecutor  # noqa: E402
from plate_core.ros.executor import EVENTS_S  # noqa: E402


def test_an_incompatible_partner_is_reported_within_a_second_and_messages_arrive_at_once(
    monkeypatch,
):
    now, reported, received = [100.0], [], []
    clock = SimpleNamespace(monotonic=lambda: now[0])
    monkeypatch.setattr("plate_core.ros.executor.time", clock)
    context = rclpy.Context()
    rclpy.init(context=context)
    node, executor = rclpy.create_node("node", context=context), NodeExecutor(context=context)
    executor.add_node(node)

    def until(condition, seconds):
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.01)
        return condition()

    try:
        executor.spin_once(timeout_sec=0)  # looks for events
        events = PublisherEventCallbacks(incompatible_qos=reported.append)
        node.create_publisher(String, "unfit", CAMERA, event_callbacks=events)
        node.create_subscription(String, "unfit", received.append, DATA)
        node.create_subscription(String, "fit", received.append, DATA)
        fit = node.create_publisher(String, "fit", DATA)
        assert until(lambda: node.count_subscribers("unfit") and fit.get_subscription_count(), 30)
        fit.publish(String(data="here"))
        assert until(lambda: received, 30)
        until(lambda: False, 0.3)
        assert not reported
        now[0] += EVENTS_S
        assert until(lambda: reported, 30)
        assert received == [String(data="here")]
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
