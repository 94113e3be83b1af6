"""The watchdog, with time as an argument."""

from plate_driver.watchdog import Watchdog


def test_trips_just_after_what_was_sent_is_over():
    dog = Watchdog().fed(10.0, 1.0)
    assert not dog.tripped(10.0)
    assert not dog.tripped(11.0)
    assert dog.tripped(11.0 + 1e-9)


def test_feeding_puts_it_off():
    dog = Watchdog().fed(10.0, 1.0).fed(10.9, 1.0)
    assert not dog.tripped(11.5)
    assert dog.tripped(12.0)


def test_nothing_to_be_told():
    assert not Watchdog().tripped(1e9)
    rested = Watchdog().fed(10.0, 1.0).rested()
    assert not rested.tripped(1e9)
    assert rested.hold_s == 1.0
