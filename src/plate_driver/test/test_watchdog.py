"""The watchdog, with time as an argument."""

from plate_driver.watchdog import Watchdog


def test_trips_just_after_its_patience():
    dog = Watchdog().fed(now=10.0, period=0.25, hold_cycles=4)
    assert not dog.tripped(10.0)
    assert not dog.tripped(11.0 - 1e-9)
    assert not dog.tripped(11.0)
    assert dog.tripped(11.0 + 1e-9)


def test_feeding_puts_it_off():
    dog = Watchdog().fed(10.0, 0.25, 4).fed(10.9, 0.25, 4)
    assert not dog.tripped(11.5)
    assert dog.tripped(12.0)


def test_nothing_to_bring_to_rest():
    assert not Watchdog().tripped(1e9)
    assert not Watchdog().fed(10.0, 0.25, 4).rested().tripped(1e9)


def test_clock_put_back_begins_anew():
    dog = Watchdog().fed(1000.0, 0.25, 4)
    assert not dog.synchronised(2.0).tripped(2.5)
    assert dog.synchronised(2.0).tripped(3.5)


def test_clock_that_started_after_the_feeding_begins_anew():
    dog = Watchdog().fed(0.0, 0.25, 4)
    assert not dog.synchronised(1e9).tripped(1e9)


def test_clock_that_runs_on_changes_nothing():
    dog = Watchdog().fed(10.0, 0.25, 4)
    assert dog.synchronised(10.5) == dog
    assert Watchdog().synchronised(5.0) == Watchdog()
