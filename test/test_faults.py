"""Nodes of the real graph are killed and frozen in mid-task: the reports, and the motion."""

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from cases.faults import Faults
from graph.session import session
from light_graph import LightOptions
from short_task import MIDDLE

TIMES = {"WORK_S": 0.5, "WATCH_S": 3.0, "FREEZE_S": 2.5, "UNASKED_S": 1.0}
"""Long enough for every timeout; shorter than in the tool, which measures when."""

EXPECTED = {
    ("kill", "detector"): (
        "no parts for",
        "the detector no longer publishes diagnostics; ",
        "solver",
    ),
    ("kill", "driver"): ("no driver_status for", "check that the driver runs", "simulator"),
    ("freeze", "simulator"): ("no image for", "check that the camera runs", "detector"),
    ("freeze", "planner"): ("the planner was stalled for", "", "solver"),
    ("freeze", "solver"): (
        "no plate_cycle for",
        "the solver no longer publishes diagnostics; ",
        "planner",
    ),
}
"""By fault: the text of task_status, and a node whose diagnostics get worse (None for the
planner)."""

HELD_UP = "the planner was stalled for"
"""Alternative text after about one kill in a hundred, if DDS blocked the planner
(docs/graph.md)."""


def test_a_missing_node_is_named_and_the_plate_does_not_move_without_an_enable(
    tmp_path, domain, monkeypatch
):
    for name, seconds in TIMES.items():
        monkeypatch.setattr(f"cases.faults.{name}", seconds)
    options = LightOptions(scenario=str(tmp_path / "middle.yaml"))
    Path(options.scenario).write_text(yaml.safe_dump(MIDDLE), encoding="utf-8")
    with session(options, tmp_path, domain, pictures=False, watched=False) as graph:
        faults = Faults(graph)
        for (kind, node), (reason, question, other) in EXPECTED.items():
            row = faults.put(kind, node)
            assert row.task.startswith("aborted"), row
            held_up = kind == "kill" and HELD_UP in row.task
            assert held_up or (reason in row.task and question in row.task), row
            levels = {name: level for name, level, *_ in row.diagnostics}
            assert levels["planner"] == "ERROR", row
            assert levels[other] in ("STALE", "ERROR"), row
            assert row.rest_s is not None, "the plate goes on"
            assert not row.moved_unasked, row
            # A person replaces the parts that the plate lost while it came to rest; nothing else is
            # needed.
            assert row.to_go_on in (["goal"], ["goal", "parts"]), row
            assert row.goes_on, row
