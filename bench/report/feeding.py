"""The chart of the feeder and its baselines: speed against accuracy of the pose, and waiting time
of the robot."""

from __future__ import annotations

from report.axis import Axis
from report.chart import Drawn
from report.panels import BASELINE, PROJECT, SECOND, Panels, Row, Style, group_rows

STYLES = {
    "ours": Style("this project, part by part", PROJECT, "o"),
    "vibrated": Style("baseline: vibrated in the plane", BASELINE, "s"),
    "thrown": Style("idealised baseline: thrown", SECOND, "D"),
}
LINES = {method: style._replace(line="-") for method, style in STYLES.items()}

CHANGED = {
    "fill": ("parts on the plate", (5, 10, 20, 40)),
    "clearance_mm": ("gripper's clearance [mm]", (3, 6, 12)),
    "cycle_s": ("robot's cycle [s]", (1, 2, 4)),
}
"""Label and values of the horizontal axis for each varied column."""

ROBOT_S, GOAL = 2.0, 2.0
"""The robot's cycle time in most cases [s], and the maximum allowed waiting time at this cycle time
[% of the time]."""


def feeding(rows: list[Row]) -> Drawn:
    """Return the chart of parts per minute against accuracy, and of the robot's waiting time
    against the varied value."""
    panels, cases = Panels(), [r | {"case": case_text(r)} for r in rows]
    speed = panels.add(
        "Speed and accuracy, robot cycle of 2 s", Axis("parts a minute"),
        Axis("pose error at the grip, 95th percentile [mm]", log=True),
    )  # fmt: skip
    timely_rows = [r for r in cases if r["error_95_mm"] is not None and r["cycle_s"] == ROBOT_S]
    speed.kinds(timely_rows, "method", "parts_per_min", "error_95_mm", STYLES, note="{case}")
    for key, (label, ticks) in CHANGED.items():
        panel = panels.add(
            f"Waiting against {label.split(' [')[0]}", Axis(label, log=True, ticks=ticks),
            Axis("robot waits [% of the time]"),
        )  # fmt: skip
        changed_rows = [r for r in cases if r["changed"] == key.split("_")[0]]
        note = "{case}; worst run {most_waiting:.1f} %"
        panel.kinds(changed_rows, "method", key, "waiting", LINES, note=note)
        panel.rule(f"goal: {GOAL:g} %", y=GOAL)
    small = [{**r, "kind": "discs in a window of 100 mm"} for r in rows if r["window_mm"]]
    kinds = group_rows([*(r for r in rows if r["changed"] == "kind"), *small], "kind")
    rates = "; ".join(
        f"{kind} " + ", ".join(f"{r['parts_per_min']:.1f}" for r in these)
        for kind, these in kinds.items()
    )
    lost = sum(r["lost"] for r in rows if r["method"] == "ours")
    return Drawn(
        panels,
        "Parts per minute of this project, the vibrated and the thrown baseline, with a robot "
        f"cycle of 2 s (maximum 30): {rates}. This project's feeder lost {lost or 'no'} parts over "
        "an edge.",
    )


def case_text(row: Row) -> str:
    """Return a text that describes the case of a row."""
    window = f", window of {row['window_mm']:g} mm" if row["window_mm"] else ""
    return (
        f"{row['fill']} {row['kind']}, clearance {row['clearance_mm']:g} mm, "
        f"robot {row['cycle_s']:g} s{window}"
    )
