"""The charts of the solvers: force map, both methods, their options and limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import shown
from report.chart import (
    OURS,
    PEER,
    SECOND,
    Axis,
    Chart,
    Data,
    Mark,
    Panel,
    Points,
    Row,
    Rule,
    columns,
    table,
)

LEAST_ERROR = 1e-11
"""Errors below this [mu m g] are rounding, and drawn here."""

METHODS = {"sinusoids": (OURS, "B: sinusoids"), "rotations": (SECOND, "A: rotations")}
"""Colour and name of both methods."""


def solver(data: Data) -> Chart:
    """Return error against time of single requests on the averaged map, with peers."""
    rows = data["solver"]["samples"]
    looks = (
        ("RotationSolver", SECOND, "s", "A: RotationSolver"),
        ("scipy lm", PEER, "x", "scipy least_squares (lm)"),
        ("SinusoidSolver", OURS, "o", "B: SinusoidSolver"),
    )
    panels = []
    for count in sorted({r["parts"] for r in rows}):
        points, marks = [], []
        for method, colour, marker, name in looks:
            mine = [r for r in rows if r["parts"] == count and r["method"] == method]
            points.append(
                Points(
                    name, [r["ms"] for r in mine], [max(r["error"], LEAST_ERROR) for r in mine],
                    colour, marker, in_front=False,
                )
            )  # fmt: skip
            typical = float(np.median(points[-1].x)), float(np.median(points[-1].y))
            points.append(Points(f"{name}, median", typical[:1], typical[1:], colour, "D"))
            marks += [Mark(*typical)] if method == "SinusoidSolver" else []
        panels.append(
            Panel(
                parts(count), Axis("time of one cold solve [ms]", log=True),
                Axis("largest error of a force [µmg]", log=True), tuple(points),
                (Rule("wanted", y=1e-4),), tuple(marks), "less less",
            )
        )  # fmt: skip
    found = table(data, "solver", "nonlinear")

    def one(count: int, method: str) -> Row:
        return next(r for r in found if r["parts"] == count and r["method"] == method)

    def told(row: Row) -> str:
        return f"{row['success_percent']:.0f} % in {shown(row['median_ms'])} ms"

    lead = "; ".join(
        f"{parts(n)} {told(one(n, 'SinusoidSolver'))} (scipy {told(one(n, 'scipy lm'))})"
        for n in sorted({r["parts"] for r in rows})
    )
    return Chart(
        "solver", "b", "Solvers on the averaged map: error against time",
        "Random requests up to 0.2 µmg from a cold start, each a point, and their medians; judged "
        f"on samples that no solver has used. Errors below {LEAST_ERROR:g} are drawn there. Points "
        "above the line were not met: with few harmonics some requests cannot be.",
        f"Within 1e-4 µmg, Method B: {lead}.",
        "Method B, sinusoids: the least time for every number of parts, and ten times as exact as "
        "Method A, which stops at 1e-3 µmg.",
        ("solver",), tuple(panels), rows,
        {"parts": "parts", "ms": "time [ms]", "error": "error [µmg]"},
    )  # fmt: skip


def options(data: Data) -> Chart:
    """Return what the simulator misses against the time of a solve, for all options and scipy."""
    rows = table(data, "options", "options")
    looks = (
        ("B", "restarts", OURS, "o", "-", "B: sinusoids, more and more restarts"),
        ("A", "restarts", SECOND, "s", "-", "A: rotations, more and more restarts"),
        ("B", "paper", OURS, "v", "", "B on the paper's map"),
        ("A", "paper", SECOND, "^", "", "A on the paper's map"),
        ("scipy, our derivatives", "", PEER, "D", "-", "scipy, our derivatives"),
        ("scipy, own differences", "", PEER, "x", "--", "scipy, own differences"),
    )
    panels = []
    for count in sorted({r["parts"] for r in rows}):
        points, marks = [], []
        for method, option, colour, marker, line, name in looks:
            mine = [
                r for r in rows
                if (r["parts"], r["method"]) == (count, method) and option in r["option"]
            ]  # fmt: skip
            points.append(
                Points(
                    name, [r["median_ms"] for r in mine], [r["missed_percent"] for r in mine],
                    colour, marker, line, notes=tuple(r["option"] for r in mine),
                )
            )  # fmt: skip
            marks += [
                Mark(r["median_ms"], r["missed_percent"])
                for r in mine
                if r["default"] and method == "B"
            ]
        panels.append(
            Panel(
                parts(count), Axis("median time of a cold solve [ms]", log=True),
                Axis("drift missed in the simulator, RMS [%]", log=True), tuple(points), (),
                tuple(marks), "less less",
            )
        )  # fmt: skip

    def told(method: str, option: str) -> str:
        mine = [r for r in rows if (r["method"], r["option"]) == (method, option)]
        return " / ".join(f"{r['missed_percent']:.0f} % in {r['median_ms']:.0f} ms" for r in mine)

    counts = " / ".join(str(n) for n in dict.fromkeys(r["parts"] for r in rows))
    return Chart(
        "options", "b", "Solvers on the stick-slip cycle: error against time",
        "What the loop solves, but from a cold start, with no slack and all parts at once: drifts "
        "up to 5 mm/s along each axis, judged by the simulator. Lines join the same method with "
        "more and more restarts. On the paper's averaged map a part's swing within a cycle is left "
        "out, so it misses more than is asked. Down and to the left is better.",
        f"With {counts} parts Method B misses {told('B', '3 restarts')}, Method A "
        f"{told('A', '1 restarts')}, scipy by its own differences "
        f"{told('scipy, own differences', '3 restarts')}.",
        "Method B with 3 restarts: near the front at every number of parts, and a fifth of a cycle "
        "at ten; in the loop it starts from the last answer, and what more effort buys there is "
        "shown in (e).",
        ("options",), tuple(panels), rows, columns(data, "options", "options"),
    )  # fmt: skip


def steering(data: Data) -> Chart:
    """Return time and missed displacement against the number of parts."""
    rows = table(data, "steering", "steering")
    counts = tuple(sorted({r["parts"] for r in rows}))
    kinds = (("warm_ms", "cold_ms", "warm start", "cold start", "median time of a solve [ms]"),
             ("missed_percent", "predicted_percent", "in truth", "as predicted",
              "displacement missed, RMS [% of asked]"))  # fmt: skip
    panels = []
    for full, empty, name, other, label in kinds:
        points = []
        for method, (colour, told) in METHODS.items():
            mine = [r for r in rows if r["method"] == method]
            x = [r["parts"] for r in mine]
            points += [
                Points(f"{told}, {name}", x, [r[full] for r in mine], colour, "o", "-"),
                Points(f"{told}, {other}", x, [r[empty] for r in mine], colour, "s", ":"),
            ]
        time = label.endswith("[ms]")
        panels.append(
            Panel(
                "Time" if time else "What is missed", Axis("parts", ticks=counts),
                Axis(label, log=time), tuple(points),
                () if time else (Rule("good enough", y=15),),
            )
        )  # fmt: skip
    missed = {(r["method"], r["parts"]): r["missed_percent"] for r in rows}
    less = ", ".join(str(n) for n in counts if missed["sinusoids", n] < missed["rotations", n])
    most = counts[-1]
    last = {r["method"]: r for r in rows if r["parts"] == most}
    return Chart(
        "steering", "b", "Steering: time and misses by the number of parts",
        "Random steady drifts up to 10 mm/s along each axis, all parts at once and with no slack, "
        "met on the stick-slip cycle map; the truth is plate_sim's. Real tasks ask for less.",
        f"{most} parts: {last['sinusoids']['warm_ms']:.0f} ms by Method B, "
        f"{last['sinusoids']['missed_percent']:.0f} % missed; "
        f"{last['rotations']['warm_ms']:.0f} ms by Method A, "
        f"{last['rotations']['missed_percent']:.0f} %.",
        f"Method B: it misses less with {less} parts.",
        ("steering",), tuple(panels), rows,
        columns(data, "steering", "steering"),
    )  # fmt: skip


def parts(count: Any) -> str:
    """Return a number of parts in words."""
    return f"{count} part{'s' * (count > 1)}"
