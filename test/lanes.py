"""Assign tests to workers, so that real nodes get the processor when they need it.

Most files of test/ start nodes or programs and mostly wait for them. All other files compute: those
of the packages, in src/, and those of test/ that start neither, or only programs in simulated time.
The front workers are the first half of the workers, rounded down but at least one. They run the
files that wait, then the other files. The other workers run the files that compute, at a lower
priority, so they use the time in which the front workers wait. When no file that computes is left,
they take the others. The last of three or more workers only computes. If it also started nodes,
the nodes would be too late.
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
"""Increment of the `nice` value of the other workers. Each of them gets a tenth of the weight of a
front worker."""

ROOT = Path(__file__).resolve().parents[1]
FRONT = "test/"
STARTS = re.compile(r"\b(subprocess|rclpy|graph|url)\b")
"""Names of modules and fixtures in a file of test/ that starts nodes, or programs in real time."""


@cache
def computes(name: str) -> bool:
    """Whether the tests of a file start neither nodes nor programs in real time."""
    return not name.startswith(FRONT) or not STARTS.search((ROOT / name).read_text("utf-8"))


def in_front(worker: Mapping[str, Any]) -> bool:
    """Whether a worker is a front worker, by the input that pytest-xdist gives it."""
    number = int(worker["workerid"].removeprefix("gw"))  # more than there are, after a crash
    count = worker["workercount"]
    return number % count < max(1, count // 2)


def only_computes(worker: Mapping[str, Any]) -> bool:
    """Whether a worker never runs files that wait."""
    count = worker["workercount"]
    return count > 2 and int(worker["workerid"].removeprefix("gw")) % count == count - 1


def give_way(worker: Mapping[str, Any]) -> None:
    """Lower the priority of this process and its children, unless it is a front worker."""
    if not in_front(worker):
        os.nice(BEHIND)


class Lanes(LoadFileScheduling):
    """Scheduler that keeps the tests of a file together, because they share a graph or a
    program."""

    def _next(self, node: WorkerController) -> str | None:
        """Return the file that a worker should run next, or None."""
        front = in_front(node.workerinput)
        own = (name for name in self.workqueue if computes(name) != front)
        others = () if only_computes(node.workerinput) else self.workqueue
        return next(own, next(iter(others), None))

    def _assign_work_unit(self, node: WorkerController) -> None:
        if name := self._next(node):
            self.workqueue.move_to_end(name, last=False)
            super()._assign_work_unit(node)
        else:
            node.shutdown()
