"""The client where there is no planner."""

import os

import pytest

pytest.importorskip("rclpy")

from plate_client import PlateClient, client
from plate_core import PlateError
from plate_core.tasks import PartTarget


def test_targets_that_nobody_hears_are_said(monkeypatch):
    monkeypatch.setattr(client, "FOUND_S", 0.1)
    why = "nobody hears targets: does the planner run"
    with (
        PlateClient.connect(f"/nobody_{os.getpid()}") as plate,
        pytest.raises(PlateError, match=why),
    ):
        plate.move_targets([PartTarget("black_1", (0.0, 0.0))])
