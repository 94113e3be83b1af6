"""The charts of the closed loop: tracking, what control time buys, and what a rig must be."""

from __future__ import annotations

from collections.abc import Iterable

from harness import shown
from report.axis import Axis
from report.chart import Chart, Row, by, column, parts
from report.panels import FAINT, LIMIT, OURS, PEER, SECOND, Panel, Panels
from report.solver import METHODS
from tasks.free_running import ALLOWED_MM

COUNT_COLOURS = ("#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#8a6d00", "#b02a37")
DASH = {"acceleration": "--", "stroke": ":"}
SPEEDS = (2, 5, 10, 20, 40, 80, 160, 320, 1000)


def tracking(rows: list[Row]) -> Chart:
    """Return tracking error against speed, and the fastest speed by parts, with the bound."""
    counts = sorted(by(rows, "parts"))
    colours = dict(zip(counts, COUNT_COLOURS, strict=False))
    panels = Panels()
    for method, mine in by(rows, "method").items():
        panel = panels.add(
            METHODS[method][1], Axis("speed along the path [mm/s]", log=True, ticks=SPEEDS),
            Axis("tracking error, RMS [mm]", log=True),
        )  # fmt: skip
        for count, these in by(mine, "parts").items():
            panel.points(
                parts(count), column(these, "speed_mm_s"), column(these, "rms_mm"),
                colours[count], "o", "-", hollow=[not r["kept"] for r in these],
                notes=["kept" if r["kept"] else "not kept" for r in these],
            )  # fmt: skip
        for bound in by(mine, "bound_mm_s"):
            panel.rule("bounds aT/16", x=bound)
    last = panels.add(
        "Fastest speed that is kept", Axis("parts", ticks=tuple(counts)),
        Axis("speed [mm/s]", log=True, ticks=SPEEDS),
    )  # fmt: skip
    for method, mine in by(rows, "method").items():
        colour, name = METHODS[method]
        bounds = {r["parts"]: r["bound_mm_s"] for r in mine}
        kept = [fastest(mine, n) or None for n in bounds]
        last.points(f"{name}, kept", list(bounds), kept, colour, "o", "-")
        last.points(f"{name}, bound aT/16", list(bounds), list(bounds.values()), colour, "", "--")
    groups = by(rows, "method")
    leads = all(
        fastest(groups["sinusoids"], n) >= fastest(groups.get("rotations", []), n) for n in counts
    )
    most = ", ".join(f"{fastest(rows, n)} by {parts(n)}" for n in counts)
    return Chart(
        "tracking", "f", "Part speed against tracking error",
        "Parts on circles of 50 mm radius, faster and faster until a run does not keep it "
        "(hollow): it ends badly, errs more than 6 mm or takes too long.",
        f"Fastest speed kept [mm/s]: {most}; bound aT/16 = {min(column(rows, 'bound_mm_s')):.0f} "
        f"to {max(column(rows, 'bound_mm_s')):.0f}.",
        "Method B: never slower than Method A, where both were tried." if leads else
        "Method B; where Method A keeps a higher speed the last panel shows it.",
        panels,
    )  # fmt: skip


def fastest(rows: list[Row], count: int) -> float:
    """Return the fastest speed kept with so many parts [mm/s], 0 where there is none."""
    return max((r["speed_mm_s"] for r in rows if r["kept"] and r["parts"] == count), default=0)


