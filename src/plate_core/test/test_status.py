"""Levels of diagnostics, and when an input counts as timed out."""

import pytest

from plate_core.status import (
    Finding,
    Input,
    Level,
    combined,
    used,
)


def test_levels_are_those_of_ros():
    messages = pytest.importorskip("diagnostic_msgs.msg")
    for level in Level:
        assert bytes([level]) == getattr(messages.DiagnosticStatus, level.name)


def test_the_worst_of_several_findings_counts_and_all_are_reported():
    late, old = Finding(Level.WARN, "late"), Finding(Level.STALE, "no image")
    failed = Finding(Level.ERROR, "failed")
    assert combined([None, None], "all well") == Finding(Level.OK, "all well")
    assert combined([late, None, old], "") == Finding(Level.STALE, "no image; late")
    assert combined([late, old, failed], "") == Finding(Level.ERROR, "failed; no image; late")


def test_an_input_times_out_with_and_without_a_first_message():
    topic = Input("image", "image_raw", "check that the camera runs", 1.5, since=10.0)
    assert topic.timeout_finding(11.5) is None
    assert topic.timeout_finding(11.6) == Finding(
        Level.STALE, "no image yet on image_raw; check that the camera runs"
    )
    topic = topic.received(20.0)
    assert topic.timeout_finding(21.5) is None
    assert topic.age(21.0) == 1.0
    assert topic.timeout_finding(22.1) == Finding(
        Level.STALE, "no image for 2.1 s on image_raw; check that the camera runs"
    )


def test_refusals_are_an_error_only_if_nothing_was_of_use():
    assert used("images", 5, 0, "") is None
    assert used("images", 5, 1, "too dark") == Finding(
        Level.WARN, "1 of 5 images refused: too dark"
    )
    assert used("images", 5, 5, "too dark").level is Level.ERROR
