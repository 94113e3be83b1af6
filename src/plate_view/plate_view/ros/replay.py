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
    namespace : str, optional
        Namespace of the plate to show, if the bag has several plates.

    Attributes
    ----------
    namespace : str
        Namespace of the plate that is shown.
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
        If the bag cannot be read, if it contains none of the topics, or if it contains several
        plates, and none is in `namespace`.
    """

    def __init__(
        self, folder: str | Path, kinds: Mapping[str, type], receive: Receive, namespace: str = "/"
    ) -> None:
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
        try:
            self.namespace, self._chosen = self._choose(str(folder), namespace)
        except PlateError:
            self.close()
            raise
        self.begin, self.end = 1e-9 * self._reader.start_time, 1e-9 * self._reader.end_time
        self.now = self.begin
        self.playing = False
        self.rate = 1.0
        self.problem = ""
        self._played_at = time.monotonic()
        latched = [
            connection
            for connection in self._chosen
            if self._topic_key(connection) in LATCHED_TOPICS
        ]
        self._latched: list[Any] = []
        with contextlib.suppress(PlateError):  # a damaged bag is read up to the damaged place
            self._latched.extend(self._read_messages(latched) if latched else ())
        self.seek(self.begin)

    def _choose(self, folder: str, namespace: str) -> tuple[str, list[Any]]:
        """Return the namespace of the plate to show, and the recorded topics of this plate.

        A topic that this plate does not have, such as the images of another package's camera, is
        taken from elsewhere, unless it is another plate's topic, or several topics have its name.

        Raises
        ------
        PlateError
            If there are no topics of a plate, or if there are several plates, and none is in
            `namespace`.
        """
        found: dict[str, dict[str, list[Any]]] = {}  # connections by last name and namespace
        for connection in self._reader.connections:
            space, _, key = str(connection.topic).rpartition("/")
            if (
                connection.msgcount
                and key in self._kinds
                and connection.msgtype == _type_name(self._kinds[key])
            ):
                found.setdefault(key, {}).setdefault(space or "/", []).append(connection)
        if not found:
            raise PlateError(
                f"bag is {folder!r}, allowed: a bag with topics of {', '.join(self._kinds)}"
            )
        own_topics = (
            key for key in found if _type_name(self._kinds[key]).startswith("plate_interfaces/")
        )
        plates = {space for key in own_topics for space in found[key]}
        if len(plates) == 1:
            (namespace,) = plates
        elif plates and namespace not in plates:
            raise PlateError(
                f"bag is {folder!r} with several plates, allowed: a page in the namespace of one "
                f"of them ({', '.join(sorted(plates))}), such as -r __ns:={min(plates)}"
            )
        chosen = []
        for spaces in found.values():
            others = [connection for space, connection in spaces.items() if space not in plates]
            chosen += spaces.get(namespace) or (others[0] if len(others) == 1 else [])
        return namespace, chosen

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
        for connection, stamp, data in self._latched:
            if stamp <= stop:
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


def _type_name(kind: type) -> str:
    """Return the name of a message's type, such as sensor_msgs/msg/Image."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def _damaged_bag_error(error: Exception) -> PlateError:
    return PlateError(f"bag is damaged ({error}), allowed: an intact bag")


KEPT = ("rosout", "diagnostics")
"""Topics of which the replay passes on all messages. For any other topic, only the newest message
is passed on."""
