"""The host's estimates from pulses: round trip, loss; and the capacity of a line."""

import numpy as np
import pytest

from plate_core.serial_protocol import (  # fmt: skip
    Begin,
    Commit,
    Heartbeat,
    Knot,
    Knots,
    Packet,
    Pulse,
    Stop,
    frame,
    pack,
)
from plate_driver.transports.line import HEARTBEAT_S, MAX_COPIES, LineModel, frame_bytes, upload_s

REST = (0.0,) * 4
ROUND = 17 + 25
KNOT = Knot(0, REST, REST, REST)


@pytest.mark.parametrize(
    "message", [Stop(1), Heartbeat(5), Begin(1, 2, 3), Knots(1, 0, (KNOT,) * 3), Commit(1, 1)]
)
def test_frames_are_as_long_as_they_are(message):
    assert frame_bytes(message) == len(frame(pack(Packet(7, message))))


def test_an_upload_is_its_bytes_beside_the_heartbeats():
    messages = [
        Begin(1, 65, 0),
        *[Knots(1, 0, (KNOT,) * 4)] * 16,
        Knots(1, 0, (KNOT,)),
        Commit(1, 1),
    ]
    size = sum(len(frame(pack(Packet(0, m)))) for m in messages)
    beats = len(frame(pack(Packet(0, Heartbeat(0))))) / HEARTBEAT_S
    assert upload_s(64, 115_200.0) == pytest.approx(size / (11_520 - beats))
    assert upload_s(64, 1000.0) == float("inf")


def conversation(loss: float, trip_s: float, seconds: float, seed: int = 0) -> LineModel:
    """A line after heartbeats each 25 ms, of whose bytes a share is lost."""
    rng, line, coming = np.random.default_rng(seed), LineModel(), []
    for step in range(round(seconds / 0.005)):
        now = 0.005 * step
        for pulse in [p for at, p in coming if at <= now]:
            line = line.received(pulse, now)
        coming = [item for item in coming if item[0] > now]
        if step % 5 == 0:
            line = line.sent(17, now).heartbeat_sent(round(now * 1e9), now)
            if rng.random() < (1 - loss) ** ROUND:
                coming.append((now + trip_s, Pulse(round(now * 1e9), 0)))
    return line


@pytest.mark.parametrize("trip_s", [0.005, 0.05, 0.2])
def test_the_round_trip_time_is_estimated(trip_s):
    line = conversation(0.0, trip_s, 3.0)
    assert line.trip_s == pytest.approx(trip_s, rel=0.1)
    assert line.answered > 0.99
    assert not line.lossy
    assert line.copies(225) == 1
    assert line.knots_per_message == 4
    assert trip_s < line.retry_s < 1.5 * trip_s + 0.05


@pytest.mark.parametrize("loss", [0.01, 0.03, 0.05])
def test_loss_is_found(loss):
    fractions = [conversation(loss, 0.005, 10.0, seed).answered for seed in range(10)]
    assert np.mean(fractions) == pytest.approx((1 - loss) ** ROUND, rel=0.25)
    line = LineModel(answered=(1 - loss) ** ROUND)
    assert line.lossy
    assert line.arriving(65) == pytest.approx((1 - loss) ** 65)
    assert line.knots_per_message == 1
    expected = 1 / (1 - loss) ** 65
    assert line.copies(65) == pytest.approx(min(MAX_COPIES, expected), abs=1)
    assert line.heartbeat_s == pytest.approx(0.01)
    assert LineModel(57_600.0, answered=0.3).heartbeat_s == pytest.approx(17 / 5760 / 0.2)
