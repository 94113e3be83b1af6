"""The task that runs, and the monitor that ends it, without ROS."""

import re
from dataclasses import replace

import numpy as np
import pytest
from plant import RIG, T

from plate_core import OverlookedThing, Parts, PlateCycle, PlateError
from plate_core.driver_status import DriverState, DriverStatus
from plate_core.status import Level
from plate_core.tasks import FeedOrder, PartTarget, load_scenario
from plate_planner import Planner, PlannerOptions
from plate_planner.diagnostics import PlannerDiagnostics
from plate_planner.supervision import STOP, Failure, InputMonitor, Inputs, Reason
from plate_planner.supervision.inputs import CYCLES, FRESH_S, LIFE_S
from plate_planner.task_run import TaskRunner

IDS = ("black_1", "black_2", "grey_1", "grey_2")
PARTS = Parts.make(IDS, np.array([[-0.05, -0.05], [-0.05, 0.05], [0.05, -0.05], [0.05, 0.05]]))
READY = DriverStatus(DriverState.READY, text="ready")
CANCELED = Failure(Reason.CANCELED, "canceled")
LOST = Failure(Reason.NO_PARTS, "no parts")


class Loop:
    """A planner's objects, with inputs that a test records."""

    def __init__(self, **inputs):
        self.publishers, self.second = 1, ""
        self.tasks = TaskRunner(RIG, PlannerOptions())
        self.monitor = InputMonitor(
            Inputs.none_yet(0.0, 2.0, **inputs), 10.0, 0.0, lambda topic: self.publishers,
            lambda topic: self.second if topic == "parts" else "",
        )  # fmt: skip
        self.diagnostics = PlannerDiagnostics(self.tasks, self.monitor, triggered=True)

    def hear(self, now, period=T):
        """Receive all inputs, at most a period apart."""
        assert self.monitor.wake(now, period) is None
        inputs = self.monitor.inputs.driver_received(now, READY)
        self.monitor.inputs = inputs.parts_received(now, round(1e9 * now))

    def begin(self, name="sort_4", now=0.0):
        self.tasks.begin(Planner(RIG, load_scenario(name)), object(), now)
        return self.tasks.run

    def problem(self, now, task=None):
        run = self.tasks.run
        return self.monitor.task_problem(now, run.began, run.task if task is None else task, T)


@pytest.fixture(name="loop")
def _loop():
    return Loop()


def test_a_task_runs_until_it_is_ended(loop):
    assert loop.tasks.running is None
    assert not loop.tasks.end(STOP)
    run = loop.begin()
    assert loop.tasks.running is run
    for k in range(3):
        expected = loop.tasks.plan(run, PARTS, k * T)
    assert expected.parts.ids == IDS
    assert run.progress.parts_total == 4
    assert loop.tasks.end(LOST)
    assert loop.tasks.running is None
    assert loop.tasks.run.failed
    assert not loop.tasks.end(CANCELED)
    assert run.task.reason is Reason.NO_PARTS


def test_a_task_that_a_person_ends_has_not_failed(loop):
    run = loop.begin()
    loop.tasks.end(CANCELED)
    assert run.task.phase.is_failure
    assert not run.failed


def test_the_parts_are_tracked_before_during_and_after_a_task(loop):
    tasks = loop.tasks
    tasks.see(PARTS, 1.0)
    assert tasks.seen_without_task(1.0)
    assert tasks.estimator.seen.ids == IDS
    run = loop.begin()
    assert run.state.estimator.seen.ids == IDS
    tasks.see(PARTS, 1.0 + T)
    assert not tasks.seen_without_task(1.0 + T)
    tasks.record_cycle(PlateCycle.rest(T), 1.0 + T, 1.0 + T)
    tasks.end(STOP)
    estimator = tasks.estimator
    tasks.forget()
    assert tasks.run is None
    assert tasks.estimator is estimator
    assert tasks.seen_without_task(1.0 + T)


