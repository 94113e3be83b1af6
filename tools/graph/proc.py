"""What Linux tells of a process: its memory, and its time of the cores."""

from __future__ import annotations

import os
from pathlib import Path

TICK_S = os.sysconf("SC_CLK_TCK")
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


def memory_mb(pid: int) -> float:
    """Return the memory of a process that is in use [MB]."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE_MB


def cpu_s(pid: int) -> float:
    """Return the time that a process has had of the cores [s]."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / TICK_S
