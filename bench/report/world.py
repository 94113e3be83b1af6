"""Charts of the simulator, of vision, and of the closed loop's computing time."""

from __future__ import annotations

from harness import rounded
from plate_sim.friction import TOLERANCE
from plate_sim.world import STEP
from report.axis import Axis
from report.chart import Data, Drawn, Sheet, column, table
from report.panels import (
    BASELINE,
    FAINT,
    LIMIT,
    PROJECT,
    SECOND,
    THIRD,
    Panels,
    Row,
    Style,
    group_rows,
)

MIN_MM = 1e-12
"""Minimum drawn error [mm]. Smaller errors are rounding errors, and are drawn at this value."""

DEFAULT_TOLERANCE = f"{TOLERANCE:g} m"
"""Default setting of the simulator."""

SIMULATORS = {
    "by events": Style("points, by events", PROJECT),
    "in steps": Style("points, in steps", SECOND, "s"),
    "plate_sim": Style("discs", PROJECT), "bodies": Style("rotating bodies", SECOND, "s"),
    "pymunk": Style("pymunk", BASELINE, "D"), "MuJoCo": Style("MuJoCo", THIRD, "^"),
    "scipy RK45": Style("scipy", FAINT, "x"),
}  # fmt: skip
"""Appearance of the simulator's methods and of the baselines."""

SIMULATED = (
    ("travel", "gamma", "1 part, shaken at {} mu g", "error of the travel after 1 s [mm]",
     "error_mm", MIN_MM, "-"),
    ("discs", "parts", "{} colliding discs", "maximum overlap [µm]", "overlap_um", 0.01, ""),
    ("body", "case", "1 {} that slides and rotates, 0.2 s", "error of centre or edge [mm]",
     "error_mm", None, "-"),
)  # fmt: skip
"""Groups of panels. Each group has a case, a column whose values select the panels, a title of a
panel, and a label of the vertical axis. Then follow the column of the drawn numbers, the minimum
drawn number (None: no minimum), and the line style."""


def sim_rows(data: Data) -> Sheet:
    """Return the rows of the chart `sim`. The cases are travel, discs, body and lead."""
    error, discs = table(data, "sim", "error"), table(data, "sim", "discs")
    rows: list[Row] = [{"case": "travel"} | r for r in error.rows]
    rows += [
        {"case": "discs", "setting": f"{r['step_ms']:g} ms"}
        | {key: r[key] for key in ("method", "parts", "step_ms", "overlap_um", "speed")}
        for r in discs.rows
    ]
    rows += [{"case": "body"} | r for r in table(data, "bodies", "bodies").rows]
    rows += [
        {"case": "lead", "parts": r["parts"], "lead": r["lead"]}
        for r in table(data, "sim", "speed").rows
    ]
    kinds = {"case": "case", "method": "method", "gamma": "peak accel. [mu g]", "parts": "parts"}
    heads = {"overlap_um": discs.columns["overlap_um"], "lead": "times as fast as pymunk"}
    return Sheet.of(rows, kinds | error.columns | kinds | heads)


def sim(rows: list[Row]) -> Drawn:
    """Return the chart of the simulator's error against speed, for separate and for colliding
    parts."""
    panels, cases = Panels(), group_rows(rows, "case")
    speed = Axis("simulated time per CPU time [s/s]", log=True)
    for case, key, title, label, error, minimum, line in SIMULATED:
        styles = {method: style._replace(line=line) for method, style in SIMULATORS.items()}
        for value, value_rows in sorted(group_rows(cases[case], key).items()):
            y = Axis(label, log=True, minimum=minimum)
            panel = panels.add(title.format(value), speed, y, "more less")
            panel.kinds(value_rows, "method", "speed", error, styles, note="{setting}")
            for row in filter(is_default, value_rows):
                panel.mark(row["speed"], row[error])
    lead = ", ".join(f"{r['lead']:.0f}" for r in cases["lead"] if r["lead"])
    counts = ", ".join(str(r["parts"]) for r in cases["lead"])
    return Drawn(
        panels,
        f"With {counts} parts, the simulator is {lead} times as fast as pymunk at the same error. "
        "The minimum error of the simulator is "
        f"{min(column(cases['travel'], 'error_mm')):.0e} mm.",
        f"Points are simulated event by event with a tolerance of {DEFAULT_TOLERANCE}. Parts of "
        f"finite size are simulated in steps of {1e3 * STEP:g} ms.",
    )


