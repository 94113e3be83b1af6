"""Messages are handled whole, also when Ctrl-C comes in the middle of one."""

import os
import signal
import threading
import time

import pytest

pytest.importorskip("rclpy")

from plate_client.messages import defer_signals, spin_until


@pytest.fixture(autouse=True)
def default_handler():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_waits_for_the_end_of_a_message():
    handled = []

    def spin_once(wait_s):
        interrupt()
        handled.append("whole")

    with pytest.raises(KeyboardInterrupt):
        spin_until(spin_once, lambda: False, 10.0)
    assert handled == ["whole"]


def test_an_interrupt_of_the_last_message_counts():
    handled = []

    def spin_once(wait_s):
        interrupt()
        handled.append("whole")

    with pytest.raises(KeyboardInterrupt):
        spin_until(spin_once, lambda: bool(handled), 10.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_deferred_signals_wait_for_the_next_messages(number):
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        defer_signals()
        os.kill(os.getpid(), number)
        with pytest.raises(KeyboardInterrupt, match=str(int(number))):
            spin_until(time.sleep, lambda: True, 10.0)
        assert spin_until(time.sleep, lambda: True, 10.0)  # once for each
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def test_spinning_ends_when_the_condition_holds_or_the_time_is_over():
    handled = []
    assert spin_until(handled.append, lambda: len(handled) == 3, 10.0)
    assert len(handled) == 3
    assert not spin_until(time.sleep, lambda: False, 0.05)


def test_another_thread_leaves_an_interrupt_to_the_main_thread():
    held = []
    other = threading.Thread(target=lambda: held.append(spin_until(time.sleep, bool, 0.5)))
    other.start()
    with pytest.raises(KeyboardInterrupt):
        spin_until(lambda wait_s: (interrupt(), other.join()), lambda: False, 10.0)
    assert held == [False]
