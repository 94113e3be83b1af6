"""The client without a planner, or with a planner that sends nothing."""

import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from plate_client import PlateClient
from plate_client.ros import client
from plate_core import PlateError
from plate_core.ros import DATA, LATCHED
from plate_core.tasks import PartTarget
from plate_interfaces.action import SortParts
from plate_interfaces.msg import Targets, TaskProgress, TaskStatus


def test_targets_without_subscribers_are_reported(monkeypatch):
    monkeypatch.setattr(client, "DISCOVERY_S", 0.1)
    why = "no node in this ROS domain subscribes to targets; start the planner"
    with (
        PlateClient.connect(f"/nobody_{os.getpid()}") as plate,
        pytest.raises(PlateError, match=why),
    ):
        plate.move_targets([PartTarget("black_1", (0.0, 0.0))])


@pytest.fixture(name="planner", params=["diagnostics", "/diagnostics"])
def _planner(request):
    """A client, and a planner that takes the targets of black_1. It publishes the reason why it
    refuses others in its diagnostics, and the last reason once more, as the planner does. The topic
    can be shared with another plate."""
    with PlateClient.connect(f"targets_{os.getpid()}/") as plate:
        node = plate.node  # the client's thread also serves the planner
        current = node.create_publisher(Targets, "part_targets", LATCHED)
        reports = node.create_publisher(DiagnosticArray, request.param, DATA)
        planner = SimpleNamespace(reason="", answers=True)
        planner_name = f"{node.get_namespace()}/planner"

        def publish(reason):
            values = [KeyValue(key="refusal", value=reason)]
            reports.publish(
                DiagnosticArray(status=[DiagnosticStatus(name=planner_name, values=values)])
            )

        def take(msg):
            before, planner.reason = planner.reason, ""
            if not planner.answers:
                return
            publish(before)  # a late report about earlier targets
            others = [target.id for target in msg.targets if target.id != "black_1"]
            if others:
                planner.reason = f"targets: {others[0]} is unknown, allowed: black_1"
                publish(planner.reason)
            msg.targets = [target for target in msg.targets if target.id == "black_1"]
            current.publish(msg)

        node.create_subscription(Targets, "targets", take, DATA)
        assert plate._until(lambda: reports.get_subscription_count() > 0, 10.0)
        yield plate, planner


def test_targets_are_taken_or_refused_with_the_planners_reason(planner):
    plate, _ = planner
    known, unknown = PartTarget("black_1", (0, 0.05)), PartTarget("black_9", (0.0, 0.0), 1.0)
    plate.move_targets([known])
    for targets in ([unknown], [known, unknown]):
        with pytest.raises(PlateError, match=r"^targets: black_9 is unknown, allowed: black_1$"):
            plate.move_targets(targets)
    plate.move_targets([PartTarget("black_1", (0.1, 0.05))])
    for name in ("black_8", "black_7"):
        with pytest.raises(PlateError, match=f"{name} is unknown"):
            plate.move_targets([PartTarget(name, (0.0, 0.0))])
    with pytest.raises(PlateError, match="targets: black_1 occurs twice"):
        plate.move_targets([known, known])


def test_a_planner_that_neither_takes_nor_refuses_targets_is_reported(planner, monkeypatch):
    plate, silent = planner
    monkeypatch.setattr(client, "REFUSED_S", 0.1)
    silent.answers = False
    with pytest.raises(PlateError, match="neither taken nor refused the targets"):
        plate.move_targets([PartTarget("black_1", (0.0, 0.0))])


@pytest.fixture(name="silent")
def _silent(monkeypatch):
    """A client without a planner, and a goal; all waits are over at once."""
    monkeypatch.setattr(client, "ANSWER_S", -1.0)
    with PlateClient.connect(f"/silent_{os.getpid()}") as plate:
        plate._until = lambda condition, timeout_s: condition()
        task = client.Task("sort_parts", lambda feedback, answer: plate.sent.append(answer))
        plate.sent = []
        monkeypatch.setattr(plate, "send", lambda goal, waiting: task.send() or task)
        yield plate, task


def test_a_planner_without_feedback_is_not_waited_for(silent):
    plate, task = silent
    task.send()
    reported = []
    with pytest.raises(PlateError, match="the planner has sent no message for 2 s"):
        plate.wait(task, meanwhile=lambda: reported.append(task))
    rounds = len(reported)
    assert rounds * client.AGAIN_S == pytest.approx(client.TIMEOUT_S)

    def speak():
        task.feedbacks += len(reported) == rounds + 5
        reported.append(task)

    with pytest.raises(PlateError, match="the planner has sent no message"):
        plate.wait(task, meanwhile=speak)
    assert len(reported) > 2 * rounds + 5


def test_a_goal_that_is_not_answered_is_sent_again_and_then_given_up(silent):
    plate, _ = silent
    with pytest.raises(PlateError, match="the planner has not answered the goal"):
        plate.start(SortParts.Goal())
    assert len(plate.sent) > 1


def test_a_goal_of_which_only_the_answer_was_lost_runs_on(silent):
    """It is known to the planner, which refuses its id when it comes again."""
    plate, task = silent
    results = []
    handle = SimpleNamespace(
        accepted=False,
        get_result_async=lambda: SimpleNamespace(add_done_callback=results.append),
        cancel_goal_async=lambda: pytest.fail("canceled"),
    )

    def until(condition, timeout_s):
        task.progress = TaskProgress(parts_total=4)  # its feedback comes
        if len(plate.sent) > 1:
            plate.sent[1](SimpleNamespace(result=lambda: handle))
        return condition()

    plate._until = until
    assert plate.start(SortParts.Goal()) is task
    assert len(plate.sent) == 2
    assert results == [task._on_result]
    assert not task.ended


