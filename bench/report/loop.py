"""Charts of the closed loop: tracking, cameras, drives, rigs."""

from __future__ import annotations

from harness import shown
from report.axis import Axis
from report.chart import Drawn, column, parts
from report.panels import FAINT, LIMIT, PROJECT, SECOND, Panels, Row, Style, group_rows
from report.solver import METHODS
from tasks.free_running import ALLOWED_MM

COUNT_COLOURS = ("#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#8a6d00", "#b02a37")
SPEEDS = (2, 5, 10, 20, 40, 80, 160, 320, 1000)

ENDED = "{succeeded} ended well"
"""Text of a point, which the page shows at the mouse pointer."""


def tracking(rows: list[Row]) -> Drawn:
    """Return the chart of tracking error against speed. It also shows the maximum speed and its
    theoretical bound, by number of parts."""
    counts, groups = sorted(group_rows(rows, "parts")), group_rows(rows, "method")
    styles = {
        count: Style(parts(count), colour, "o", "-")
        for count, colour in zip(counts, COUNT_COLOURS, strict=False)
    }
    panels = Panels()
    for method, method_rows in groups.items():
        panel = panels.add(
            METHODS[method].name, Axis("speed along the path [mm/s]", log=True, ticks=SPEEDS),
            Axis("tracking error, RMS [mm]", log=True),
        )  # fmt: skip
        panel.kinds(method_rows, "parts", "speed_mm_s", "rms_mm", styles, hollow=is_lost)
        for bound in group_rows(method_rows, "bound_mm_s"):
            panel.rule("bound aT/16", x=bound)
    last = panels.add(
        "Maximum speed", Axis("parts", ticks=tuple(counts)),
        Axis("speed [mm/s]", log=True, ticks=SPEEDS),
    )  # fmt: skip
    for method, method_rows in groups.items():
        name, colour, *_ = METHODS[method]
        of_count = [r | {"kept": fastest(method_rows, r["parts"]) or None} for r in method_rows]
        last.points(of_count, "parts", "kept", Style(f"{name}, reached", colour, "o", "-"))
        last.points(
            method_rows, "parts", "bound_mm_s", Style(f"{name}, bound aT/16", colour, "", "--")
        )
    is_fastest = all(
        fastest(groups["sinusoids"], n) >= fastest(groups.get("rotations", []), n) for n in counts
    )
    maxima = ", ".join(f"{fastest(rows, n)} with {parts(n)}" for n in counts)
    return Drawn(
        panels,
        f"Maximum speed [mm/s]: {maxima}. The theoretical bound aT/16 is "
        f"{min(column(rows, 'bound_mm_s')):.0f} to {max(column(rows, 'bound_mm_s')):.0f} mm/s.",
        "Method B, because its maximum speed is never below that of Method A."
        if is_fastest
        else "Method B. The last panel shows where Method A is faster.",
    )


def is_lost(row: Row) -> bool:
    """Whether the speed of a row was not reached."""
    return not row["kept"]


def fastest(rows: list[Row], count: int) -> float:
    """Return the maximum speed reached with a number of parts [mm/s]. 0 if no speed was reached."""
    return max((r["speed_mm_s"] for r in rows if r["kept"] and r["parts"] == count), default=0)


CAMERAS = {
    "image_rate": ("Rate", "images a second", 1.0, True),
    "exposure_s": ("Exposure", "exposure [ms]", 1e3, False),
    "latency": ("Latency", "latency [ms]", 1e3, False),
    "stamp_jitter": ("Noise of the stamps", "standard deviation of the stamps [ms]", 1e3, False),
}
"""Title, label, unit, and whether the axis is logarithmic, by varied parameter of a camera."""


RATES = (5, 7.5, 10, 15, 30, 60, 120)
"""Image rates that have a tick at the axis [1/s]."""


def cameras(rows: list[Row]) -> Drawn:
    """Return the chart of the tracking error against the parameters of a free-running camera."""
    panels, borders = Panels(), []
    triggered = next(r for r in rows if r["changed"] == "triggered")
    for changed, (title, label, unit, log) in CAMERAS.items():
        changed_rows = [r | {"x": unit * r["value"]} for r in rows if r["changed"] == changed]
        panel = panels.add(
            title, Axis(label, log, ticks=RATES if log else ()),
            Axis("tracking error, RMS [mm]", log=True),
        )  # fmt: skip
        panel.points(
            changed_rows,
            "x",
            "rms_mm",
            Style("median", PROJECT, "o", "-"),
            hollow=has_failed_runs,
            note=ENDED,
        )
        worst = Style("worst run", FAINT, "o", ":")
        panel.points(changed_rows, "x", "worst_rms_mm", worst, hollow=has_failed_runs, note=ENDED)
        panel.rule("allowed", y=ALLOWED_MM, colour=LIMIT)
        panel.rule("triggered", y=triggered["rms_mm"], colour=SECOND)
        good = [r["x"] for r in changed_rows if r["kept"]]
        ends = f"{min(good):g} to {max(good):g}" if good else "none"
        borders.append(f"{label.replace(' [ms]', '')} {ends}{' ms' * (unit > 1)}")
    default_row = next(r for r in rows if r["changed"] == "image_rate" and r["value"] == 30)
    return Drawn(
        panels,
        f"The median error is {shown(default_row['rms_mm'])} mm with the default camera, and "
        f"{shown(triggered['rms_mm'])} mm with a triggered camera. Sufficient values in the tested "
        f"ranges: {'; '.join(borders)}.",
    )


