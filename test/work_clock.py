"""A steady clock for tests of nodes in this process."""

import time

LONGEST_STEP_S = 0.1
"""Between two looks the clock goes on by so much at most [s]."""


class WorkClock:
    """Time that this process has spent at work [s], for a node in place of the module `time`: while
    a busy computer holds the process up, all its nodes stand still, and none may miss another."""

    def __init__(self):
        self._now = self._looked = time.monotonic()

    def monotonic(self):
        before, self._looked = self._looked, time.monotonic()
        self._now += min(self._looked - before, LONGEST_STEP_S)
        return self._now
