"""A subscription that an executor does not know of, and the caller of a logger."""

import inspect
import os
import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="rclpy is not installed")
from rclpy.impl.rcutils_logger import CallerId  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from plate_core.ros import DATA, LATCHED, UnlockedSubscription  # noqa: E402


@pytest.fixture(name="node")
def _node():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("unlocked", context=context, namespace=f"/unlocked_{os.getpid()}")
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def taken(subscription):
    end = time.monotonic() + 20
    while time.monotonic() < end:
        if (found := subscription.take()) is not None:
            return found
        time.sleep(0.01)
    pytest.fail("no message")


def test_takes_messages_in_order_and_the_beginning_of_long_ones(node):
    publisher = node.create_publisher(String, "words", DATA)
    subscription = UnlockedSubscription(node, String, "words", DATA, 100)
    assert subscription.take() is None
    end = time.monotonic() + 20
    while not publisher.get_subscription_count() and time.monotonic() < end:
        time.sleep(0.01)
    for word in ("one", "two", 1000 * "x"):
        publisher.publish(String(data=word))
    sources = set()
    for word in ("one", "two"):
        data, size, source = taken(subscription)
        sources.add(source)
        assert deserialize_message(data, String).data == word
        assert size == len(data)
    data, size, source = taken(subscription)
    assert len(data) == 100
    assert size > 1000
    assert sources == {source}


def test_publishers_of_nodes_with_one_name_are_distinguished(node):
    subscription = UnlockedSubscription(node, String, "words", DATA, 100)
    publishers = [node.create_publisher(String, "words", DATA) for _ in range(2)]
    sources = {}
    for word, publisher in zip(("one", "two"), publishers, strict=True):
        end = time.monotonic() + 20
        while not publisher.get_subscription_count() and time.monotonic() < end:
            time.sleep(0.01)
        for _ in range(2):
            publisher.publish(String(data=word))
            data, _, source = taken(subscription)
            sources.setdefault(deserialize_message(data, String).data, set()).add(source)
    assert [len(sources[word]) for word in ("one", "two")] == [1, 1]
    assert sources["one"] != sources["two"]


def test_waiting_ends_with_a_message_after_the_time_and_without_ros():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("waits", context=context, namespace=f"/unlocked_{os.getpid()}")
    publisher = node.create_publisher(String, "words", LATCHED)
    publisher.publish(String(data="one"))
    subscription = UnlockedSubscription(node, String, "words", LATCHED, 100)
    subscription.wait(60.0)
    assert subscription.take() is not None
    subscription.wait(0.001)
    assert subscription.take() is None
    node.destroy_node()
    rclpy.shutdown(context=context)
    subscription.wait(0.001)
    assert subscription.take() is None
    subscription.destroy()


def test_a_destroyed_subscription_receives_no_message(node):
    subscription = UnlockedSubscription(node, String, "words", DATA, 100)
    subscription.destroy()
    assert subscription.take() is None
    subscription.destroy()


def test_a_logger_names_its_caller_without_reading_the_source(monkeypatch):
    monkeypatch.setattr(inspect, "findsource", None)
    caller, line = CallerId(), inspect.currentframe().f_lineno
    name = "test_a_logger_names_its_caller_without_reading_the_source"
    assert caller[:3] == (name, __file__, line)
