"""Charts of the solvers: both methods, their options and limits."""

from __future__ import annotations

import numpy as np

from harness import shown
from report.axis import Axis
from report.chart import Data, Drawn, Sheet, column, parts
from report.panels import BASELINE, PROJECT, SECOND, Panels, Row, Style, group_rows

MIN_ERROR = 1e-11
"""Minimum drawn error [mu mg]. Smaller errors are rounding errors, and are drawn at this value."""

MAX_ERROR = 1e-4
"""Maximum error of a force with which a request counts as met [mu mg]."""

METHODS = {"sinusoids": Style("B: sinusoids", PROJECT), "rotations": Style("A: rotations", SECOND)}
"""Appearance of both methods."""


def solver_rows(data: Data) -> Sheet:
    """Return the rows of the chart `solver`, for single requests."""
    heads = {"parts": "parts", "method": "method", "ms": "time [ms]", "error": "error [mu mg]"}
    return Sheet.of(data["solver"]["samples"], heads)


def solver(rows: list[Row]) -> Drawn:
    """Return the chart of error against solution time for single requests of averaged forces, with
    baselines."""
    styles = {
        "RotationSolver": Style("A: RotationSolver", SECOND, "s"),
        "scipy lm": Style("scipy least_squares (lm)", BASELINE, "x"),
        "SinusoidSolver": Style("B: SinusoidSolver", PROJECT, "o"),
    }
    groups, panels = group_rows(rows, "parts", "method"), Panels()
    counts = sorted(group_rows(rows, "parts"))
    for count in counts:
        panel = panels.add(
            parts(count), Axis("time of one cold solve [ms]", log=True),
            Axis("maximum force error [mu mg]", log=True, minimum=MIN_ERROR), "less less",
        )  # fmt: skip
        for method, style in styles.items():
            group = groups[count, method]
            panel.points(group, "ms", "error", style, in_front=False)
            typical = {key: float(np.median(column(group, key))) for key in ("ms", "error")}
            median = Style(f"{style.name}, median", style.colour, "D")
            panel.points([typical], "ms", "error", median)
        panel.mark(typical["ms"], typical["error"])
        panel.rule("required", y=MAX_ERROR)

    def solved_text(count: int, method: str) -> str:
        group = groups[count, method]
        met = 100 * np.mean([error <= MAX_ERROR for error in column(group, "error")])
        return f"{met:.0f} % in {shown(float(np.median(column(group, 'ms'))))} ms"

    text = " ".join(
        f"Of the requests with {parts(n)}, Method B solves {solved_text(n, 'SinusoidSolver')}, and "
        f"scipy {solved_text(n, 'scipy lm')}."
        for n in sorted({counts[0], counts[-1]})
    )
    met = f"A solved request has an error of at most {MAX_ERROR:g} mu mg."
    return Drawn(panels, f"{text} {met} Times are medians.")


def options(rows: list[Row]) -> Drawn:
    """Return the chart of the simulated error against the solution time, for all options of both
    methods and for scipy."""
    styles = {
        ("B", "restarts"): Style("B: sinusoids, increasing restarts", PROJECT, "o", "-"),
        ("A", "restarts"): Style("A: rotations, increasing restarts", SECOND, "s", "-"),
        ("B", "paper"): Style("B on the paper's map", PROJECT, "v"),
        ("A", "paper"): Style("A on the paper's map", SECOND, "^"),
        ("scipy, our derivatives", ""): Style("scipy, exact derivatives", BASELINE, "D", "-"),
        ("scipy, own differences", ""): Style("scipy, finite differences", BASELINE, "x", "--"),
    }
    panels = Panels()
    for count, these in group_rows(rows, "parts").items():
        panel = panels.add(
            parts(count), Axis("median time of a cold solve [ms]", log=True),
            Axis("drift error in the simulator, RMS [%]", log=True), "less less",
        )  # fmt: skip
        for (method, option), style in styles.items():
            option_rows = [r for r in these if r["method"] == method and option in r["option"]]
            panel.points(option_rows, "median_ms", "missed_percent", style, note="{option}")
        for r in these:
            if r["default"] and r["method"] == "B":
                panel.mark(r["median_ms"], r["missed_percent"])

    def error_text(count: int, method: str, option: str) -> str:
        key = (count, method, option)
        option_rows = [r for r in rows if (r["parts"], r["method"], r["option"]) == key]
        return " / ".join(
            f"{r['missed_percent']:.0f} % in {r['median_ms']:.0f} ms" for r in option_rows
        )

    counts = sorted(group_rows(rows, "parts"))
    text = " ".join(
        f"With {parts(n)}, Method B has an error of {error_text(n, 'B', '40 restarts')}, Method A "
        f"{error_text(n, 'A', '1 restarts')}, and scipy with finite differences "
        f"{error_text(n, 'scipy, own differences', '3 restarts')}."
        for n in sorted({counts[0], counts[-1]})
    )
    return Drawn(panels, text)
