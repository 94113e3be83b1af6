"""`plate friction` where the measurement does not come to its end."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time

from plate_client.ros.graph import Graph
from plate_core import PlateError
from plate_interfaces.msg import DriverStatus, Friction

OURS = Time(sec=7)
MEASURES = DriverStatus(state=DriverStatus.CALIBRATING)
READY = DriverStatus(state=DriverStatus.READY)
MAX_ROUNDS = 100


class Scripted(Graph):
    """A graph that receives the messages of a script, one call of it for each round of waiting."""

    def __init__(self, script, answer):
        self.callbacks, self.calls, self.rounds = {}, [], 0
        self.script, self.answer = script, answer
        subscribe = lambda kind, topic, take, qos: self.callbacks.update({topic: take})  # noqa: E731
        self.node = SimpleNamespace(create_subscription=subscribe)

    def _call(self, kind, service, request, urgent=False, once=False):
        self.calls.append(request.start)
        if request.start and isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer

    def _until(self, condition, timeout_s):
        assert self.rounds < MAX_ROUNDS
        self.script(self)
        self.rounds += 1
        return condition()

    def receive(self, topic, msg):
        self.callbacks[topic](msg)


def ran(script, success=True, answer=None):
    answer = answer or SimpleNamespace(success=success, message="a task runs", started=OURS)
    graph, ended = Scripted(script, answer), None
    try:
        graph._friction(write=False)
    except (PlateError, KeyboardInterrupt, OSError) as error:
        ended = error
    return graph, ended


def progress(graph):
    msg = Friction(state=Friction.RUNNING, text="push 1")
    msg.header.stamp = OURS
    graph.receive("friction", msg)


@pytest.mark.parametrize("later", [lambda graph: None, lambda g: g.receive("driver_status", READY)])
def test_a_driver_that_measures_no_longer_is_reported_within_seconds(later, capsys):
    """A driver that has ended, and one that was restarted."""
    start_round = 30

    def script(graph):
        if graph.rounds < start_round:
            graph.receive("driver_status", MEASURES)
        else:
            later(graph)

    graph, ended = ran(script)
    assert "the driver has reported no measurement for 2 s" in str(ended)
    assert "Check whether the plate" in str(ended)
    assert start_round < graph.rounds < start_round + 15  # of 0.2 s
    assert graph.calls == [True, False]
    assert "canceling the measurement" in capsys.readouterr().out


def test_ctrl_c_ends_the_measurement_also_before_it_is_answered():
    graph, ended = ran(lambda graph: None, answer=KeyboardInterrupt(2))
    assert isinstance(ended, KeyboardInterrupt)
    assert graph.calls == [True, False]


def test_the_measurement_ends_if_its_output_is_closed(monkeypatch):
    def broken(*_, **__):
        raise BrokenPipeError

    monkeypatch.setattr("builtins.print", broken)
    graph, ended = ran(progress)
    assert isinstance(ended, BrokenPipeError)
    assert graph.calls == [True, False]


def test_a_refused_measurement_does_not_end_a_running_one():
    graph, ended = ran(lambda graph: None, success=False)
    assert str(ended) == "a task runs"
    assert graph.calls == [True]


class Measured(Scripted):
    """A graph whose driver measures at once, and writes."""

    def __init__(self):
        super().__init__(done, SimpleNamespace(success=True, message="written", started=OURS))

    def _call(self, kind, service, request, urgent=False, once=False):
        self.calls.append(service)
        return self.answer


def done(graph):
    msg = Friction(state=Friction.DONE, text="mu is 0.25", mu=0.25)
    msg.header.stamp = OURS
    graph.receive("friction", msg)


@pytest.mark.parametrize(
    ("write", "terminal", "typed", "written"),
    [
        (True, False, None, True), (False, False, None, False), (False, True, "yes", True),
        (False, True, " yes ", True), (False, True, "", False), (False, True, "no", False),
    ],
)  # fmt: skip
def test_friction_is_written_only_if_the_user_agrees(monkeypatch, write, terminal, typed, written):
    questions = []

    def answer(question):
        questions.append(question)
        return typed

    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: terminal))
    monkeypatch.setattr("builtins.input", answer)
    graph = Measured()
    text = graph._friction(write=write)
    assert text == "written" if written else "not written" in text
    assert graph.calls == ["measure_friction", *["write_friction"] * written]
    assert [question[:14] for question in questions] == ["Write mu 0.25 "] * (typed is not None)
