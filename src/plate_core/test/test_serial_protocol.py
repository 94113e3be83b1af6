"""The serial codec: the bytes of firmware/frames.csv, round trips, damaged and random bytes."""

import csv
import struct
import zlib
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plate_core import FrameError  # fmt: skip
from plate_core.serial_protocol import (  # fmt: skip
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    DriveTrouble,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knot,
    Knots,
    Message,
    Packet,
    Pulse,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    Trigger,
    Trouble,
    frame,
    newer,
    pack,
    parse,
    table_crc,
    unframe,
)

ROOT = Path(__file__).resolve().parents[3]
DOCUMENT = (ROOT / "docs/protocol.md").read_text(encoding="utf-8")
with (ROOT / "firmware/frames.csv").open(encoding="utf-8") as table:
    EXAMPLES = [(row["message"], row["frame"]) for row in csv.DictReader(table)]


def f32(*values: float) -> tuple[float, ...]:
    return tuple(float(np.float32(value)) for value in values)


REST = (0.0,) * 4
KNOTS = (
    Knot(0, REST, REST, REST),
    Knot(5_000_000, f32(0.001, -0.002, 0, 0.004), f32(0.25, 0, 0, -0.5), f32(0, 12.5, 0, 0)),
    Knot(10_000_000, REST, REST, REST),
)
SHAKEN = (KNOTS[1].position, KNOTS[1].acceleration)
LIMITS = f32(0.01, 1.0, 100.0, 200.0, 60.0, 0.003)
EXAMPLE_PACKETS = [
    Packet(1, Hello(5, 0x12345678)),
    Packet(2, Heartbeat(1_500_000_000)),
    Packet(3, Enable(0xCAFE)),
    Packet(4, Stop(0)),
    Packet(5, Stop(1)),
    Packet(6, Home()),
    Packet(7, Trigger(0x4000, 2)),
    Packet(256, Begin(7, 3, table_crc(KNOTS))),
    Packet(257, Knots(7, 0, KNOTS)),
    Packet(258, Commit(7, 5)),
    Packet(259, Begin(8, 66, 0x12345678, 10_000_000)),
    Packet(1, Capabilities(5, 0x12345678, 0xCAFE, 4, 2048, 8, 250, *LIMITS, 10_000)),
    Packet(2, Acknowledgement(258, Status.DONE)),
    Packet(3, Acknowledgement(258, Status.JUMP)),
    Packet(4, Pulse(1_500_000_000, 2_000_000)),
    Packet(
        5,
        Telemetry(
            2_000_500,
            State.PLAYING,
            Fault.NONE,
            0xCAFF,
            7,
            2_500_000,
            8,
            1,
            *SHAKEN,
            0.25,
            *f32(1e-4, 0.125),
        ),
    ),
    Packet(6, DriveTrouble(2, Trouble.EMERGENCY, 0x20, 0x8611)),
]


def test_examples_show_all():
    assert [name for name, _ in EXAMPLES] == [type(p.message).__name__ for p in EXAMPLE_PACKETS]
    assert {type(p.message) for p in EXAMPLE_PACKETS} == set(get_args(Message))
    assert f"`{EXAMPLES[0][1]}`" in DOCUMENT


@pytest.mark.parametrize(
    ("example", "text"), list(zip(EXAMPLE_PACKETS, [t for _, t in EXAMPLES], strict=True)), ids=str
)
def test_bytes_are_those_of_the_examples(example, text):
    data = bytes.fromhex(text)
    assert frame(pack(example)) == data
    assert parse(unframe(data[:-1])) == example


def test_cobs_of_zeros():
    assert frame(b"\0\0")[:3] == b"\1\1\5"  # two zeros, then the four bytes of the CRC
    assert zlib.crc32(b"\0\0") & 0xFF  # which has none


unsigned = {"B": 8, "H": 16, "I": 32, "Q": 64}
floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
four = st.tuples(floats, floats, floats, floats)


def u(code: str):
    return st.integers(0, 2 ** unsigned[code] - 1)


messages = st.one_of(
    st.builds(Hello, u("B"), u("I")),
    st.builds(Heartbeat, u("Q")),
    st.builds(Enable, u("H")),
    st.builds(Stop, st.integers(0, 1)),
    st.just(Home()),
    st.builds(Trigger, u("H"), st.integers(0, 8)),
    st.builds(Begin, u("H"), u("H"), u("I")),
    st.builds(
        Knots,
        u("H"),
        u("H"),
        st.lists(st.builds(Knot, u("I"), four, four, four), min_size=1, max_size=4).map(tuple),
    ),
    st.builds(Commit, u("H"), u("H")),
    st.builds(
        Capabilities,
        u("B"), u("I"), u("I"), u("B"), u("H"), u("B"), u("H"), *[floats] * 6, u("H"),
    ),
    st.builds(Acknowledgement, u("H"), st.sampled_from(Status)),
    st.builds(Pulse, u("Q"), u("Q")),
    st.builds(
        Telemetry,
        u("Q"), st.sampled_from(State), st.integers(0, 255).map(Fault), u("H"), u("H"),
        u("I"), u("H"), u("H"), four, four, floats, floats, floats,
    ),
)  # fmt: skip
packets = st.builds(Packet, u("H"), messages)


@given(packets)
def test_a_packet_is_framed_and_parsed_without_changes(packet):
    data = frame(pack(packet))
    assert data.count(0) == 1
    assert len(data) == len(pack(packet)) + 6 <= 255
    assert parse(unframe(data[:-1])) == packet


@given(st.lists(packets, max_size=5), st.data())
def test_stream_may_be_split_anywhere(example, data):
    stream = b"\0" + b"".join(frame(pack(p)) for p in example)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    reader, received = Reader(), []
    for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        reader, found = reader.fed(stream[a:b])
        received += [parse(packet) for packet in found]
    assert received == example
    assert reader == Reader()


