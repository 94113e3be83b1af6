"""Malformed messages into the driver and the planner: a small share of what tools/fuzz.py sends."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

FUZZ = Path(__file__).resolve().parents[1] / "tools" / "fuzz.py"


@pytest.mark.parametrize("node", ["driver", "planner"])
def test_malformed_messages_do_no_harm(node):
    result = subprocess.run(
        [sys.executable, str(FUZZ), node, "--messages", "600"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout + result.stderr
    assert "crashes=0" in result.stdout
    assert node != "driver" or "moving=0" not in result.stdout