def control(rows: list[Row]) -> Chart:
    """Return what the closed loop reaches against the time that the controller takes."""
    panels = Panels()
    for scenario, these in by(rows, "scenario").items():
        tracks = these[0]["rms_mm"] is not None
        value = "rms_mm" if tracks else "time_s"
        panel = panels.add(
            scenario, Axis("median time of the controller for one cycle [ms]", log=True),
            Axis("tracking error, RMS [mm]" if tracks else "time of the task [s]", log=tracks),
            "less less",
        )  # fmt: skip
        for method, mine in by(these, "method").items():
            colour, name = METHODS[method]
            panel.points(
                name, column(mine, "solve_ms"), column(mine, value), colour,
                hollow=[r["good"] < r["runs"] for r in mine],
                notes=[
                    f"restarts {r['restarts']}, iterations {r['iterations']}; ended well "
                    f"{r['good']} of {r['runs']}; 99 % {shown(r['solve_p99_ms'])} ms"
                    for r in mine
                ],
            )  # fmt: skip
        default = next(r for r in these if r["default"])
        panel.mark(default["solve_ms"], default[value])
    told = "; ".join(
        f"{r['scenario']}: {shown(r['rms_mm'])} mm in {r['solve_ms']:.1f} ms"
        if r["rms_mm"] is not None
        else f"{r['scenario']}: {r['time_s']:.0f} s at {r['solve_ms']:.1f} ms"
        for r in rows
        if r["default"] and r["method"] == "sinusoids"
    )
    return Chart(
        "control", "e", "Closed loop: what more control time buys",
        "The whole loop without ROS, camera noise and uneven friction on; each point is a setting "
        "of the solver (restarts, iterations), several seeds.",
        f"Per cycle, our default: {told}.",
        "Method B, at most 24 iterations and 40 restarts: paths gain nothing from more, sorting "
        "a little.",
        panels,
    )  # fmt: skip


CAMERAS = {
    "image_rate": ("Rate", "images a second", 1.0, True),
    "exposure_s": ("Exposure", "exposure [ms]", 1e3, False),
    "latency": ("Latency", "latency [ms]", 1e3, False),
    "stamp_jitter": ("Scatter of stamps", "standard deviation of the stamps [ms]", 1e3, False),
}
"""What is changed of a camera -> title, label, unit, and whether the axis is logarithmic."""


RATES = (5, 7.5, 10, 15, 30, 60, 120)
"""Of images [1/s], that are written at the axis."""


def cameras(rows: list[Row]) -> Chart:
    """Return the tracking error against what a camera that runs free is like."""
    panels, borders = Panels(), []
    triggered = next(r for r in rows if r["changed"] == "triggered")
    for changed, (title, label, unit, log) in CAMERAS.items():
        mine = [r for r in rows if r["changed"] == changed]
        x = [unit * r["value"] for r in mine]
        panel = panels.add(
            title, Axis(label, log, ticks=RATES if log else ()),
            Axis("tracking error, RMS [mm]", log=True),
        )  # fmt: skip
        well = [all_well(r) for r in mine]
        for name, key, colour, line in (
            ("median", "rms_mm", OURS, "-"), ("worst run", "worst_rms_mm", FAINT, ":"),
        ):  # fmt: skip
            panel.points(
                name, x, column(mine, key), colour, "o", line, hollow=[not one for one in well],
                notes=[f"{r['succeeded']} ended well" for r in mine],
            )  # fmt: skip
        panel.rule("allowed", y=ALLOWED_MM, colour=LIMIT)
        panel.rule("triggered", y=triggered["rms_mm"], colour=SECOND)
        good = [value for value, r in zip(x, mine, strict=True) if r["kept"]]
        ends = f"{min(good):g} to {max(good):g}" if good else "none"
        borders.append(f"{label.replace(' [ms]', '')} {ends}{' ms' * (unit > 1)}")
    usual = next(r for r in rows if r["changed"] == "image_rate" and r["value"] == 30)
    return Chart(
        "cameras", "", "Cameras that run free: which are good enough",
        "Two parts along rectangles at 40 mm/s, uneven friction, 10 ms of exposure, 30 images a "
        "second, 40 ms late, stamps that scatter by 5 ms, one of these changed at a time; the "
        f"planner knows none of them. Good: below the red line, {ALLOWED_MM:g} mm (median of the "
        "runs), if all end well.",
        f"{shown(usual['rms_mm'])} mm at 30 images a second, {shown(triggered['rms_mm'])} mm with "
        f"a triggered camera. Good for it, of what was tried: {'; '.join(borders)}.",
        "", panels,
    )  # fmt: skip


ON_A_BUS = {
    "latency_ms": ("Latency", "latency of the bus [ms]"),
    "jitter_ms": ("Jitter", "jitter, up to [ms]"),
    "loop_hz": ("The drives' loop", "bandwidth [Hz]"),
}
"""What is changed of drives on a bus -> title and label."""