def is_default(row: Row) -> bool:
    """Whether a setting of the simulator is its default."""
    if row["case"] == "discs":
        return bool(row["method"] == "plate_sim" and row["step_ms"] <= 1.01e3 * STEP)
    return row["setting"] == (
        DEFAULT_TOLERANCE if row["case"] == "travel" else f"{1e3 * STEP:g} ms"
    )


def cost_rows(data: Data) -> Sheet:
    """Return the rows of the chart `cost`: stages [ms], and models of parts [s per simulated s]."""
    stages, models = table(data, "stages", "stages"), table(data, "sim", "cost")
    seconds = [
        {key: value if key == "parts" else value and 1 / value for key, value in r.items()}
        for r in models.rows
    ]
    rows = [{"case": "stages"} | r for r in stages.rows]
    rows += [{"case": "simulator"} | r for r in rounded(seconds)]
    heads = {key: f"{key} [s for 1 s]" for key in models.columns if key != "parts"}
    return Sheet.of(rows, {"case": "case"} | stages.columns | heads)


def cost(rows: list[Row]) -> Drawn:
    """Return the chart of the computing time of every stage and of every model of the simulator, by
    number of parts."""
    stages, models = group_rows(rows, "case")["stages"], group_rows(rows, "case")["simulator"]
    counts = column(stages, "parts")
    panels = Panels()
    first = panels.add(
        "All stages, one image", Axis("parts on the plate", ticks=tuple(counts)),
        Axis("median time for one image [ms]", log=True),
    )  # fmt: skip
    for key, *style in (
        ("solver", "solver", PROJECT, "o", "-"), ("vision", "vision", BASELINE, "s", "-"),
        ("driver", "driver", SECOND, "D", "-"), ("planner", "planner", THIRD, "^", "-"),
        ("simulator", "simulator", FAINT, "v", ":"), ("camera", "camera", FAINT, "x", "--"),
        ("answer", "image to setpoints", "#111111", "", "-"),
        ("period", "limit: one cycle", LIMIT, "", "-"),
    ):  # fmt: skip
        first.points(stages, "parts", key, Style(*style))
    second = panels.add(
        "The simulator", Axis("parts", log=True), Axis("CPU time for 1 s [s]", log=True)
    )
    for key, *style in (
        ("by events", "points, by events", PROJECT, "o", "-"),
        ("in steps", "parts, in steps", SECOND, "s", "-"),
        ("pymunk", "pymunk, 1 ms", BASELINE, "x", "-"),
    ):
        second.points(models, "parts", key, Style(*style))
    second.rule("real time", y=1)
    last = stages[-1]
    return Drawn(
        panels,
        f"With {last['parts']} parts, the stages take {last['answer']:.1f} ms from image to "
        f"setpoints. This is {100 * last['answer'] / last['period']:.0f} % of a cycle of "
        f"{last['period']:.0f} ms. The solver takes "
        f"{100 * last['solver'] / last['answer']:.0f} % of this time.",
    )


def range_text(rows: list[Row], key: str) -> str:
    """Return the minimum and maximum of a column."""
    return f"{min(column(rows, key)):.2g} to {max(column(rows, key)):.2g}"


def vision(rows: list[Row]) -> Drawn:
    """Return the chart of error against time for finding discs, with a panel for each scene."""
    colours = (PROJECT, BASELINE, SECOND, THIRD, "#8a6d00", LIMIT)
    methods = list(group_rows(rows, "method"))
    styles = {
        name: Style(name, *style) for name, *style in zip(methods, colours, "osD^vx", strict=False)
    }
    scenes = group_rows([r for r in rows if r["rms_px"] is not None], "place", "discs")
    panels = Panels()
    for (position, discs), scene_rows in sorted(scenes.items()):
        panel = panels.add(
            f"{discs} discs, {position}", Axis("time for one image, in a loop [ms]", log=True),
            Axis("error of the centres, RMS [px]", log=True), "less less",
        )  # fmt: skip
        note = "missed {missed_percent:.0f} %, false {false_percent:.0f} %"
        panel.kinds(scene_rows, "method", "loop_ms", "rms_px", styles, hollow=is_wrong, note=note)
        panel.mark(scene_rows[0]["loop_ms"], scene_rows[0]["rms_px"])
    ours = [r for r in rows if r["method"] == methods[0]]
    return Drawn(
        panels,
        f"The detector has an error of {range_text(ours, 'rms_px')} px, misses no disc, and "
        f"detects no false disc. An image takes {range_text(ours, 'loop_ms')} ms, or "
        f"{range_text(ours, 'turns_ms')} ms if the baselines run in between.",
    )


def is_wrong(row: Row) -> bool:
    """Whether a method missed parts, or found parts that do not exist."""
    return row["missed_percent"] + row["false_percent"] > 0
