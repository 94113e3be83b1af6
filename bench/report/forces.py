"""Charts of the averaged forces, and of learning the plate's response."""

from __future__ import annotations

from report.axis import Axis
from report.chart import Drawn, column
from report.panels import BASELINE, LIMIT, PROJECT, SECOND, THIRD, Panels, Row, Style, group_rows

MIN_ERROR = 1e-11
"""Minimum drawn error [mu mg]. Smaller errors are rounding errors, and are drawn at this value."""

MAX_P99 = 1e-6
"""Maximum allowed error of averaged forces at the 99th percentile [mu mg]."""


COLOURS = (BASELINE, SECOND, THIRD, "#8a6d00", LIMIT)
"""Colours of the baselines."""


def force_map(rows: list[Row]) -> Drawn:
    """Return the chart of time and error of every method for the averaged force."""
    panels, groups = Panels(), group_rows(rows, "case")
    for case, title, name in (
        ("many", "Many motions in one call, N = 2", "forces"),
        ("one", "One cycle, 1 part", "average_force"),
    ):
        case_rows = groups[case]
        limits = (0.1, 1e4) if case == "one" else (0, 1.6 * max(column(case_rows, "us")))
        panel = panels.add(
            title, Axis("time of one part's force [µs]", log=case == "one", limits=limits),
            Axis("error, 99th percentile [mu mg]", log=True, minimum=MIN_ERROR), "less less",
        )  # fmt: skip
        best = next(r for r in case_rows if r["method"] == name)
        others = [r for r in case_rows if r is not best]
        for r, colour, marker in zip([best, *others], (PROJECT, *COLOURS), "osD^vx", strict=False):
            style = Style(r["method"], colour, marker)
            panel.points([r], "us", "p99", style, note="median error {median:.3g}")
        panel.rule("required", y=MAX_P99)
        panel.mark(best["us"], best["p99"])
    best, quad = (
        next(r for r in groups["one"] if r["method"].startswith(name))
        for name in ("average_force", "quad")
    )
    return Drawn(
        panels,
        f"The function `average_force` takes {best['us']:.0f} µs. The 99th percentile of its error "
        f"is {best['p99']:.0e} mu mg. The function is {quad['us'] / best['us']:.0f} times as fast "
        "as scipy's quad. Sums over equal time steps are faster. Their error is more "
        f"than 100 times {MAX_P99:g} mu mg if the plate is almost at rest below the part.",
        "`average_force` for the evaluation of motions, and `forces` during the search. They are "
        f"the fastest functions with a 99th percentile below {MAX_P99:g} mu mg.",
    )


def learning(rows: list[Row]) -> Drawn:
    """Return the chart of the error of realised harmonics against the number of experiments."""
    panels, ticks = Panels(), tuple(column(rows, "iteration"))
    panel = panels.add(
        "Error of realised harmonics", Axis("experiments", ticks=ticks), Axis("error [%]", log=True)
    )
    panel.points(rows, "iteration", "most", Style("maximum over the cycles", SECOND, "s", "--"))
    panel.points(rows, "iteration", "median", Style("median", PROJECT, "o", "-"))
    panel.rule("2 %", y=2, colour=LIMIT)
    first, last = rows[0], rows[-1]
    return Drawn(
        panels,
        f"The largest error of a realised cycle falls from {first['most']:.0f} % to "
        f"{last['most']:.2f} % in {last['iteration']} experiments.",
    )