@given(packets, st.integers(0, 10_000), st.integers(1, 255))
def test_a_damaged_byte_is_noticed(packet, at, flip):
    data = bytearray(frame(pack(packet)))
    data[at % (len(data) - 1)] ^= flip
    # A new zero cuts the frame in two; each half is refused, or no frame at all.
    _, received = Reader().fed(bytes(data) + b"\0")
    assert received == []


def naive_packet(encoded: bytes) -> bytes | None:
    """Decode byte by byte: None unless it is a COBS frame with the right CRC."""
    out, left, first = bytearray(), 0, True
    for byte in encoded:
        if left == 0:
            if not first:
                out.append(0)
            left, first = byte, False
        else:
            out.append(byte)
        left -= 1
    if left or len(out) < 5 or len(out) > 253:
        return None
    return bytes(out[:-4]) if struct.pack("<I", zlib.crc32(out[:-4])) == out[-4:] else None


def test_random_and_mutated_frames():
    rng = np.random.default_rng(1)
    originals = [frame(pack(p)) for p in EXAMPLE_PACKETS]
    reader, accepted, right = Reader(), 0, []
    for trial in range(5_000):
        if trial % 2:
            data = bytearray(rng.bytes(int(rng.integers(1, 300))) + b"\0")
        else:
            data = bytearray(originals[trial // 2 % len(originals)])
            for _ in range(int(rng.integers(0, 4))):
                data[int(rng.integers(len(data)))] = int(rng.integers(256))
        reader, found = reader.fed(bytes(data) + b"\0")
        right = [p for part in bytes(data).split(b"\0") if (p := naive_packet(part)) is not None]
        assert found == right
        for packet in found:
            parse(packet)  # mutants with a right CRC are the originals
            accepted += 1
        assert len(reader.held) == 0
    assert 500 < accepted < 2_500
    assert reader.refused > 2_500


def test_random_packets_with_a_right_crc_are_decoded_or_refused():
    rng = np.random.default_rng(2)
    reported = 0
    for _ in range(5_000):
        code = int(rng.choice([1, 2, 3, 4, 5, 16, 17, 18, 129, 130, 131, 132, 99]))
        packet = bytes([code]) + rng.bytes(int(rng.choice([2, 3, 6, 7, 10, 58, 214, 51, 5, 18])))
        try:
            found = parse(packet)
        except FrameError:
            continue
        assert pack(found) == packet
        reported += 1
    assert reported > 125


def test_endless_frame_does_not_fill_memory():
    reader = Reader()
    for _ in range(100):
        reader, found = reader.fed(b"\1" * 1000)
        assert found == []
        assert len(reader.held) <= 254
    assert reader.refused == 1
    reader, found = reader.fed(b"\0" + frame(b"whole"))
    assert found == [b"whole"]


@pytest.mark.parametrize(
    ("packet", "message"),
    [
        (b"\1", "packet has 1 bytes"),
        (b"\x07\0\0", "packet type is 0x07, allowed: 0x1, "),
        (b"\3\0\0\0", "Enable has 1 bytes, allowed: 2"),
        (b"\4\0\0\2", r"Stop.now is 2, allowed: \(0, 1\)"),
        (b"\6\0\0\0\0\x09", r"Trigger.pulse_ms is 9, allowed: \(0, 1, .*, 8\)"),
        (b"\x82\0\0\0\0\x0c", "Acknowledgement.status is 12"),
        (b"\x11\0\0\0\0\0\0", "Knots has 4 bytes, allowed: 4 [+] 52 [*] n, n = 1 to 4"),
        (b"\x11\0\0" + bytes(4) + bytes(5 * 52), "Knots has 264 bytes"),
        (b"\x11\0\0" + bytes(52) + struct.pack("<f", float("nan")), "not finite"),
    ],
)
def test_wrong_packets_are_refused(packet, message):
    with pytest.raises(FrameError, match=message):
        parse(packet)


@pytest.mark.parametrize(
    "packet", [Packet(65536, Enable(1)), Packet(0, Begin(-1, 0, 0)), Packet(0, Heartbeat(2**64))]
)
def test_a_packet_with_invalid_fields_cannot_be_packed(packet):
    with pytest.raises(FrameError):
        pack(packet)


@pytest.mark.parametrize("size", [0, 250])
def test_packets_of_wrong_size_are_refused(size):
    with pytest.raises(FrameError, match=f"packet has {size} bytes, allowed: 1 to 249"):
        frame(bytes(size))


@settings(max_examples=200)
@given(u("H"), st.integers(1, 2**15 - 1))
def test_sequence_numbers_wrap(sequence, step):
    later = (sequence + step) % 2**16
    assert newer(later, sequence)
    assert not newer(sequence, later)
    assert not newer(sequence, sequence)


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ((Trouble.REFUSED, 0x1017, 0x06090032),
         "the drive refuses object 1017h during set-up (abort 06090032h, value too small)"),
        ((Trouble.REFUSED, 0x60C2, 0x12), "the drive refuses object 60C2h during set-up "
         "(abort 00000012h, see its manual)"),
        ((Trouble.WRONG_DRIVE, 0x6061, 1),
         "wrong drive: object 6061h is 1h (1), allowed: 8, cyclic synchronous position"),
        ((Trouble.EMERGENCY, 0x81, 0xFF07),
         "emergency FF07h, error register 81h (manufacturer specific, see its manual)"),
        ((Trouble.EMERGENCY, 0, 0x9000), "emergency 9000h, error register 00h"),
    ],
)  # fmt: skip
def test_messages_of_a_drive_are_explained(trouble, words):
    assert DriveTrouble(4, *trouble).text == f"motor_4: {words}"
