"""The driver's record of what it did."""

import pytest

from plate_core import PlateCycle, load_rig
from plate_driver.limits import fit
from plate_driver.record import Record

RIG = load_rig()


def wild(size: float) -> PlateCycle:
    pose = [[size * x, 0, 0] for x in (0, 1, 2, 3, 2, 1, 0, -1, -2, -1)]
    return PlateCycle.from_samples(0.1, pose)


def test_counts():
    gentle, large, larger = (fit(RIG, wild(size)) for size in (1e-5, 0.01, 0.1))
    record = Record()
    for found in (gentle, large, larger, large):
        record = record.accepted(found)
    record = record.refusal().refusal().rest()
    assert (record.cycles, record.refused, record.scaled, record.rests) == (4, 2, 3, 1)
    assert record.worst == pytest.approx(larger.asked.worst)
    assert record.factor == pytest.approx(larger.factor)
    assert record.troubles == (
        "a cycle was scaled down",
        "a cycle was refused",
        "cycles ceased to come",
    )


def test_report_keeps_totals_and_forgets_peaks():
    record = Record().accepted(fit(RIG, wild(0.1)), late=0.01)
    assert record.values(0.5)["rate_hz"] == "2.00"
    assert record.values(0.5)["late_ms"] == "10.0"
    record = record.reported()
    assert record.values(0.5) == {
        "rate_hz": "0.00",
        "late_ms": "0.0",
        "cycles": "1",
        "refused": "0",
        "scaled": "1",
        "rests": "0",
        "worst_limit_share": "0.0000",
        "factor": "1.0000",
    }
    assert record.troubles == ()
