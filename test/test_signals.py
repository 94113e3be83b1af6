"""Signals of the test tools take effect between two messages of rclpy."""

import os
import signal
import threading

import pytest

pytest.importorskip("rclpy")
from graph.observer import Observer
from graph.processes import Interrupted, signals_raise, signals_wait


class Spinning:
    """In place of an executor: a signal arrives while a message is converted."""

    def __init__(self, number):
        self.number, self.taken = number, 0

    def spin_once(self, timeout_sec):
        os.kill(os.getpid(), self.number)
        self.taken += 1


def observer(executor):
    made = object.__new__(Observer)
    made._executor, made._pulsed_at, made.pulses = executor, float("inf"), []
    return made


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_message_is_taken_before_a_signal_takes_effect(number):
    executor = Spinning(number)
    with pytest.raises(Interrupted) as caught, signals_raise():
        observer(executor).until(lambda: False, 10.0)
    assert (executor.taken, caught.value.number) == (1, number)


def test_handlers_are_as_before():
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    executor = Spinning(0)  # no signal
    assert observer(executor).until(lambda: executor.taken == 3, 10.0)
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before


def test_in_another_thread_messages_are_taken_too():
    executor, done = Spinning(0), []

    def run():
        with signals_wait():
            done.append(observer(executor).until(lambda: executor.taken == 3, 10.0))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(10.0)
    assert done == [True]
