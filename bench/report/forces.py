"""Charts of the solvers' basis: force map, guaranteed forces, inversion, learning."""

from __future__ import annotations

from harness import shown
from report.axis import Axis
from report.chart import Drawn, column
from report.panels import LIMIT, OURS, PEER, SECOND, THIRD, Look, Panels, Row, by

MIN_ERROR = 1e-11
"""Minimum drawn error [mu mg]. Smaller errors are rounding errors, and are drawn at this value."""

MAX_P99 = 1e-6
"""Required error of the force map at the 99th percentile [mu mg]."""


COLOURS = (PEER, SECOND, THIRD, "#8a6d00", LIMIT)
"""Colours of the baselines."""


def force_map(rows: list[Row]) -> Drawn:
    """Return the chart of time and error of every method for the averaged force."""
    panels, groups = Panels(), by(rows, "case")
    for case, title, name in (
        ("many", "Many motions in one call, N = 2", "forces"),
        ("one", "One finished cycle, 1 part", "average_force"),
    ):
        mine = groups[case]
        limits = (0.1, 1e4) if case == "one" else (0, 1.6 * max(column(mine, "us")))
        panel = panels.add(
            title, Axis("time of one part's force [µs]", log=case == "one", limits=limits),
            Axis("error, worst 1 % of cases [mu mg]", log=True, least=MIN_ERROR), "less less",
        )  # fmt: skip
        best = next(r for r in mine if r["method"] == name)
        others = [r for r in mine if r is not best]
        for r, colour, marker in zip([best, *others], (OURS, *COLOURS), "osD^vx", strict=False):
            look = Look(r["method"], colour, marker)
            panel.points([r], "us", "p99", look, note="median error {median:.3g}")
        panel.rule("wanted", y=MAX_P99)
        panel.mark(best["us"], best["p99"])
    best, quad = (
        next(r for r in groups["one"] if r["method"].startswith(name))
        for name in ("average_force", "quad")
    )
    return Drawn(
        panels,
        f"The 99th percentile of the error is {best['p99']:.0e} mu mg in {best['us']:.0f} µs, "
        f"{quad['us'] / best['us']:.0f} times as fast as scipy's quad. Equal steps are faster, "
        f"but their error exceeds {MAX_P99:g} a hundredfold if the surface is almost at rest, as "
        "at the end of a search.",
        "`average_force` evaluates motions, and `forces` is used inside the search. They are the "
        f"fastest functions with a 99th percentile below {MAX_P99:g} mu mg.",
    )


def rotations(rows: list[Row]) -> Drawn:
    """Return the chart of forces and times of Method A and its baselines."""
    panels = Panels()
    for case, title, unit in (
        ("force", "Force at 10 parts, 10 % quantile", "force [mu mg]"),
        ("time", "Linear problem of 10 parts", "time [ms]"),
    ):
        mine = [r for r in rows if r["case"] == case]
        x = Axis(unit, limits=(0, 1.2 * max(column(mine, "value"))))
        panel = panels.add(title, x, Axis("", names=tuple(column(mine, "label")[::-1])))
        for name, colour, ours in (("ours", OURS, True), ("others", PEER, False)):
            kind = [r for r in mine if r["ours"] is ours]
            labels = [f"{r['value']:.2g}" for r in kind]
            panel.bars(name, column(kind, "value"), column(kind, "label"), colour, labels)
    value = {r["label"]: r["value"] for r in rows}
    ours, svd = value["library, least time"], value["24 on a grid, SVD"]
    return Drawn(
        panels,
        f"For ten parts, a library of centres with minimum time guarantees {ours:.3f} mu mg, the "
        f"paper's SVD weights on 24 centres {svd:.4f}. The project's solver takes "
        f"{shown(value['ours, cold'])} ms, HiGHS {shown(value['scipy linprog (HiGHS)'])} ms.",
    )


def inversion(rows: list[Row]) -> Drawn:
    """Return the chart of the results of requests, and of the solving time."""
    names = [f"{r['parts']} parts, N = {r['harmonics']}" for r in rows]
    y = Axis("", names=tuple(names[::-1]))
    panels = Panels()
    left = panels.add(
        "What becomes of requests up to 0.2 mu mg", Axis("requests [%]", limits=(0, 100)), y
    )
    left.bars("solved", column(rows, "solved"), names, OURS)
    if any(column(rows, "proven")):
        left.bars("proven out of reach", column(rows, "proven"), names, SECOND)
    more = [r["more"] - r["solved"] for r in rows]
    left.bars("by ten times the starts", more, names, THIRD)
    rest = [100 - r["more"] - r["proven"] for r in rows]
    left.bars("in part only", rest, names, "#cccccc")
    right = panels.add("Time", Axis("median time of a cold solve [ms]", log=True), y)
    named = [r | {"name": name} for r, name in zip(rows, names, strict=True)]
    right.points(named, "median_ms", "name", Look("median time", THIRD))
    free = [r for r in rows if "(" in str(r["harmonics"])]
    least = min(r["share"] for r in free if r["share"] is not None)
    solved = ", ".join(f"{r['solved']:.0f} % with {r['parts']} parts" for r in free)
    return Drawn(
        panels,
        f"Requests solved with the default number of harmonics: {solved}. Of an unsolved request, "
        f"at least the fraction {least:.2f} (median) is feasible.",
    )


def learning(rows: list[Row]) -> Drawn:
    """Return the chart of the error of realised harmonics against the number of experiments."""
    panels, ticks = Panels(), tuple(column(rows, "iteration"))
    panel = panels.add(
        "Error of realised harmonics", Axis("experiments", ticks=ticks), Axis("error [%]", log=True)
    )
    panel.points(rows, "iteration", "most", Look("largest of the cycles", SECOND, "s", "--"))
    panel.points(rows, "iteration", "median", Look("median", OURS, "o", "-"))
    panel.rule("2 %", y=2, colour=LIMIT)
    first, last = rows[0], rows[-1]
    return Drawn(
        panels,
        f"The largest error falls from {first['most']:.0f} % to {last['most']:.2f} % in "
        f"{last['iteration']} experiments.",
    )
