"""A subscription whose messages, however large, are taken while Python's other threads run on.

rclpy takes a message with the interpreter's lock held: one of a million points holds up every
thread of the process for a tenth of a second and more, one that has to stop motors too. Here
`rcl_take_serialized_message` is called through ctypes, which lets go of the lock.
"""

from __future__ import annotations

import ctypes
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.type_support import check_is_valid_msg_type

from ..errors import PlateError


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
    """A subscription that is looked after with `take`; no executor knows of it.

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
