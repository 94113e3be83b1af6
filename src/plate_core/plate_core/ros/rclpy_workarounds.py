"""Workarounds for limitations of rclpy. Only this module uses private names of rclpy.

The comment of each workaround names the issue at github.com/ros2/rclpy. Remove a workaround when
stock Jazzy contains the fix.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import time
import traceback
from collections.abc import Callable
from types import FrameType, SimpleNamespace
from typing import Any

from rclpy import executors
from rclpy.executors import MultiThreadedExecutor
from rclpy.impl import rcutils_logger
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.type_support import check_is_valid_msg_type

from ..errors import PlateError


def _frame_info(frame: FrameType) -> SimpleNamespace:
    return SimpleNamespace(filename=frame.f_code.co_filename)


# rclpy's logger needs only the name of the caller's file, but it also reads the source of this
# file. Therefore the first log line of a program would take 0.2 s of CPU time. No public issue
# describes this problem.
rcutils_logger.inspect = SimpleNamespace(  # type: ignore[assignment]
    currentframe=inspect.currentframe, getframeinfo=_frame_info
)


class _Handles:
    """Replacement of `ExitStack` in rclpy's executors, which enter the handle of each entity in
    each round. The replacement reduces the CPU time of a round by a quarter. The open issue 1223
    describes this high CPU time."""

    def __init__(self) -> None:
        self._entered: list[Any] = []

    def __enter__(self) -> _Handles:
        return self

    def enter_context(self, handle: Any) -> None:
        handle.__enter__()
        self._entered.append(handle)

    def __exit__(self, *error: object) -> None:
        for handle in self._entered:
            handle.__exit__(*error)


executors.ExitStack = _Handles  # type: ignore[assignment, misc]


def can_execute(entity: Any) -> bool:
    """Return the same result as `Executor.can_execute`, without using its lock. An executor with a
    single thread does not need the lock."""
    group = entity.callback_group
    return not entity._executor_event and getattr(group, "_active_entity", None) is None


Transition = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def log_exceptions(transition: Transition) -> Transition:
    """Decorate a transition of a `RclpyLifecycleNode`: log its exception and store it as `failure`.

    rclpy enters the error state without a message (pull request 1673, open).
    """

    @functools.wraps(transition)
    def wrapper(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except Exception as error:
            # All exceptions are caught, so that the error state always has a reason.
            self.failure = error
            wrong_input = isinstance(error, PlateError)
            # while nodes are started, `start_nodes` raises this error, so do not log the error here
            if not self.starting:
                text = str(error) if wrong_input else traceback.format_exc()
                self.get_logger().error(f"{transition.__name__}: {text}")
            if wrong_input:
                return TransitionCallbackReturn.FAILURE
            return TransitionCallbackReturn.ERROR

    return wrapper


class RclpyLifecycleNode(LifecycleNode):
    """A `LifecycleNode` that continues after a wrong request, and that leaves the ROS graph when it
    is destroyed.

    Attributes
    ----------
    failure : Exception, optional
        Exception of the last transition that failed.
    starting : bool
        Whether the caller of a transition raises the exception in `failure`.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.failure: Exception | None = None
        self.starting = False

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        """Reply `success: false` to a request for a transition that does not exist in the present
        state.

        In rclpy, the error of the state machine ends the process (issue 1209, fixed in Rolling by
        pull request 1319). This class overrides a private method, because rclpy has no public
        method for this purpose.
        """
        try:
            # mypy does not recognise the mangled name of the method.
            return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
        except RuntimeError as error:  # rclpy raises RCLError, a RuntimeError without a public name
            requested = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {requested} refused: {error}")
            response.success = False
            return response

    def destroy_node(self) -> None:
        """Destroy the node with its state machine.

        rclpy leaves the destruction of the state machine to the garbage collector. The node would
        stay in the ROS graph until the garbage collector runs. Issue 1710 reports the same defect
        for another object.
        """
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()


def end_executor(executor: MultiThreadedExecutor, timeout_s: float) -> None:
    """Wait for the running callbacks, then shut down an executor within `timeout_s` [s]. Call this
    function only when no thread spins the executor any more.

    rclpy's own shutdown destroys objects that running callbacks still use (issue 893, fixed in
    Jazzy since 7.1.11 by pull request 1670; issue 1724, open, covers the remaining cases).
    """
    executor._executor.shutdown()
    executor.shutdown(timeout_sec=timeout_s)


class _Allocator(ctypes.Structure):
    """The C struct rcutils_allocator_t."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    ]


class _Bytes(ctypes.Structure):
    """The C struct rcutils_uint8_array_t, also named rcl_serialized_message_t."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _Info(ctypes.Structure):
    """The C struct rmw_message_info_t."""

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
    """Deserialize a message.

    Raises
    ------
    PlateError
        If the bytes are not a message of this kind. rclpy would ignore such bytes without an error.
    """
    try:
        return deserialize_message(data, kind)
    except Exception:  # the conversion of a message can raise errors of different types
        raise PlateError(f"{kind.__name__}: {len(data)} bytes are not a valid message") from None


class UnlockedSubscription:
    """A subscription that takes messages of any size without blocking the other Python threads.

    rclpy holds the global interpreter lock while it takes a message (issue 1025, open). A message
    with a million points blocks all threads of the process for 0.1 s or more, including a thread
    that must stop the motors. This class calls `rcl_take_serialized_message` by ctypes, which
    releases the lock. No executor processes this subscription, so its owner must call `take`.

    Parameters
    ----------
    node : Node
    kind : type
        Message class.
    topic : str
    qos : QoSProfile
    keep : int
        Maximum number of bytes to return. Longer messages are truncated.
    """

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile, keep: int) -> None:
        check_is_valid_msg_type(kind)  # this call loads the type support of `kind`
        name = node.resolve_topic_name(topic)
        with node.handle:
            self._handle: Any = rclpy_implementation.Subscription(
                node.handle, kind, name, qos.get_c_qos_profile()
            )
        self.kind, self.topic_name, self._keep = kind, name, keep
        self._context: Any = node.context

    def wait(self, timeout_s: float) -> None:
        """Wait until a message is available, for at most `timeout_s` [s]. Call this method only
        from the thread that calls `take`."""
        try:
            with self._handle, self._context.handle:
                waiting = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, self._context.handle)
                waiting.clear_entities()
                waiting.add_subscription(self._handle)
                waiting.wait(round(1e9 * timeout_s))
        # ROS was shut down; rclpy raises RCLError, a RuntimeError without a public name
        except RuntimeError:
            time.sleep(timeout_s)

    def take(self) -> tuple[bytes, int, bytes] | None:
        """Return the serialized next message, its full length [bytes], and an id of the publisher.

        Return None if no message is available, or if the subscription has been destroyed. An
        executor may still call a timer of the owner at this time.
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
        """Destroy the subscription."""
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.destroy_when_not_in_use()