def test_targets_and_orders_need_their_kind_of_task(loop):
    target = PartTarget("grey_1", (0.1, 0.0))
    for name in (None, "sort_4"):
        if name is not None:
            loop.begin(name)
        with pytest.raises(PlateError, match="no task of kind move runs"):
            loop.tasks.retarget((target,))
        with pytest.raises(PlateError, match="no task of kind feed runs"):
            loop.tasks.order(FeedOrder())
    assert loop.tasks.targets == ()
    run = loop.begin("play")
    for k in range(3):
        loop.tasks.plan(run, PARTS, k * T)
    unknown = replace(target, id="black_9")
    [refused] = loop.tasks.retarget((target, unknown))
    assert "black_9 is unknown" in refused
    assert loop.tasks.targets == (target,)
    loop.tasks.end(STOP)
    assert loop.tasks.targets == ()


def test_other_objects_are_reported_once_per_task(loop):
    thing = OverlookedThing(0.2, 0.1, RIG.parts.radius_m, "too dark")
    assert loop.tasks.record_image((thing,), PARTS) == ""  # no task runs
    for first in (0, 4):
        run = loop.begin()
        texts = []
        for k in range(first, first + 4):
            loop.tasks.plan(run, PARTS, k * T)
            texts.append(loop.tasks.record_image((thing,), PARTS))
        [text] = filter(None, texts)
        assert text.startswith("sort_4 moves 4 parts: the image shows 1 undetected object")
        assert text in loop.diagnostics.finding(0.0).message


def test_a_task_starts_when_all_inputs_have_arrived(loop):
    loop.second = "2 nodes publish parts (a, b), allowed: one"
    assert loop.monitor.start_problem(0.0) == loop.second
    loop.second = ""
    assert loop.monitor.start_problem(0.0).startswith("no driver_status yet")
    loop.hear(0.1)
    assert loop.monitor.start_problem(0.1) == ""
    free_running = Loop(triggered=False)
    free_running.hear(0.1)
    assert free_running.monitor.start_problem(0.1).startswith("no start of a cycle yet")


def test_a_task_without_all_parts_ends_even_if_stamps_stand_still(loop):
    loop.begin()
    waiting = loop.tasks.run.task
    assert waiting.began is None
    for k in range(102):
        loop.hear(0.1 * k)
    assert loop.problem(10.1) is None
    failure = loop.problem(10.11)
    assert failure == Failure(
        Reason.PARTS_MISSING, "not all parts were detected within 10 s after the goal"
    )
    assert loop.problem(10.11, replace(waiting, began=1.0)) is None


def test_a_second_publisher_ends_a_task_and_does_not_hide_another_reason(loop):
    loop.begin()
    loop.hear(0.1)
    loop.second = "2 nodes publish parts (a, b), allowed: one"
    assert loop.problem(0.1) == Failure(Reason.RIVAL, loop.second)
    failure = loop.problem(9.0)
    assert failure.reason is Reason.NO_DRIVER
    assert failure.text.endswith(f"; {loop.second}")


FRESH = max(FRESH_S, CYCLES * T)


@pytest.mark.parametrize(
    ("stale", "silent", "blamed"),
    [
        (["detector"], {}, "detector"),
        (["detector", "simulator"], {}, "detector"),
        (["detector", "simulator", "device"], {}, "simulator"),
        (["solver", "driver"], {}, "solver"),
        (["solver"], {"parts": FRESH + 0.1}, None),
        (["driver", "simulator"], {}, "driver"),
        (["driver"], {"plate_cycle": FRESH + 0.1}, None),
        (["driver"], {"plate_cycle": FRESH - 0.1}, "driver"),
        (["simulator"], {}, "simulator"),
        (["simulator", "device"], {}, "device"),
        (["device"], {"driver_status": LIFE_S + 0.1}, None),
        ([], {}, None),
    ],
)
def test_the_first_node_that_lacks_input_is_blamed(loop, stale, silent, blamed):
    """A node that follows one which sends nothing lacks input only as a consequence."""
    began, now = 10.0, 20.0
    inputs = loop.monitor.inputs.driver_received(now - silent.get("driver_status", 0), READY)
    inputs = inputs.parts_received(now - silent.get("parts", 0), 1)
    if "plate_cycle" in silent:
        inputs = inputs.request_sent(now - silent["plate_cycle"])
    for name in ("detector", "solver", "driver", *stale):
        level = Level.STALE if name in stale else Level.OK
        inputs = inputs.report_received(now, name, level, f"{name} says so")
    failure = inputs.problem(now, began, T, lambda topic: 1)
    expected = blamed and Failure(Reason.CUT_OFF, f"{blamed}: {blamed} says so")
    assert failure == expected
    just = inputs.parts.timeout_s  # the first seconds of a task are not blamed on anybody
    assert inputs.problem(now, now - just, T, lambda topic: 1) is None


