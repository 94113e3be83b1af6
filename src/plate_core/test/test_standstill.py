"""Requests that waited during a stall of the process are distinguished from new requests."""

from plate_core.standstill import AFTER_S, Standstill


def test_messages_right_after_a_standstill_are_late():
    standstill = Standstill(1.0, 100.0)
    assert not standstill.is_late(100.0)
    assert not any(standstill.is_late(100.0 + 0.9 * k) for k in range(1, 5))
    assert standstill.is_late(105.0)
    assert standstill.is_late(105.0 + 0.9 * AFTER_S)
    assert not standstill.is_late(105.0 + 1.1 * AFTER_S)