ON_A_BUS = {
    "latency_ms": ("Latency", "latency of the bus [ms]"),
    "jitter_ms": ("Jitter", "maximum jitter [ms]"),
    "loop_hz": ("Position loop of the drives", "bandwidth [Hz]"),
}
"""Title and label, by varied parameter of drives on a bus."""


def drives(rows: list[Row]) -> Drawn:
    """Return the chart of the tracking error against the parameters of bus and drives."""
    panels, bridges = Panels(), next(r for r in rows if not r["changed"])
    names = group_rows([r for r in rows if r["changed"]], "drive")
    styles = {name: Style(name, c, "o", "-") for name, c in zip(names, COUNT_COLOURS, strict=False)}
    for changed, (title, label) in ON_A_BUS.items():
        panel = panels.add(
            title, Axis(label), Axis("median of the RMS tracking error [mm]", log=True)
        )
        changed_rows = [r for r in rows if r["changed"] == changed]
        panel.kinds(
            changed_rows, "drive", "value", "rms_mm", styles, hollow=has_failed_runs, note=ENDED
        )
        panel.rule("bridges", y=bridges["rms_mm"], colour=LIMIT)
    errors = {
        (r["changed"], r["value"]): shown(r["rms_mm"]) for r in rows if r["drive"] == "interpolated"
    }
    return Drawn(
        panels,
        f"The median error is {shown(bridges['rms_mm'])} mm with H-bridges, and "
        f"{errors['latency_ms', 1]} mm with the default drives that interpolate setpoints. With "
        f"such drives, the error is {errors['latency_ms', 4]} mm if the latency is 4 ms, and "
        f"{errors['jitter_ms', 5]} mm if the jitter is up to 5 ms. If the bandwidth of the drives' "
        f"position loops is 75 Hz, the error is {errors['loop_hz', 75]} mm, and with 300 Hz it is "
        f"{errors['loop_hz', 300]} mm.",
    )


def rigs(rows: list[Row]) -> Drawn:
    """Return the chart of success, time and error on small and weak rigs. The chart also shows the
    predictions of `feasible`."""
    names, panels = tuple(group_rows(rows, "rig"))[::-1], Panels()
    y = Axis("", names=names)
    success = panels.add("Ended well", Axis("runs [%]", limits=(-5, 105)), y)
    time = panels.add("Time of the task", Axis("median [s]", log=True), y)
    error = panels.add(
        "Following a path", Axis("median of the RMS tracking error [mm]", log=True), y
    )
    speed = Axis("speed [% of the requested speed]", limits=(-5, 105))
    pace = panels.add("Following a path", speed, y)
    tasks = group_rows(
        [r | {"scenario": r["scenario"].removesuffix("_desk")} for r in rows], "scenario"
    )
    for colour, marker, (scenario, these) in zip(COUNT_COLOURS, "osD", tasks.items(), strict=False):
        scenario_rows = [
            r | {"share": success_percent(r), "kept": 100 * (r["pace"] or 0)} for r in these
        ]
        style = Style(scenario, colour, marker)
        note = ENDED + "; feasible: {feasible}"
        success.points(scenario_rows, "share", "rig", style, hollow=has_failed_runs, note=note)
        time.points(scenario_rows, "time_s", "rig", style, hollow=has_failed_runs)
        time.points(
            scenario_rows, "feasible_s", "rig", Style(f"{scenario}, predicted", colour, "x")
        )
        if any(column(scenario_rows, "rms_mm")):
            error.points(scenario_rows, "rms_mm", "rig", style, hollow=has_failed_runs)
            pace.points(scenario_rows, "kept", "rig", style, hollow=has_failed_runs)
    failures = "; ".join(
        f"{rig} (" + ", ".join(f"{r['scenario']}: {r['succeeded']} succeeded" for r in these) + ")"
        for rig, these in group_rows(list(filter(has_failed_runs, rows)), "rig").items()
    )
    ends = f"Some runs failed on these rigs: {failures}." if failures else "All runs succeeded."
    right = sum((r["feasible"] == "likely") == (success_percent(r) > 50) for r in rows)
    return Drawn(
        panels,
        f"{ends} The prediction of `feasible` was right in {right} of {len(rows)} cases. The "
        "prediction *likely* is right if more than half of the runs succeed.",
    )


def has_failed_runs(row: Row) -> bool:
    """Whether some runs of a row failed. The row contains the number of successes as text, such as
    "9 of 10"."""
    return success_percent(row) < 100


def success_percent(row: Row) -> float:
    """Return the percentage of a row's runs that succeeded."""
    good, runs = map(int, row["succeeded"].split(" of "))
    return 100 * good / runs
