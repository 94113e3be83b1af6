"""Framing of packets on the serial line. Consistent overhead byte stuffing (COBS) marks the end of
a frame, and a CRC-32 detects damaged frames."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from ..errors import FrameError

MAX_PACKET = 253
"""Maximum size of a packet with its CRC [bytes]. COBS needs one byte of overhead for up to 254
bytes. Therefore every frame consists of the packet, its CRC, the byte of overhead and the end
byte."""

CRC_BYTES = 4
END = 0
"""The byte that ends a frame. This byte occurs nowhere else in a frame."""


def frame(packet: bytes) -> bytes:
    """Return the frame of a packet: the COBS code of the packet and its CRC-32 (IEEE 802.3), then
    the end byte.

    Raises
    ------
    FrameError
        If the packet is empty or too long.
    """
    if not 0 < len(packet) <= MAX_PACKET - CRC_BYTES:
        raise FrameError(f"packet has {len(packet)} bytes, allowed: 1 to {MAX_PACKET - CRC_BYTES}")
    whole = packet + zlib.crc32(packet).to_bytes(CRC_BYTES, "little")
    coded, index = bytearray(b"\0" + whole + b"\0"), 0
    while (after := coded.find(END, index + 1)) > 0:
        coded[index] = after - index
        index = after
    return bytes(coded)


def unframe(encoded: bytes) -> bytes:
    """Return the packet in a frame. `encoded` is the frame without its end byte.

    Raises
    ------
    FrameError
        If the frame is damaged.
    """
    if not CRC_BYTES + 2 <= len(encoded) <= MAX_PACKET + 1:
        raise FrameError(
            f"frame has {len(encoded)} bytes, allowed: {CRC_BYTES + 2} to {MAX_PACKET + 1}"
        )
    if END in encoded:
        raise FrameError(f"frame contains the end byte at byte {encoded.index(END)}")
    decoded, index = bytearray(encoded), 0
    while index < len(encoded):
        decoded[index] = 0
        index += encoded[index]
    if index > len(encoded):
        raise FrameError(
            f"the last COBS block ends {index - len(encoded)} bytes after the frame's end"
        )
    packet = bytes(decoded[1:-CRC_BYTES])
    crc = int.from_bytes(decoded[-CRC_BYTES:], "little")
    if zlib.crc32(packet) != crc:
        raise FrameError(f"frame's CRC is {crc:#010x}, allowed: {zlib.crc32(packet):#010x}")
    return packet


@dataclass(frozen=True)
class Reader:
    """Decoder that splits a stream of bytes into packets. The decoder can receive the stream in
    pieces of any size.

    Attributes
    ----------
    held : bytes
        Bytes of an incomplete frame.
    lost : bool
        Whether the incomplete frame is too long. The reader ignores such a frame up to its end.
    refused : int
        Number of damaged frames so far.
    """

    held: bytes = b""
    lost: bool = False
    refused: int = 0

    def fed(self, data: bytes) -> tuple[Reader, list[bytes]]:
        """Return the reader after it has received more bytes, and the packets that are complete."""
        *ended, rest = (self.held + data).split(b"\0")
        packets, lost, refused = [], self.lost, self.refused
        for encoded in ended:
            if encoded and not lost:
                try:
                    packets.append(unframe(encoded))
                except FrameError:
                    refused += 1
            lost = False
        if len(rest) > MAX_PACKET + 1:
            refused += not lost
            lost = True
        return Reader(b"" if lost else rest, lost, refused), packets
