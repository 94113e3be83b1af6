"""Send random goals to the real graph: valid and invalid goals, cancels, preemptions, stops.

The case passes if every goal has a result, every invalid goal is refused as invalid, and the plate
is at rest at the end.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from graph.observer import Observer
from graph.session import session
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from cases import Outcome
from plate_bringup import RunOptions
from plate_client import Task
from plate_core import load_rig
from plate_core.ros import msg_to_motors, scenario_to_goal
from plate_core.tasks import load_scenario
from plate_interfaces.msg import TaskStatus
from plate_planner.supervision import Reason

SCENARIOS = ("sort_4", "sort_6", "follow_2", "assemble_8", "spin_1")
"""Scenarios of the goals. The parts of the first scenario are on the plate. Therefore parts are
missing for the goals of the other scenarios."""

PAUSE_S, ANSWER_S, REST_S = 0.15, 10.0, 3.0
"""`PAUSE_S`: mean time between two goals [s]. `ANSWER_S`: maximum wait for results at the end [s].
`REST_S`: time until the plate must be at rest [s]."""


def make_invalid(goal: Any, rng: np.random.Generator) -> Any:
    """Make a goal invalid in one of four ways."""
    match int(rng.integers(4)):
        case 0:
            goal.time_limit_s = float(rng.choice([np.nan, -1.0, 1e300]))
        case 1:
            goal.parts = []
        case 2:
            goal.parts[0].type = "purple"
        case _:
            goal.parts[0].count = 0
    return goal


def random_goal(rng: np.random.Generator) -> tuple[Any, bool]:
    """Return a random goal, and whether it is invalid."""
    name = SCENARIOS[0] if rng.random() < 0.6 else str(rng.choice(SCENARIOS[1:]))
    scenario = replace(load_scenario(name), time_limit_s=float(rng.uniform(1.0, 20.0)))
    goal = scenario_to_goal(scenario)[1]
    if rng.random() < 0.2:
        return make_invalid(goal, rng), True
    return goal, False


def send_goals(observer: Observer, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Send goals, cancel or stop some of them, and return statistics of their results."""
    sent: list[tuple[Task, bool]] = []
    canceled: set[int] = set()
    stops = 0
    for number in range(count):
        goal, bad = random_goal(rng)
        sent.append((observer.client.send(goal), bad))
        if rng.random() < 0.1:
            observer.set_parameter("planner", "preempt", bool(rng.random() < 0.5))
        if rng.random() < 0.05:
            observer.trigger("stop")
            stops += 1
        if rng.random() < 0.4:  # also cancel goals that have ended or are not accepted yet
            chosen = int(rng.integers(max(0, number - 3), number + 1))
            sent[chosen][0].cancel()
            canceled.add(chosen)
        observer.until(lambda: False, float(rng.exponential(PAUSE_S)))
        if number % 100 == 99:
            print(f"  {number + 1} goals", flush=True)
    for task, _ in sent[-4:]:
        task.cancel()
    observer.until(lambda: all(task.ended for task, _ in sent), ANSWER_S)
    observer.trigger("stop")
    before = len(observer.record.tables)
    observer.until(lambda: False, REST_S)
    last = msg_to_motors(
        load_rig(), deserialize_message(observer.record.tables[-1], JointTrajectory)
    )
    reasons = Counter(
        Reason(task.status.reason).name if not task.done else "DONE"
        for task, _ in sent
        if task.status is not None
    )
    return {
        "goals": count,
        "wrong": sum(bad for _, bad in sent),
        "cancels": len(canceled),
        "stops": stops,
        "unanswered": sum(not task.ended for task, _ in sent),
        "wrong ones that began": sum(
            bad and task.status is not None and task.status.reason != TaskStatus.INVALID_GOAL
            for task, bad in sent
        ),
        "reasons": dict(reasons.most_common()),
        "tables at the end": len(observer.record.tables) - before,
        "plate rests": not np.any(last.knot_pose) and not np.any(last.knot_twist),
    }


def run(logs: Path, count: int = 1000, seed: int = 0) -> Iterator[Outcome]:
    """Send `count` goals to a graph with the parts of the first scenario."""
    with session(RunOptions(scenario=SCENARIOS[0], autostart=False), logs) as graph:
        graph.free()
        graph.observer.await_ready()
        result = send_goals(graph.observer, count, np.random.default_rng(seed))
    unwell = result["unanswered"] or result["wrong ones that began"]
    yield Outcome(result, well=result["plate rests"] and not unwell)
