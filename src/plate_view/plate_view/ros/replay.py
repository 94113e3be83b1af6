"""Replay of a recorded run, which the page shows instead of the running graph."""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from plate_core import PlateError
from plate_core.files import check_file

BEFORE_S = 1.5
"""Maximum age of messages that are shown after a jump to another time [s]. Messages of latched
topics are shown at any age."""

LATCHED_TOPICS = ("task_status", "driver_status", "part_targets")

BAG_BYTES = 10**12
"""Maximum total size of the data files of a bag [bytes]. The data files are read message by
message."""

METADATA_BYTES = 10**6
"""Maximum size of metadata.yaml [bytes]. The file is read as a whole."""

RATES = 0.05, 20.0
"""Allowed range of the replay rate, in recorded seconds per second."""

Receive = Callable[[str, Any], None]


class Replay:
    """Plays a recorded bag.

    Parameters
    ----------
    folder : str or path
        Folder of a bag from `ros2 bag record` or `make demo ARGS=--record`.
    kinds : mapping of str to type
        Types of the messages of the topics that are played.
    receive : callable
        Function that is called with the topic and each message.

    Attributes
    ----------
    begin, end, now : float
        Start of the recording, end of the recording, and current position of the replay [s, time of
        the recording].
    playing : bool
    rate : float
        Recorded seconds per second.
    problem : str
        Reason why the replay stopped before the end of the recording. Empty if the replay did not
        stop early.

    Raises
    ------
    PlateError
        If the bag cannot be read, or if it contains none of the topics.
    """

    def __init__(self, folder: str | Path, kinds: Mapping[str, type], receive: Receive) -> None:
        self._kinds, self._receive = kinds, receive
        try:
            library = importlib.import_module("rosbags.rosbag2")
        except ImportError:
            raise PlateError("the package rosbags is missing: pip install rosbags") from None
        try:
            for file in Path(folder).iterdir():
                if not file.is_dir():
                    check_file(file, METADATA_BYTES if file.suffix == ".yaml" else BAG_BYTES)
            self._reader = library.Reader(folder)
            self._reader.open()
        except (library.ReaderError, OSError) as error:
            raise PlateError(
                f"bag is {str(folder)!r} ({error}), allowed: the folder of a recorded run"
            ) from None
        self._chosen = [each for each in self._reader.connections if self._topic_key(each) in kinds]
        if not any(each.msgcount for each in self._chosen):
            self.close()
            raise PlateError(
                f"bag is {str(folder)!r}, allowed: a bag with topics of {', '.join(kinds)}"
            )
        self.begin, self.end = 1e-9 * self._reader.start_time, 1e-9 * self._reader.end_time
        self.now, self.playing, self.rate, self.problem = self.begin, False, 1.0, ""
        self._played_at = time.monotonic()
        latched = [each for each in self._chosen if self._topic_key(each) in LATCHED_TOPICS]
        self._latched: list[Any] = []
        with contextlib.suppress(PlateError):  # a damaged bag is read up to the damaged place
            self._latched.extend(self._read_messages(latched) if latched else ())
        self.seek(self.begin)

    @staticmethod
    def _topic_key(connection: Any) -> str:
        return str(connection.topic).rsplit("/", 1)[-1]

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()

    def play(self, playing: bool) -> None:
        """Start or pause the replay. At the end of the recording, start again from the
        beginning."""
        if playing and self.now >= self.end:
            self.seek(self.begin)
        self.playing, self._played_at, self.problem = playing, time.monotonic(), ""

    def set_rate(self, rate: float) -> None:
        """Set the rate.

        Raises
        ------
        PlateError
            If the rate is outside the range `RATES`.
        """
        low, high = RATES
        if not low <= rate <= high:
            raise PlateError(f"rate is {rate:g}, allowed: {low:g} to {high:g}")
        self.rate = rate

    def seek(self, t: float) -> None:
        """Jump to a time [s], and show the state at this time.

        Raises
        ------
        PlateError
            If the bag is damaged at this time.
        """
        self.now = t = min(max(t, self.begin), self.end)
        self._coming, self._next, self.problem = iter(()), None, ""
        stop = round(1e9 * t)
        newest: dict[str, tuple[Any, bytes]] = {}
        for connection, at, data in self._latched:
            if at <= stop:
                newest[self._topic_key(connection)] = connection, data
        for connection, _, data in self._messages_between(t - BEFORE_S, t):
            newest[self._topic_key(connection)] = connection, data
        for name, (_, data) in newest.items():
            self._forward_message(name, data)
        self._coming = self._messages_between(t, self.end + 1.0)
        self._next = next(self._coming, None)
        self._played_at = time.monotonic()

    def step(self) -> None:
        """Play the messages that are due. If a part of the bag is damaged, stop and set
        `problem`."""
        now = time.monotonic()
        elapsed, self._played_at = now - self._played_at, now
        try:
            if self.playing:
                self._play_due_messages(elapsed)
        except PlateError as error:
            self.playing, self.problem = False, str(error)

    def _play_due_messages(self, elapsed: float) -> None:
        self.now = min(self.now + self.rate * elapsed, self.end)
        due: dict[str, bytes] = {}
        while self._next is not None and self._next[1] <= round(1e9 * self.now):
            connection, _, data = self._next
            name = self._topic_key(connection)
            if name in KEPT and name in due:
                self._forward_message(name, due[name])
            due[name] = data
            self._next = next(self._coming, None)
        for name, data in due.items():
            self._forward_message(name, data)
        if self.now >= self.end:
            self.playing = False

    def _messages_between(self, start: float, stop: float) -> Iterator[Any]:
        begin = max(round(1e9 * start), self._reader.start_time)
        return self._read_messages(self._chosen, begin, round(1e9 * stop) + 1)

    def _read_messages(self, chosen: list[Any], *interval: int) -> Iterator[Any]:
        try:
            yield from self._reader.messages(chosen, *interval)
        except Exception as error:  # the library can raise any type of exception for a damaged file
            raise _damaged_bag_error(error) from None

    def _forward_message(self, name: str, data: bytes) -> None:
        try:
            msg = deserialize_message(bytes(data), self._kinds[name])
        except Exception as error:  # rmw raises an error that has no public name
            raise _damaged_bag_error(error) from None
        self._receive(name, msg)


def _damaged_bag_error(error: Exception) -> PlateError:
    return PlateError(f"bag is damaged ({error}), allowed: an intact bag")


KEPT = ("rosout", "diagnostics")
"""Topics of which the replay passes on all messages. For any other topic, only the newest message
is passed on."""