def test_parts_with_the_same_stamp_are_named(loop):
    """A camera whose driver writes no stamps: parts arrive, but never with a new stamp."""
    inputs = loop.monitor.inputs.parts_received(0.0, 0).parts_received(0.1, 0)
    text = inputs.parts_problem(20.0, lambda topic: 1)
    assert text.startswith("no new parts for 20.0 s: the messages have the same stamp, 0.000 s")
    assert "no node publishes parts" in inputs.parts_problem(20.0, lambda topic: 0)
    inputs = inputs.parts_received(20.0, 1)
    assert inputs.parts_problem(20.1, lambda topic: 1) == ""
    assert "same stamp" not in inputs.parts_problem(40.0, lambda topic: 1)


@pytest.mark.parametrize(
    ("publishers", "reported_s", "text"),
    [
        (0, 0.1, "no node publishes parts"),
        (1, None, "camera run"),
        (1, 60.0, "detector no longer publishes"),
        (1, 0.1, "detector runs and reports: it sees nothing"),
    ],
)
def test_the_reason_for_missing_parts_is_the_nearest_known(loop, publishers, reported_s, text):
    now, inputs = 100.0, loop.monitor.inputs.driver_received(100.0, READY)
    if reported_s is not None:
        inputs = inputs.report_received(now - reported_s, "detector", Level.OK, "it sees nothing")
    assert text in inputs.parts_problem(now, lambda topic: publishers)
    failure = inputs.problem(now, 90.0, T, lambda topic: publishers)
    assert failure.reason is Reason.NO_PARTS
    assert re.search(f"10.0 s; .*{text}", failure.text)


def test_a_stall_of_the_process_is_a_failure_once_and_old_goals_are_refused(loop):
    loop.hear(0.1)
    assert not loop.monitor.goal_may_be_old(0.1)
    failure = loop.monitor.wake(9.0, T)
    assert failure == Failure(Reason.STOOD_STILL, "the planner was stalled for 8.9 s")
    assert loop.monitor.goal_may_be_old(9.0)
    assert loop.monitor.wake(9.1, T) is None
    assert loop.monitor.start_problem(9.1) == ""


def test_the_diagnostics_name_the_task_its_failure_and_refused_messages(loop):
    loop.hear(0.1)
    finding = loop.diagnostics.finding(0.1)
    assert (finding.level, finding.message) == (Level.OK, "idle")
    loop.diagnostics.refusal = "targets: wrong"
    finding = loop.diagnostics.finding(0.1)
    assert (finding.level, finding.message) == (Level.WARN, "idle; targets: wrong")
    loop.diagnostics.reported()
    run = loop.begin()
    assert loop.diagnostics.finding(0.1).message == "running"
    assert loop.diagnostics.values(0.1)["task"] == "sort_4"
    for why, level in ((LOST, Level.ERROR), (CANCELED, Level.WARN)):
        run = loop.begin()
        loop.tasks.end(why)
        finding = loop.diagnostics.finding(0.1)
        assert (finding.level, finding.message) == (level, run.task.text)


def test_starts_of_cycles_are_only_missing_while_the_driver_is_ready():
    inputs = Inputs.none_yet(0.0, 2.0, triggered=False).parts_received(9.0, 1)
    for state, levels in ((DriverState.READY, [Level.STALE]), (DriverState.DISABLED, [Level.WARN])):
        status = DriverStatus(state, text="text")
        findings = inputs.driver_received(9.0, status).findings(10.0, lambda topic: 1)
        assert [each.level for each in findings if each is not None] == levels