def drives(rows: list[Row]) -> Chart:
    """Return the tracking error against what bus and drives are like."""
    panels = Panels()
    bridges = next(r for r in rows if not r["changed"])
    for changed, (title, label) in ON_A_BUS.items():
        panel = panels.add(title, Axis(label), Axis("tracking error, RMS, median [mm]", log=True))
        mine = by([r for r in rows if r["changed"] == changed], "drive")
        for colour, (name, these) in zip(COUNT_COLOURS, mine.items(), strict=False):
            panel.points(
                name, column(these, "value"), column(these, "rms_mm"), colour, "o", "-",
                hollow=[not all_well(r) for r in these],
                notes=[f"{r['succeeded']} ended well" for r in these],
            )  # fmt: skip
        panel.rule("bridges", y=bridges["rms_mm"], colour=LIMIT)
    told = {
        (r["changed"], r["value"]): shown(r["rms_mm"]) for r in rows if r["drive"] == "interpolated"
    }
    words = {
        ("latency_ms", 1): "drives that interpolate", ("latency_ms", 4): "with 4 ms of latency",
        ("jitter_ms", 5): "with up to 5 ms of jitter", ("loop_hz", 75): "with loops of 75 Hz",
        ("loop_hz", 300): "with loops of 300 Hz",
    }  # fmt: skip
    found = ", ".join(f"{word} {told[case]} mm" for case, word in words.items())
    return Chart(
        "drives", "", "Drives on a bus: latency, jitter and their own loop",
        "Two parts along rectangles at 40 mm/s, uneven friction, setpoints each 2 ms, 1 ms late, "
        "no jitter, loops of 150 Hz, one of these changed at a time; the red line is of bridges, "
        "which follow exactly. Hollow: not all runs ended well.",
        f"Bridges {shown(bridges['rms_mm'])} mm; {found}.",
        "", panels,
    )  # fmt: skip


def rigs(rows: list[Row]) -> Chart:
    """Return success, time and error on small and weak rigs, and what `feasible` said of them."""
    names, panels = tuple(by(rows, "rig"))[::-1], Panels()
    y = Axis("", names=names)
    share = panels.add("Ended well", Axis("runs [%]", limits=(-5, 105)), y)
    time = panels.add("Time of the task", Axis("median [s]", log=True), y)
    error = panels.add("Following a path", Axis("tracking error, RMS, median [mm]", log=True), y)
    pace = panels.add("Following a path", Axis("of the speed asked for [%]", limits=(-5, 105)), y)
    tasks = by([r | {"scenario": r["scenario"].removesuffix("_desk")} for r in rows], "scenario")
    for colour, marker, (scenario, mine) in zip(COUNT_COLOURS, "osD", tasks.items(), strict=False):
        rig, hollow = column(mine, "rig"), [not all_well(r) for r in mine]
        notes = [f"{r['succeeded']} ended well; feasible: {r['feasible']}" for r in mine]
        share.points(
            scenario, [percent(r) for r in mine], rig, colour, marker, hollow=hollow, notes=notes
        )
        time.points(scenario, column(mine, "time_s"), rig, colour, marker, hollow=hollow)
        time.points(f"{scenario}, by feasible", column(mine, "feasible_s"), rig, colour, "x")
        if any(column(mine, "rms_mm")):
            error.points(scenario, column(mine, "rms_mm"), rig, colour, marker, hollow=hollow)
            kept = [100 * r["pace"] for r in mine]
            pace.points(scenario, kept, rig, colour, marker, hollow=hollow)
    told = "; ".join(
        f"{rig}: " + ", ".join(f"{r['scenario']} {r['succeeded']}" for r in these)
        for rig, these in by([r for r in rows if not all_well(r)], "rig").items()
    )
    right = sum((r["feasible"] == "likely") == (percent(r) > 50) for r in rows)
    return Chart(
        "rigs", "", "Sizing a rig: what small and weak ones reach",
        "The default rig but for what a name says, and two others. Uneven friction; follow_2 at "
        "40 mm/s, on the desk at 10. Crosses: the time that `feasible` had estimated.",
        f"Not all runs ended well on {told or 'none'}. feasible was right (likely: more than half "
        f"of the runs end well) in {right} of {len(rows)} cases.",
        "", panels,
    )  # fmt: skip