def test_a_goal_that_is_refused_at_once_has_ended(silent):
    plate, _ = silent

    def until(condition, timeout_s):
        plate.sent[0](SimpleNamespace(result=lambda: SimpleNamespace(accepted=False)))
        return condition()

    plate._until = until
    assert plate.start(SortParts.Goal()).status.text == "the planner refused the goal"


def program(text):
    """Execute a program, and return its exit code and its errors. Newer versions of Python warn of
    each fork of a process with threads."""
    lines = "import os, signal, threading, time\nfrom plate_client import PlateClient\n" + text
    quiet = "ignore:This process:DeprecationWarning"
    words = [sys.executable, "-W", quiet, "-c", lines]
    done = subprocess.run(words, timeout=60, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_a_program_may_end_without_closing_its_client():
    assert program("held = PlateClient.connect()\nheld.__enter__()") == (0, "")


def test_an_interrupt_while_the_client_closes_ends_the_program_normally():
    text = """
def interrupt():
    closing.wait()
    time.sleep(0.03)
    os.kill(os.getpid(), signal.SIGINT)
closing = threading.Event()
threading.Thread(target=interrupt, daemon=True).start()
try:
    with PlateClient.connect():
        time.sleep(0.2)
        closing.set()
    time.sleep(5.0)
except KeyboardInterrupt:
    pass
"""
    assert program(text) == (0, "")


@pytest.mark.parametrize(("end", "code"), [("sys.exit(5)", 5), ("print('ended')", 0)])
def test_a_forked_process_ends_as_usual(end, code):
    text = f"""
import sys
with PlateClient.connect() as plate:
    if (child := os.fork()) == 0:
        {end}
    else:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == {code}
        plate.node.get_name()
"""
    assert program(text) == (0, "")


def test_the_client_continues_after_an_exception_in_a_callback():
    """The exception is logged with its traceback."""
    text = """
from std_msgs.msg import Empty
messages = []
def on_message(msg):
    messages.append(msg)
    raise ZeroDivisionError("in a callback")
with PlateClient.connect() as plate:
    plate.node.create_subscription(Empty, "empty", on_message, 10)
    publisher = plate.node.create_publisher(Empty, "empty", 10)
    for count in (1, 2):
        def received():
            publisher.publish(Empty())
            return len(messages) >= count
        assert plate._until(received, 20.0)
    assert not plate.found("sort_parts")
"""
    code, errors = program(text)
    assert (code, errors.count("ZeroDivisionError: in a callback") >= 1) == (0, True), errors
    assert "in on_message" in errors


def test_a_client_in_a_forked_process_is_closed():
    text = """
with PlateClient.connect() as plate:
    if (child := os.fork()) == 0:
        try:
            plate.move_targets([])
        except Exception as problem:
            os._exit(3 if "the client is closed" in str(problem) else 4)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
"""
    assert program(text) == (0, "")


def test_a_closed_client_raises_in_all_threads():
    problems = []

    def wait():
        with pytest.raises(PlateError, match="the client is closed") as caught:
            plate._until(lambda: False, 10.0)
        problems.append(caught.value)

    with PlateClient.connect(f"/closed_{os.getpid()}") as plate:
        waiting = threading.Thread(target=wait)
        waiting.start()
    waiting.join()
    assert problems
    task = client.Task("sort_parts", lambda feedback, answer: None)
    for call in (
        lambda: plate.start(SortParts.Goal()),
        lambda: plate.wait(task),
        lambda: plate.cancel(task),
        lambda: plate.move_targets([]),
        lambda: plate.found("sort_parts"),
    ):
        with pytest.raises(PlateError, match="the client is closed"):
            call()


def test_a_closed_client_of_a_users_node_reports_this_in_its_tasks_too():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("user", context=context, namespace=f"/user_{os.getpid()}")
    plate = PlateClient(node, lambda condition, timeout_s: condition() or True)
    task = plate.send(SortParts.Goal())
    task._handle = SimpleNamespace(cancel_goal_async=lambda: pytest.fail("canceled"))
    for _ in range(2):
        plate.close()
    for call in (
        lambda: plate.found("sort_parts"),
        lambda: plate.send(SortParts.Goal()),
        lambda: plate.move_targets([]),
        lambda: plate.wait(task),
        task.send,
        task.cancel,
    ):
        with pytest.raises(PlateError, match="the client is closed"):
            call()
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_two_clients_of_a_process_have_different_names():
    with PlateClient.connect() as one, PlateClient.connect() as other:
        assert one.node.get_name() != other.node.get_name()


@pytest.mark.parametrize("why", [KeyboardInterrupt, PlateError])
def test_run_cancels_a_task_that_it_no_longer_waits_for(silent, monkeypatch, why):
    plate, task = silent
    canceled = []

    def cancel():
        canceled.append(task)
        task.status = TaskStatus(state=TaskStatus.ABORTED)

    task._handle = SimpleNamespace(cancel_goal_async=cancel)
    monkeypatch.setattr(plate, "start", lambda scenario: task)
    task.send()

    def until(condition, timeout_s):
        if not canceled and timeout_s > 0 and why is KeyboardInterrupt:
            raise KeyboardInterrupt
        return condition()

    plate._until = until
    with pytest.raises(why):
        plate.run(SortParts.Goal(), 0.0)
    assert canceled == [task]
