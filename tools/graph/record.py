"""What was heard of a run."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

MOST_IMAGES = 240
"""Images kept for drawing (300 kB each)."""


@dataclass
class Thinned:
    """A list that never grows beyond `most`: when full, every other item goes, and from then on
    only every second, fourth, ... new one is taken."""

    most: int = MOST_IMAGES
    items: list[Any] = field(default_factory=list)
    step: int = 1
    count: int = 0

    def add(self, item: Any) -> None:
        """Take the item, or not."""
        if self.count % self.step == 0:
            self.items.append(item)
            if len(self.items) >= self.most:
                del self.items[1::2]
                self.step *= 2
        self.count += 1


@dataclass
class Record:
    """Messages of one run, undecoded where decoding would steal time from the nodes.

    Attributes
    ----------
    truth, tables : list of bytes
        All of ground_truth and motor_setpoints.
    answers : int
        Number of plate_cycle messages.
    images : Thinned
        Some of image_raw, as bytes.
    reports : dict of str to list of (stamp in ns, dict)
        Diagnostics by node: keys and values, and the message under "message".
    states : list of str
        Of task_state.
    driver_state : str
        What the driver said last.
    """

    truth: list[bytes] = field(default_factory=list)
    tables: list[bytes] = field(default_factory=list)
    answers: int = 0
    images: Thinned = field(default_factory=Thinned)
    reports: dict[str, list[tuple[int, dict[str, str]]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    states: list[str] = field(default_factory=list)
    driver_state: str = ""

    def last(self, node: str, key: str, default: str = "") -> str:
        """Return the newest value that a node has reported."""
        reports = self.reports.get(node)
        return reports[-1][1].get(key, default) if reports else default

    def numbers(self, node: str, key: str) -> list[float]:
        """Return all numbers that a node has reported under a key."""
        return [float(values[key]) for _, values in self.reports.get(node, []) if key in values]

    @property
    def ended(self) -> bool:
        """Whether the task is over."""
        return bool(self.states) and self.states[-1].split(":")[0] not in ("idle", "running")