def bound(rows: list[Row]) -> Chart:
    """Return how fast parts can be moved: bounds, what a search finds, what the loop reaches."""
    panels = Panels()
    one = by(rows, "parts")[1]
    period = [1e3 * r["period_s"] for r in one]
    first = panels.add("One part", Axis("cycle [ms]"), Axis("mean speed [mm/s]", log=True))
    for name, key in (("acceleration", "accel_mm_s"), ("stroke", "stroke_mm_s")):
        first.points(f"bound of {name}", period, column(one, key), LIMIT, "", DASH[name])
    kinds = {"free_mm_s": ("found, without rest", SECOND), "rest_mm_s": ("found, with rest", OURS)}
    for key, (name, colour) in kinds.items():
        first.points(name, period, column(one, key), colour, "o", "-")
    counts = by(rows, "parts")
    second = panels.add(
        "Best cycle, and the closed loop", Axis("parts", log=True, ticks=tuple(counts)),
        Axis("mean speed [mm/s]", log=True),
    )  # fmt: skip
    most = {key: [max(column(mine, key)) for mine in counts.values()] for key in kinds}
    for key, (name, colour) in kinds.items():
        second.points(name, list(counts), most[key], colour, "o", "-")
    own = [next(r for r in mine if r["solver"]) for mine in counts.values()]
    second.points(
        "found, the solver's cycle", list(counts), column(own, "rest_mm_s"), FAINT, "s", ":"
    )
    loop = column(own, "loop_mm_s")
    second.points("closed loop", list(counts), loop, PEER, "D", "--")
    gain = ", ".join(
        f"{a / b:.1f} by {parts(n)}"
        for n, a, b in zip(counts, most["free_mm_s"], most["rest_mm_s"], strict=True)
    )
    return Chart(
        "bound", "", "How fast parts can be moved",
        "Mean speed of scattered parts, half of them to the left, half to the right, anywhere "
        "across. Found: the best steady cycle of a global search with the rig's limits, with the "
        "plate at rest between cycles and without; not exhaustive. Bounds: of one part on a plate "
        "that shakes along a line (proof: docs/model.md). Closed loop: until half of all ways are "
        "done.",
        f"Best cycle found with rest [mm/s]: {listed(counts, most['rest_mm_s'])}; closed loop: "
        f"{listed(counts, loop)}. Without rest cycles are found that are faster by a factor of "
        f"{gain}.",
        "", panels,
    )  # fmt: skip


def listed(counts: Iterable[int], values: list[float]) -> str:
    """Return values by numbers of parts in a line."""
    return ", ".join(f"{v:.0f} by {parts(n)}" for n, v in zip(counts, values, strict=True))


def crowds(rows: list[Row]) -> Chart:
    """Return how long a sort takes, and how many parts it loses, against their number."""
    panels = Panels()
    panel = panels.add(
        "Sorting", Axis("parts", log=True, ticks=tuple(by(rows, "parts"))),
        Axis("time of the task [s]", log=True),
    )  # fmt: skip
    sized(panel, "sort", "parts", "time_s", rows, COUNT_COLOURS[0])
    dropped = sum(r["dropped"] for r in rows)
    return Chart(
        "crowds", "", "Sizing a rig: how many parts it sorts",
        "Half of them to the left, half to the right, on the default rig. Medians over the seeds, "
        "in a clean world.",
        f"{' / '.join(shown(n) for n in by(rows, 'parts'))} parts are sorted in "
        f"{medians(rows, 'time_s')} s, "
        f"{dropped or 'none'} dropped.",
        "", panels,
    )  # fmt: skip


def sized(panel: Panel, name: str, x: str, y: str, rows: list[Row], colour: str) -> None:
    """Add a line of one task; hollow where not all runs ended well."""
    panel.points(
        name, column(rows, x), column(rows, y), colour, "o", "-",
        hollow=[not all_well(r) for r in rows],
        notes=[f"{r['succeeded']} ended well, {r['dropped']} parts dropped" for r in rows],
    )  # fmt: skip


def all_well(row: Row) -> bool:
    """Whether all runs of a row ended well: it says how many of how many did."""
    return len(set(row["succeeded"].split(" of "))) == 1


def percent(row: Row) -> float:
    """How many of a row's runs ended well [%]."""
    good, runs = map(int, row["succeeded"].split(" of "))
    return 100 * good / runs


def medians(rows: list[Row], key: str) -> str:
    """Return a column's values in a line, with how many runs they are of where some failed."""
    return " / ".join(shown(r[key]) + ("" if all_well(r) else f" ({r['succeeded']})") for r in rows)
