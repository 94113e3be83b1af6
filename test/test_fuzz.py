"""Malformed messages into the driver and the planner: the case `fuzz` of tools/robustness.py."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

PROGRAM = Path(__file__).resolve().parents[1] / "tools/robustness.py"


@pytest.mark.parametrize("node", ["driver", "planner"])
def test_malformed_messages_do_no_harm(node):
    result = subprocess.run(
        [sys.executable, str(PROGRAM), "--case", "fuzz", "--nodes", node, "--count", "600"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout + result.stderr
    assert "crashes=0" in result.stdout
    assert node != "driver" or "moving=0" not in result.stdout


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("fuzz --kills 0.1", "--kills is no option of fuzz"),
        ("faults --nodes sovler", "'sovler', allowed: simulator"),
        ("flood", "'flood'"),
    ],
)
def test_a_case_refuses_options_and_nodes_that_it_does_not_have(words, problem):
    done = subprocess.run(
        [sys.executable, str(PROGRAM), "--case", *words.split()],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode != 0
    assert problem in done.stderr
