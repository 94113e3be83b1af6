"""Command that predicts whether a rig can perform a task: `ros2 run plate_bringup feasible`.

The prediction is a rehearsal of the task (see `rehearsal`). `python -m plate_bringup.feasible` is
the same command for computers without ROS.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from plate_core import PlateError, Rig, load_rig, piped
from plate_core.rig import MIN_GAMMA, rig_names, rig_path
from plate_core.tasks import (
    FeedTask,
    FollowTask,
    MoveTask,
    PartGroup,
    PoseTask,
    Scenario,
    Side,
    SortTask,
    edge_warnings,
    load_scenario,
)
from plate_planner.supervision import weak_plate_text

from .bounds import rest_to_rest_s, speed_bounds
from .rehearsal import STILL, Verdict, rehearse_task

NOT_REHEARSED = {
    PoseTask: "feasible cannot rehearse tasks of kind pose; run the demo instead",
    MoveTask: "feasible cannot rehearse tasks of kind move; run the demo instead",
    FeedTask: "feasible cannot rehearse tasks of kind feed; run "
    "`ros2 run plate_bringup qualify` instead",
}
"""Kinds of tasks that cannot be rehearsed, with an explanation and the command to use instead."""

COUNTS = (1, 2, 4, 10)
"""Numbers of parts that are rehearsed if no scenario is given."""

DISTANCE_M = 0.1
"""Distance from rest to rest for which the report states the minimum time [m]."""

PERIOD_S = 0.2
"""Maximum length of a cycle that the solver computes [s]."""

KEYS = {
    "stroke": "stroke_m", "speed": "speed_mps", "acceleration": "accel_mps2", "force": "force_n",
    "heat": "continuous_force_n",
}  # fmt: skip
"""Keys of the limits in the rig file, by the fields of `LimitUse`."""


@piped()
def main() -> None:
    """Run the command line. Exit code 0: the task is likely to succeed. 1: it is not likely. 2:
    arguments or files are wrong."""
    parser = argparse.ArgumentParser(
        prog="feasible",
        description="Estimate whether a rig can do a task, how fast parts can move, and which "
        "limit is used most. The task is rehearsed in a simulation by the solver, which takes "
        "some seconds. Exit code: 0 likely, 1 not likely, 2 wrong arguments.",
    )
    parser.add_argument(
        "--scenario",
        default="",
        help="name in config/scenarios, or .yaml file (default: no task; the speeds of 1, 2, 4 and "
        "10 parts are printed)",
    )
    parser.add_argument(
        "--rig", default="",
        help=f"rig file, or one of {', '.join(rig_names())} (default: the rig of the scenario)",
    )  # fmt: skip
    args = parser.parse_args()
    try:
        scenario = load_scenario(args.scenario) if args.scenario else None
        name = args.rig or (scenario.rig if scenario else "")
        rig = load_rig(name)
        text, likely = feasibility_report(rig, rig_path(name).name, scenario)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    print(text)
    sys.exit(0 if likely else 1)


def feasibility_report(rig: Rig, name: str, scenario: Scenario | None) -> tuple[str, bool]:
    """Return the lines of the report, and whether the task is likely to succeed. If no task is
    given, return whether parts can be moved."""
    lines = [
        f"{name}: shaking ratio Gamma = {rig.gamma:.1f}, limited by {rig.reach.limit}; parts slide "
        "if Gamma is above 1",
        one_part_line(rig),
        "",
    ]
    text, likely = task_lines(rig, scenario) if scenario else part_count_table(rig)
    return "\n".join(lines + text), likely


def one_part_line(rig: Rig) -> str:
    """Return a line about the maximum speed of one part."""
    bounds = speed_bounds(rig, PERIOD_S)
    return (
        f"one part on a line: periodic motions of {PERIOD_S:g} s give it a mean speed of at most "
        f"{1e3 * bounds.minimum:.0f} mm/s (limited by {bounds.binding_limit}, see docs/model.md); "
        f"{1e3 * DISTANCE_M:.0f} mm from rest to rest take at least "
        f"{rest_to_rest_s(DISTANCE_M, rig.friction.accel):.2f} s"
    )


def task_lines(rig: Rig, scenario: Scenario) -> tuple[list[str], bool]:
    """Return the lines about a scenario, and whether the task is likely to succeed."""
    for kind, reason in NOT_REHEARSED.items():
        if isinstance(scenario.task, kind):
            return [f"{scenario.name}: unknown: {reason}"], False
    try:
        verdict = rehearse_task(rig, scenario)
    except PlateError as error:
        return [f"{scenario.name}: impossible: {error}"], False
    likely, count = verdict.likely, len(verdict.rehearsals)
    times = ", ".join(_time_text(rehearsal.time_s) for rehearsal in verdict.rehearsals)
    requested = ""
    if isinstance(scenario.task, FollowTask):
        requested = f", requested: {1e3 * max(path.speed for path in scenario.task.paths):.0f} mm/s"
    lines = [
        f"{scenario.name}: {'likely' if likely else 'not likely'}: {verdict.in_time} of {count} "
        f"rehearsals end within {scenario.time_limit_s:g} s (time_limit_s); they take [s]: {times}",
        f"{scenario.count} part{'s' * (scenario.count > 1)}: {1e3 * verdict.speed:.0f} mm/s on "
        f"average{requested}",
        _used_limits_text(verdict),
    ]
    if any(rehearsal.lost for rehearsal in verdict.rehearsals):
        lines.append("a part leaves the plate: move starts and goals away from the edges")
    lines += [f"warning: {warning}" for warning in edge_warnings(scenario, rig)]
    if not likely:
        lines.append(advice_for(rig, verdict))
    return lines, likely


def part_count_table(rig: Rig) -> tuple[list[str], bool]:
    """Return a table of the predicted speeds for several numbers of parts. Half of the parts move
    to the left, the others to the right. Also return whether the parts move."""
    lines = ["random places to two sides   mean speed [mm/s]   most used limit"]
    moved = False
    for count in COUNTS:
        try:
            verdict = rehearse_task(rig, make_sort_scenario(count), 1)
        except PlateError:
            lines.append(f"  {count:2d} part{'s' * (count > 1)}: do not fit on this plate")
            continue
        moved = moved or verdict.speed > STILL
        binding = verdict.limit_use.binding_limit
        lines.append(
            f"  {count:2d} part{'s' if count > 1 else ' '}  {1e3 * verdict.speed:33.0f}   "
            f"{binding}, {100 * max(verdict.limit_use):.0f} % of {KEYS[binding]}"
        )
    lines.append(
        "to estimate the duration of a task, use --scenario NAME"
        if moved
        else "not likely: parts hardly move"
    )
    return lines, moved


def make_sort_scenario(count: int) -> Scenario:
    """Return a sort task with `count` parts, in which black parts move to the left and grey parts
    to the right."""
    groups = {"black": Side(-1, 0), "grey": Side(1, 0)}
    numbers = zip(groups, (count - count // 2, count // 2), strict=True)
    return Scenario(
        name=f"sort_{count}",
        description="",
        parts=tuple(PartGroup(label, number) for label, number in numbers if number),
        task=SortTask(groups, 0.6, 0.5),
        time_limit_s=120.0,
    )


def _time_text(seconds: float) -> str:
    return f"{seconds:.1f}" if np.isfinite(seconds) else "not done in time"


def _used_limits_text(verdict: Verdict) -> str:
    """Return a line about the used fractions of the rig's limits."""
    use = verdict.limit_use
    used = ", ".join(f"{name} {100 * value:.0f} %" for name, value in use._asdict().items())
    return f"used fractions of the rig's limits: {used}; {KEYS[use.binding_limit]} is used most"


def advice_for(rig: Rig, verdict: Verdict) -> str:
    """Return advice: the changes that would make the task likely to succeed."""
    binding = verdict.limit_use.binding_limit
    advice = f"the most used limit is {binding} ({KEYS[binding]}); fewer parts may help"
    if rig.gamma < MIN_GAMMA:
        advice = f"{weak_plate_text(rig)}, or fewer parts"
    if np.isfinite(verdict.time_s) and not any(rehearsal.lost for rehearsal in verdict.rehearsals):
        advice += f"; or a time_limit_s of {1.2 * verdict.time_s:.0f} s"
    return advice


if __name__ == "__main__":
    main()
