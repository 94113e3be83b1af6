"""The firmware on an emulated STM32F405: instructions of its ticks, steps between its setpoints."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from harness import ROOT, Result, Table

sys.path.insert(0, str(ROOT / "tools"))

from board_host import TICK_INSTRUCTIONS, Host, Ticks, attacked, committed  # noqa: E402
from emulated_board import SteppedBoard, built, calibrated, missing, sizes  # noqa: E402
from board_rig import without_following  # noqa: E402

PIECES = (1, 2, 8, 24, 48, 96, 200, 500)
PACKETS = 10_000
LINES = (92, 128)
"""Bytes that the line brings in a tick: at 921,600 baud, and the most that a tick reads."""

MOST = 42_000
"""Instructions of a tick that are allowed: a quarter of 1 ms at 168 MHz."""

BEFORE = {1: 1_386_165, 8: 1_380_629, 48: 1_385_837, 96: 2_759_748, 200: 5_734_534, 500: 14_323_463}
BEFORE_STEP_M = {1: 0.33e-3, 8: 0.66e-3, 48: 0.99e-3, 96: 2.65e-3, 200: 7.22e-3, 500: 8.95e-3}
