"""The charts of the closed loop: tracking, and what control time buys."""

from __future__ import annotations

from harness import shown
from report.chart import Axis, Chart, Data, Mark, Panel, Points, Row, Rule, columns, table
from report.solver import METHODS, parts

COUNT_COLOURS = ("#0b5f8a", "#c4560b", "#2e7d4a", "#7d4f9e", "#8a6d00", "#b02a37")


def tracking(data: Data) -> Chart:
    """Return tracking error against speed, and the fastest speed by parts, with the bound."""
    rows = table(data, "tracking", "tracking")
    counts = sorted({r["parts"] for r in rows})
    ticks = (2, 5, 10, 20, 40, 80, 160, 320, 1000)
    panels = []
    for method, (_, name) in METHODS.items():
        mine = [r for r in rows if r["method"] == method]
        if not mine:
            continue
        points = []
        for count, colour in zip(counts, COUNT_COLOURS, strict=False):
            these = [r for r in mine if r["parts"] == count]
            points.append(
                Points(
                    parts(count), [r["speed_mm_s"] for r in these], [r["rms_mm"] for r in these],
                    colour, "o", "-", hollow=tuple(not r["kept"] for r in these),
                    notes=tuple("kept" if r["kept"] else "not kept" for r in these),
                )
            )  # fmt: skip
        bounds = sorted({r["bound_mm_s"] for r in mine})
        panels.append(
            Panel(
                name, Axis("speed along the path [mm/s]", log=True, ticks=ticks),
                Axis("distance from the path's point, RMS [mm]", log=True), tuple(points),
                tuple(Rule(f"aT/16 = {b:.0f}", x=b) for b in bounds),
            )
        )  # fmt: skip
    panels.append(frontier_panel(rows, counts))
    most = {
        n: max((r["speed_mm_s"] for r in rows if r["kept"] and r["parts"] == n), default=0)
        for n in counts
    }
    return Chart(
        "tracking", "f", "Part speed against tracking error",
        "Parts on circles of 50 mm radius, faster and faster until a run does not keep it "
        "(hollow): it ends badly, errs more than 6 mm or takes too long. No part can be faster on "
        "average than aT/16, a the plate's acceleration and T its period.",
        "Fastest speed kept [mm/s]: " + ", ".join(f"{v} by {parts(n)}" for n, v in most.items())
        + f"; bound aT/16 = {min(r['bound_mm_s'] for r in rows):.0f} to "
        f"{max(r['bound_mm_s'] for r in rows):.0f}.",
        "Method B: the fastest at every number of parts." if leads(rows, counts) else
        "Method B; where Method A keeps a higher speed the last panel shows it.",
        ("tracking",), tuple(panels), rows, columns(data, "tracking", "tracking"),
    )  # fmt: skip


def leads(rows: list[Row], counts: list[int]) -> bool:
    """Whether Method B keeps at least the speed of Method A at every number of parts."""
    return all(fastest(rows, "sinusoids", n) >= fastest(rows, "rotations", n) for n in counts)


def fastest(rows: list[Row], method: str, count: int) -> float:
    """Return the fastest speed kept [mm/s], 0 where there is none."""
    mine = [r for r in rows if r["method"] == method and r["parts"] == count and r["kept"]]
    return max((r["speed_mm_s"] for r in mine), default=0)


def frontier_panel(rows: list[Row], counts: list[int]) -> Panel:
    """Return the fastest speed kept and the bound by the number of parts."""
    points = []
    for method, (colour, name) in METHODS.items():
        mine = {r["parts"]: r["bound_mm_s"] for r in rows if r["method"] == method}
        there = [n for n in counts if n in mine]
        if not there:
            continue
        kept = [fastest(rows, method, n) or None for n in there]
        points += [
            Points(f"{name}, kept", there, kept, colour, "o", "-"),
            Points(f"{name}, bound aT/16", there, [mine[n] for n in there], colour, "", "--"),
        ]
    return Panel(
        "Fastest speed that is kept", Axis("parts", ticks=tuple(counts)),
        Axis("speed [mm/s]", log=True, ticks=(2, 5, 10, 20, 40, 80, 160, 320, 1000)),
        tuple(points),
    )  # fmt: skip


def control(data: Data) -> Chart:
    """Return what the closed loop reaches against the time that the controller takes."""
    rows = table(data, "control", "control")
    panels = []
    for scenario in dict.fromkeys(r["scenario"] for r in rows):
        these = [r for r in rows if r["scenario"] == scenario]
        tracks = these[0]["rms_mm"] is not None
        value = "rms_mm" if tracks else "time_s"
        points = []
        for method, (colour, name) in METHODS.items():
            mine = [r for r in these if r["method"] == method]
            points.append(
                Points(
                    name, [r["solve_ms"] for r in mine], [r[value] for r in mine], colour, "o", "",
                    hollow=tuple(r["good"] < r["runs"] for r in mine),
                    notes=tuple(
                        f"restarts {r['restarts']}, iterations {r['iterations']}; ended well "
                        f"{r['good']} of {r['runs']}; 99 % {shown(r['solve_p99_ms'])} ms"
                        for r in mine
                    ),
                )
            )  # fmt: skip
        mark = [r for r in these if r["default"]]
        panels.append(
            Panel(
                scenario, Axis("median time of the controller for one cycle [ms]", log=True),
                Axis("tracking error, RMS [mm]" if tracks else "time of the task [s]", log=tracks),
                tuple(points), (), tuple(Mark(r["solve_ms"], r[value]) for r in mark[:1]),
                "less less",
            )
        )  # fmt: skip
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
        "of the solver (restarts, iterations), several seeds. Hollow: not all runs ended well. "
        "Down and to the left is better.",
        f"Per cycle, our default: {told}.",
        "Method B, at most 24 iterations and 3 restarts: in the loop a cycle starts next to its "
        "solution and seldom needs them; fewer iterations lose accuracy.",
        ("control",), tuple(panels), rows, columns(data, "control", "control"),
    )  # fmt: skip
