"""Predict whether a rig can perform a task: `ros2 run plate_bringup feasible`.

The task is rehearsed with the solver's own prediction (`rehearsal`). Without ROS,
`python -m plate_bringup.feasible` does the same.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from plate_core import PlateError, Rig, load_rig, piped
from plate_core.rig import LEAST_GAMMA, rig_names, rig_path
from plate_core.tasks import (
    FeedTask,
    FollowTask,
    MoveTask,
    PartGroup,
    PoseTask,
    Scenario,
    Side,
    SortTask,
    edge_doubts,
    load_scenario,
)

from .bounds import rest_to_rest_s, speed_bounds
from .rehearsal import STILL, Verdict, judge_task

NOT_REHEARSED = {
    PoseTask: "angles are not rehearsed; the demo shows it",
    MoveTask: "targets that may change are not rehearsed; the demo shows it",
    FeedTask: "parts that come and go are not rehearsed; `ros2 run plate_bringup qualify` shows it",
}
"""Tasks that are not rehearsed, and the reasons."""

COUNTS = (1, 2, 4, 10)
"""Numbers of parts to rehearse if no scenario is given."""

WAY_M, PERIOD_S = 0.1, 0.2
"""Distance for which the report gives the minimum time [m], and the longest cycle of the solver
[s]."""

KEYS = {
    "stroke": "stroke_m", "speed": "speed_mps", "acceleration": "accel_mps2", "force": "force_n",
    "heat": "continuous_force_n",
}  # fmt: skip
"""Keys of the limits in the rig file, by field of `Share`."""


@piped()
def main() -> None:
    """Run the command line. Exit code 0: likely, 1: not likely, 2: wrong arguments or files."""
    parser = argparse.ArgumentParser(
        prog="feasible",
        description="Tell whether a rig can do a task, how fast parts can be driven, and what "
        "binds. The task is rehearsed by prediction, within some seconds. Exit code: 0 likely, "
        "1 not, 2 wrong arguments.",
    )
    parser.add_argument(
        "--scenario", default="", help="name or file (none: how fast 1, 2, 4 and 10 parts are)"
    )
    parser.add_argument(
        "--rig", default="",
        help=f"rig file, or one of {', '.join(rig_names())} (the scenario's, or the default rig)",
    )  # fmt: skip
    args = parser.parse_args()
    try:
        scenario = load_scenario(args.scenario) if args.scenario else None
        name = args.rig or (scenario.rig if scenario else "")
        rig = load_rig(name)
        told, likely = report(rig, rig_path(name).name, scenario)
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    print(told)
    sys.exit(0 if likely else 1)


def report(rig: Rig, name: str, scenario: Scenario | None) -> tuple[str, bool]:
    """Return the report as lines for a terminal, and whether the task is likely to succeed. Without
    a task, return whether moving one part is likely to succeed."""
    lines = [
        f"{name}: Gamma = {rig.gamma:.1f}, limited by {rig.reach.limit}; parts slide above 1",
        one_part(rig),
        "",
    ]
    told, likely = of_task(rig, scenario) if scenario else of_counts(rig)
    return "\n".join(lines + told), likely


def one_part(rig: Rig) -> str:
    """Return a line about the maximum speed of one part."""
    bounds = speed_bounds(rig, PERIOD_S)
    return (
        f"one part: at most {1e3 * bounds.least:.0f} mm/s along a line by any steady motion of "
        f"{PERIOD_S:g} s (bound by {bounds.binds}: docs/model.md); {1e3 * WAY_M:.0f} mm from rest "
        f"to rest take {rest_to_rest_s(WAY_M, rig.friction.accel):.2f} s or more"
    )


def of_task(rig: Rig, scenario: Scenario) -> tuple[list[str], bool]:
    """Return the lines about a scenario, and whether it is likely to succeed."""
    for kind, what in NOT_REHEARSED.items():
        if isinstance(scenario.task, kind):
            return [f"{scenario.name}: not known: {what}"], False
    try:
        verdict = judge_task(rig, scenario)
    except PlateError as error:
        return [f"{scenario.name}: no: {error}"], False
    likely, count = verdict.likely, len(verdict.rehearsals)
    times = ", ".join(_time(each.time_s) for each in verdict.rehearsals)
    asked = ""
    if isinstance(scenario.task, FollowTask):
        asked = f", {1e3 * max(path.speed for path in scenario.task.paths):.0f} asked"
    lines = [
        f"{scenario.name}: {'likely' if likely else 'not likely'}: {verdict.in_time} of {count} "
        f"rehearsals end within {scenario.time_limit_s:g} s (time_limit_s); they take [s]: {times}",
        f"{scenario.count} part{'s' * (scenario.count > 1)}: {1e3 * verdict.speed:.0f} mm/s on "
        f"average{asked}",
        _used(verdict),
    ]
    if any(each.lost for each in verdict.rehearsals):
        lines.append("a part leaves the plate: starts and goals further from the edges would do")
    lines += [f"warning: {doubt}" for doubt in edge_doubts(scenario, rig)]
    if not likely:
        lines.append(remedy(rig, verdict))
    return lines, likely


def of_counts(rig: Rig) -> tuple[list[str], bool]:
    """Return a table of the speed for several numbers of parts. Half of them move to the left, half
    to the right."""
    lines = ["scattered, to either side   mean speed [mm/s]   most used"]
    moved = False
    for count in COUNTS:
        try:
            verdict = judge_task(rig, sides(count), 1)
        except PlateError:
            lines.append(f"  {count:2d} part{'s' * (count > 1)}: no room on this plate")
            continue
        moved = moved or verdict.speed > STILL
        binds = verdict.share.binds
        lines.append(
            f"  {count:2d} part{'s' if count > 1 else ' '}  {1e3 * verdict.speed:33.0f}   "
            f"{binds}, {100 * max(verdict.share):.0f} % of {KEYS[binds]}"
        )
    lines.append("what a task takes: --scenario NAME" if moved else "not likely: parts hardly move")
    return lines, moved


def sides(count: int) -> Scenario:
    """Return a sort task with `count` parts, black ones to the left and grey ones to the right."""
    groups = {"black": Side(-1, 0), "grey": Side(1, 0)}
    numbers = zip(groups, (count - count // 2, count // 2), strict=True)
    return Scenario(
        name=f"sort_{count}",
        description="",
        parts=tuple(PartGroup(label, number) for label, number in numbers if number),
        task=SortTask(groups, 0.6, 0.5),
        time_limit_s=120.0,
    )


def _time(seconds: float) -> str:
    return f"{seconds:.1f}" if np.isfinite(seconds) else "no end in sight"


def _used(verdict: Verdict) -> str:
    """Return a line about the used fractions of the rig's limits."""
    share = verdict.share
    told = ", ".join(f"{name} {100 * value:.0f} %" for name, value in share._asdict().items())
    return f"used of the rig's limits: {told}; {KEYS[share.binds]} binds"


def remedy(rig: Rig, verdict: Verdict) -> str:
    """Return advice about changes that would help."""
    binds = verdict.share.binds
    said = f"most used is {binds} ({KEYS[binds]}); fewer parts may do"
    if rig.gamma < LEAST_GAMMA:
        said = (
            f"the plate shakes too little: Gamma = {rig.gamma:.1f}, limited by {rig.reach.limit}; "
            f"{LEAST_GAMMA:g} or more is advised, or fewer parts"
        )
    if np.isfinite(verdict.time_s) and not any(each.lost for each in verdict.rehearsals):
        said += f"; or a time_limit_s of {1.2 * verdict.time_s:.0f} s"
    return said


if __name__ == "__main__":
    main()
