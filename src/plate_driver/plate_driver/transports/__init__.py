"""Transports that send motor tables to the motors: the interface `Transport` and its
implementations `sim` and `serial`. Another package can add a transport, which is constructed from a
`TransportContext`. docs/transports.md explains this.
"""

from .line import upload_s
from .link import LATE_IN_MOTION, Link
from .serial import CONNECTING, LEAD_S, Port, SerialTransport, make_serial, open_port
from .sim import SimTransport, make_sim
from .thread import ANSWER_S, BUSY, BUSY_S, Latch, TransportThread, high_priority
from .transport import (
    CALL_AGAIN,
    STOPPED_SINCE,
    UNCONNECTED,
    Condition,
    Measured,
    Order,
    Report,
    Transport,
    TransportContext,
    check_transport,
    installed,
    make_transport,
)

__all__ = [
    "ANSWER_S",
    "BUSY",
    "BUSY_S",
    "CALL_AGAIN",
    "CONNECTING",
    "LATE_IN_MOTION",
    "LEAD_S",
    "STOPPED_SINCE",
    "UNCONNECTED",
    "Condition",
    "Latch",
    "Link",
    "Measured",
    "Order",
    "Port",
    "Report",
    "SerialTransport",
    "SimTransport",
    "Transport",
    "TransportContext",
    "TransportThread",
    "check_transport",
    "high_priority",
    "installed",
    "make_serial",
    "make_sim",
    "make_transport",
    "open_port",
    "upload_s",
]
