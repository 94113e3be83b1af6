"""Tasks sent to the real graph by `plate_client`, as a script of a user would."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from cases.goals import send_goals
from graph.session import session
from light_graph import LightOptions

from plate_bringup import GraphError
from plate_client import PlateClient
from plate_core import PlateError
from plate_core.tasks import load_scenario
from plate_driver.safety.node import LATE
from plate_driver.transports import CALL_AGAIN, STOPPED_SINCE

SORT_4 = load_scenario("sort_4")


def test_the_demo_calls_enable_again_after_a_stall_but_not_after_another_stop():
    assert LATE.endswith(CALL_AGAIN)
    assert not STOPPED_SINCE.endswith(CALL_AGAIN)


def test_random_goals_are_all_answered_and_the_plate_rests(tmp_path, monkeypatch):
    options = LightOptions(scenario="sort_4", autostart=False)
    with session(options, tmp_path, pictures=False) as graph:
        graph.free()
        graph.observer.await_ready()
        check_the_command(graph)  # first: later the parts may be sorted already
        check_a_program(graph, monkeypatch)
        result = send_goals(graph.observer, 20, np.random.default_rng(1))
        assert result["unanswered"] == 0, result
        assert result["wrong ones that began"] == 0, result
        assert result["plate rests"], result
        # How many of the others were canceled, preempted or refused is a matter of the moment.
        assert result["reasons"]["INVALID_GOAL"] >= result["wrong"] > 0, result
        check_a_planner_that_dies(graph, monkeypatch)


def check_the_command(graph):
    """`plate goal` shows how a task gets on, and Ctrl-C cancels it."""
    domain = {"ROS_DOMAIN_ID": str(graph.observer.domain)}
    words = [sys.executable, "-c", "from plate_client.command import main; main()"]
    words += ["goal", "sort_4"]
    process = subprocess.Popen(
        words, env=os.environ | domain, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    record = graph.observer.record
    record.tasks.clear()
    assert graph.observer.until(lambda: "running" in record.states, 30)
    process.send_signal(signal.SIGINT)
    output, problem = process.communicate(timeout=30)
    assert process.returncode == 1, (output, problem)
    assert problem.startswith("plate: aborted")
    assert "canceled" in problem
    assert graph.observer.until(lambda: "canceled" in record.states[-1], 5)


def check_a_program(graph, monkeypatch):
    """The progress is current although the program never waits, and a second thread can cancel."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(graph.observer.domain))
    with PlateClient.connect() as plate:
        task = plate.start(SORT_4, ready_timeout_s=10.0)
        end = time.monotonic() + 10.0
        while task.feedbacks < 3 and time.monotonic() < end:
            time.sleep(0.02)
        assert task.progress.parts_total == 4
        second = threading.Thread(target=plate.cancel, args=(task,))
        second.start()
        assert "canceled" in plate.wait(task, 10.0).text
        second.join()


def check_a_planner_that_dies(graph, monkeypatch):
    """A client does not wait in vain for a promise of a dead planner."""
    observer = graph.observer
    plate = observer.client
    observer.pulses.clear()  # else the death of a node is the observer's error
    task = plate.start(SORT_4)
    graph.processes.signal("planner", signal.SIGKILL)
    with pytest.raises(PlateError, match="the planner has sent no message for 2 s"):
        plate.wait(task, 30.0)
    monkeypatch.setattr("plate_client.ros.client.DISCOVERY_S", 1.0)  # it has ended
    with pytest.raises(GraphError, match=r"no action sort_parts|has not answered the goal"):
        observer.start(SORT_4, 0.0)
