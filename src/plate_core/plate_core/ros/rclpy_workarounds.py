"""All code that works around limitations of rclpy: the only place for its private names.

Each piece names the issue at github.com/ros2/rclpy, and can go once stock Jazzy has the fix.
"""

from __future__ import annotations

import ctypes
import functools
import traceback
from collections.abc import Callable
from typing import Any

from rclpy.executors import MultiThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.type_support import check_is_valid_msg_type

from ..errors import PlateError

Transition = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def logged(transition: Transition) -> Transition:
    """Log the exception of a transition of a `RclpyLifecycleNode`, and keep it as its `failure`.

    rclpy enters the error state without a message: pull request 1673, open.
    """

    @functools.wraps(transition)
    def wrapper(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except Exception as error:  # any: without a message the error state has no reason
            self.failure = error
            wrong_input = isinstance(error, PlateError)
            if not self.starting:  # `start_nodes` raises this error, so do not log it twice
                text = str(error) if wrong_input else traceback.format_exc()
                self.get_logger().error(f"{transition.__name__}: {text}")
            if wrong_input:
                return TransitionCallbackReturn.FAILURE
            return TransitionCallbackReturn.ERROR

    return wrapper


class RclpyLifecycleNode(LifecycleNode):
    """A `LifecycleNode` that survives wrong requests, and leaves the graph when it is destroyed.

    Attributes
    ----------
    failure : Exception, optional
        Why the last transition failed.
    starting : bool
        Whether the caller of a transition raises its `failure`.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.failure: Exception | None = None
        self.starting = False

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        """Answer a request for a transition that the state does not have with `success: false`.

        rclpy lets the error of its state machine end the process: issue 1209, mended in Rolling by
        pull request 1319. There is no public place for this.
        """
        try:
            # mypy does not know names that Python has mangled.
            return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
        except RuntimeError as error:  # RCLError, which has no public name
            wanted = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {wanted} refused: {error}")
            response.success = False
            return response

    def destroy_node(self) -> None:
        """Destroy the node with its state machine.

        rclpy leaves this to the garbage collector, and until then the node is in the graph. No
        issue of this is known; issue 1710 is the same of another object.
        """
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()


def end_executor(executor: MultiThreadedExecutor, timeout_s: float) -> None:
    """Wait for the callbacks that run, then shut an executor down that no thread spins any more, in
    `timeout_s` [s].

    rclpy's own shutdown destroys objects that these callbacks still use: issue 893, mended in
    Jazzy since 7.1.11 by pull request 1670; issue 1724, open, is the rest of it.
    """
    executor._executor.shutdown()
    executor.shutdown(timeout_sec=timeout_s)


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    ]


class _Bytes(ctypes.Structure):
    """rcutils_uint8_array_t, which is rcl_serialized_message_t."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _Info(ctypes.Structure):
    """rmw_message_info_t."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in ("source_timestamp", "received_timestamp")),
        *((name, ctypes.c_uint64) for name in ("publication_number", "reception_number")),
        ("implementation", ctypes.c_void_p),
        ("publisher", ctypes.c_uint8 * 16),
        ("from_own_process", ctypes.c_bool),
    ]


_rcl = ctypes.CDLL("librcl.so")
_rcutils = ctypes.CDLL("librcutils.so")
_rcutils.rcutils_get_default_allocator.restype = _Allocator
_TAKE = _rcl.rcl_take_serialized_message
_TAKE.argtypes = [ctypes.c_void_p] * 4
_END = _rcutils.rcutils_uint8_array_fini
_END.argtypes = [ctypes.c_void_p]


def deserialized(data: bytes, kind: type) -> Any:
    """Return the message that these bytes are.

    Raises
    ------
    PlateError
        If they are none of this kind: rclpy itself only drops such a message.
    """
    try:
        return deserialize_message(data, kind)
    except Exception:  # also of conversions
        raise PlateError(f"{kind.__name__}: {len(data)} bytes that are none") from None


class UnlockedSubscription:
    """A subscription whose messages, however large, are taken while Python's other threads run on.

    rclpy takes a message with the interpreter's lock held: a message of a million points stops all
    threads of the process for 0.1 s and more, also one that has to stop motors. Here
    `rcl_take_serialized_message` is called through ctypes, which releases the lock: issue 1025,
    open. No executor knows this subscription: its owner calls `take`.

    Parameters
    ----------
    node : Node
    kind : type
        Of the messages.
    topic : str
    qos : QoSProfile
    keep : int
        Bytes of a message that are handed over: of a longer one the beginning.
    """

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile, keep: int) -> None:
        check_is_valid_msg_type(kind)  # loads the type's support
        name = node.resolve_topic_name(topic)
        with node.handle:
            self._handle: Any = rclpy_implementation.Subscription(
                node.handle, kind, name, qos.get_c_qos_profile()
            )
        self.kind, self.topic_name, self._keep = kind, name, keep

    def take(self) -> tuple[bytes, int, bytes] | None:
        """Return the next message as it came, its length, and a key of who published it; None if
        none waits.

        None after `destroy` too: an executor may call a timer that has just been destroyed.
        """
        if self._handle is None:
            return None
        message, info = _Bytes(None, 0, 0, _rcutils.rcutils_get_default_allocator()), _Info()
        with self._handle:
            code = _TAKE(
                self._handle.pointer, ctypes.addressof(message), ctypes.addressof(info), None
            )
        try:
            if code or not message.length:
                return None
            data = ctypes.string_at(message.buffer, min(message.length, self._keep))
            return data, message.length, bytes(info.publisher)
        finally:
            _END(ctypes.addressof(message))

    def destroy(self) -> None:
        """Leave the topic."""
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.destroy_when_not_in_use()
