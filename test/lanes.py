"""Assign tests to workers, so that real nodes get the processor when they need it.

Most files of test/ start nodes or programs and mostly wait for them. All others compute: those of
the packages, in src/, and those of test/ that name neither. The first half of the workers runs the
files that wait, then the other files. The other half runs the files that compute, at a lower
priority: it uses the time in which the first half waits. When no file of its kind is left, a worker
takes the others, so that all processors are busy until the end.
"""

import os
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

BEHIND = 10
"""By this `nice` value, the others have a tenth of the weight of the workers in front."""

ROOT = Path(__file__).resolve().parents[1]
FRONT = "test/"
STARTS = re.compile(r"\b(subprocess|rclpy|graph|url|program|device|firmware)\b")
"""In a file of test/ that starts something: modules, and fixtures of conftest.py."""


@cache
def computes(name: str) -> bool:
    """Whether the tests of a file start neither nodes nor programs."""
    return not name.startswith(FRONT) or not STARTS.search((ROOT / name).read_text("utf-8"))


def in_front(worker: Mapping[str, Any]) -> bool:
    """Whether a worker is of the first half, by the input that pytest-xdist gives it."""
    number = int(worker["workerid"].removeprefix("gw"))  # more than there are, after a crash
    return 2 * (number % worker["workercount"]) < worker["workercount"]


def give_way(worker: Mapping[str, Any]) -> None:
    """Have this process, and all it starts, give way to the workers in front if it is not one."""
    if not in_front(worker):
        os.nice(BEHIND)


class Lanes(LoadFileScheduling):
    """A file's tests stay together: they share a graph, or what was compiled."""

    def _next(self, node: WorkerController) -> str | None:
        """The file that a worker is to take, if any."""
        front = in_front(node.workerinput)
        own = (name for name in self.workqueue if computes(name) != front)
        return next(own, next(iter(self.workqueue), None))

    def _assign_work_unit(self, node: WorkerController) -> None:
        if name := self._next(node):
            self.workqueue.move_to_end(name, last=False)
            super()._assign_work_unit(node)
