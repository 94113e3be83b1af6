"""The charts of the solvers: force map, both methods, their options and limits."""

from __future__ import annotations

from typing import Any

from chart import (
    LIMIT,
    OURS,
    PEER,
    SECOND,
    THIRD,
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
from harness import shown

LEAST_ERROR = 1e-11
"""Errors below this [mu m g] are rounding, and drawn here."""

WANTED = 1e-6
"""Error of the force map that is wanted in the worst 1 % [mu m g]."""

METHODS = {"sinusoids": (OURS, "B: sinusoids"), "rotations": (SECOND, "A: rotations")}
"""Colour and name of both methods."""

MAPS = {"none": ("o", "paper's map (5)"), "velocity": ("s", "with parts' velocity"),
        "cycle": ("D", "stick-slip over a cycle")}  # fmt: skip
"""Marker and name of the maps on which requests are met."""


def force_map(data: Data) -> Chart:
    """Return time and error of every way to the averaged force."""
    batched = [r for r in table(data, "force_map", "batched") if r["harmonics"] == 2]
    one = table(data, "force_map", "methods")
    rows = [
        {"case": case, "method": row["method"], "us": row[time], "median": row["median"],
         "p99": row["p99"]}
        for case, found, time in (("many", batched, "us"), ("one", one, "one_us"))
        for row in found
    ]  # fmt: skip
    ours = {"many": "forces", "one": "average_force"}
    titles = {"many": "Many motions in one call, N = 2", "one": "One finished cycle, 1 part"}
    panels = []
    for case, title in titles.items():
        mine = [r for r in rows if r["case"] == case]
        best = next(r for r in mine if r["method"] == ours[case])
        points = [
            Points(
                "ours" if look == OURS else "others", [r["us"] for r in kind],
                [max(r["p99"], LEAST_ERROR) for r in kind], look,
                notes=tuple(f"{r['method']}, median error {shown(r['median'])}" for r in kind),
                labels=tuple(r["method"] for r in kind),
            )
            for look, kind in (
                (OURS, [best]), (PEER, [r for r in mine if r is not best]),
            )
        ]  # fmt: skip
        log = case == "one"
        limits = (1, 3e4) if log else (0, 1.6 * max(r["us"] for r in mine))
        panels.append(
            Panel(
                title,
                Axis("time of one part's force [µs]", log=log, limits=limits),
                Axis("error, worst 1 % of cases [µmg]", log=True),
                tuple(points), (Rule("wanted", y=WANTED),),
                (Mark(best["us"], best["p99"]),), "less less",
            )
        )  # fmt: skip
    best = next(r for r in one if r["method"] == "average_force")
    quad = next(r for r in one if r["method"].startswith("quad"))
    return Chart(
        "force_map", "a", "Force map: error against time",
        "The averaged friction of a part under a plate motion, random cases; the truth is scipy's "
        "quad with its tolerances at 1e-10. Down and to the left is better.",
        f"The error of the worst 1 % is {best['p99']:.0e} µmg in {best['one_us']:.0f} µs, "
        f"{quad['one_us'] / best['one_us']:.0f} times as fast as scipy's quad; equal steps are "
        f"faster but miss {WANTED:g} by a factor of a hundred and more where the surface almost "
        "stands still.",
        "average_force for judging, forces inside the search: the fastest that keep the worst "
        f"1 % below {WANTED:g} µmg; what is faster on the front is wrong just at the dips where "
        "a search ends.",
        ("force_map",), tuple(panels), rows,
        {"us": "time of one force [µs]", "median": "median error [µmg]",
         "p99": "worst 1 % [µmg]"},
    )  # fmt: skip


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
        points = []
        for method, colour, marker, name in looks:
            mine = [r for r in rows if r["parts"] == count and r["method"] == method]
            points.append(
                Points(
                    name, [r["ms"] for r in mine], [max(r["error"], LEAST_ERROR) for r in mine],
                    colour, marker, in_front=False,
                )
            )  # fmt: skip
        panels.append(
            Panel(
                parts(count), Axis("time of one cold solve [ms]", log=True),
                Axis("largest error of a force [µmg]", log=True), tuple(points),
                (Rule("wanted", y=1e-4),),
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
        "Random requests up to 0.2 µmg from a cold start, each a point; judged on samples that no "
        f"solver has used. Errors below {LEAST_ERROR:g} are drawn there. A point above the line "
        "was not met: with few harmonics some requests cannot be.",
        f"Within 1e-4 µmg, Method B: {lead}.",
        "Method B, sinusoids: at the same error the least time for every number of parts.",
        ("solver",), tuple(panels), rows,
        {"parts": "parts", "ms": "time [ms]", "error": "error [µmg]"},
    )  # fmt: skip


def realised(data: Data) -> Chart:
    """Return what the simulator's force misses for every map of both methods."""
    rows = table(data, "requests", "realised")
    least = min(r["size"] for r in rows)
    panels = []
    for count in sorted({r["parts"] for r in rows}):
        points = []
        for method, (colour, name) in METHODS.items():
            for refine, (marker, told) in MAPS.items():
                mine = [
                    r for r in rows
                    if (r["parts"], r["method"], r["refine"]) == (count, method, refine)
                ]  # fmt: skip
                points.append(
                    Points(
                        f"{name}, {told}", [r["median_ms"] for r in mine],
                        [r["error_percent"] for r in mine], colour, marker,
                        notes=tuple(f"requests up to {r['size']:g} µmg" for r in mine),
                    )
                )  # fmt: skip
        chosen = [
            r for r in rows
            if (r["parts"], r["method"], r["refine"], r["size"])
            == (count, "sinusoids", "cycle", least)
        ]  # fmt: skip
        panels.append(
            Panel(
                parts(count), Axis("median time of a cold solve [ms]", log=True),
                Axis("force missed in the simulator, RMS [%]", log=True), tuple(points),
                (Rule("wanted", y=10),),
                tuple(Mark(r["median_ms"], r["error_percent"]) for r in chosen), "less less",
            )
        )  # fmt: skip
    ours = [
        f"{r['error_percent']:.1f} % at {r['parts']}"
        for r in rows
        if (r["method"], r["refine"], r["size"]) == ("sinusoids", "cycle", least)
    ]
    return Chart(
        "realised", "b", "Solvers' maps: what parts really get",
        "The request against the force that the independent simulator gives over one cycle, for "
        "both methods and the three maps on which they can meet it. Two points of a kind: "
        "requests up to 0.02 and 0.04 µmg. Restarts included.",
        f"On the stick-slip map Method B misses {', '.join(ours)} parts; the paper's averaged map "
        "alone misses most of what it promises.",
        "The stick-slip map: the others are on the front only where their error makes them "
        "useless.",
        ("requests",), tuple(panels), rows, columns(data, "requests", "realised"),
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
        "Method B: it misses less from four parts on.", ("steering",), tuple(panels), rows,
        columns(data, "steering", "steering"),
    )  # fmt: skip


def rotations(data: Data) -> Chart:
    """Return forces and times of Method A, with its peers."""
    rows: list[Row] = [
        {"case": "force", "label": f"{r['centres']}, {r['method']}", "value": r["p10"],
         "ours": r["method"] == "least time" and r["centres"] == "library"}
        for r in table(data, "rotations", "guaranteed")
    ]  # fmt: skip
    rows += [
        {"case": "force", "label": f"realised, {r['closure']}", "value": r["p10"], "ours": True}
        for r in table(data, "rotations", "realised")
    ]
    rows += [
        {"case": "time", "label": r["method"], "value": r["milliseconds"],
         "ours": r["method"].startswith("ours")}
        for r in table(data, "rotations", "times")
    ]  # fmt: skip
    titles = {
        "force": ("Force at 10 parts, 10 % quantile", "[µmg]"),
        "time": ("Time of the linear problem, 10 parts", "[ms]"),
    }
    panels = [bar_panel([r for r in rows if r["case"] == c], *titles[c]) for c in titles]
    value = {r["label"]: r["value"] for r in rows}
    ours, svd = value["library, least time"], value["24 on a grid, SVD"]
    return Chart(
        "rotations", "b", "Method A: forces and time of its linear problem",
        "Guaranteed: the force in any direction that takes one cycle of time, before it is "
        "realised as a motion; realised: what closed motions within the rig's limits give.",
        f"A library of centres with least time guarantees {ours:.3f} µmg for ten parts, the "
        f"paper's SVD weights on 24 centres {svd:.4f}; ours takes "
        f"{shown(value['ours, cold'])} ms, HiGHS {shown(value['scipy linprog (HiGHS)'])} ms.",
        "Library, least time, closed as a sequence: ten times the force of the SVD for a fraction "
        "of the time of a general linear programme.",
        ("rotations",), tuple(panels), rows,
        {"value": "value [µmg or ms]"},
    )  # fmt: skip


def bar_panel(rows: list[Row], title: str, unit: str) -> Panel:
    """Return a bar for each row, ours and others."""
    names = tuple(r["label"] for r in rows[::-1])
    points = [
        Points(
            name, [r["value"] for r in mine], [r["label"] for r in mine], colour, bars=True,
            labels=tuple(f"{r['value']:.2g}" for r in mine),
        )
        for name, colour, mine in (
            ("ours", OURS, [r for r in rows if r["ours"]]),
            ("others", PEER, [r for r in rows if not r["ours"]]),
        )
    ]  # fmt: skip
    return Panel(title, Axis(unit), Axis("", names=names), tuple(points))


def inversion(data: Data) -> Chart:
    """Return what becomes of requests, and the time that it takes."""
    rows = table(data, "inversion", "fate")
    names = [f"{r['parts']} parts, N = {r['harmonics']}" for r in rows]
    rest = [100 - r["solved"] - r["proven"] for r in rows]
    y = Axis("", names=tuple(names[::-1]))
    left = Panel(
        "What becomes of requests up to 0.2 µmg", Axis("requests [%]", limits=(0, 100)), y,
        (
            Points("solved", [r["solved"] for r in rows], names, OURS, bars=True),
            Points("proven out of reach", [r["proven"] for r in rows], names, SECOND, bars=True),
            Points("neither", rest, names, "#cccccc", bars=True),
        ),
    )  # fmt: skip
    right = Panel(
        "Time", Axis("median time of a cold solve [ms]", log=True), y,
        (Points("median time", [r["median_ms"] for r in rows], names, THIRD),),
    )  # fmt: skip
    least = min(100 - share for share in rest)
    return Chart(
        "inversion", "b", "Method B: what can be solved",
        "N is the number of harmonics; in brackets: as many as the solver chooses.",
        f"At least {least:.0f} % of requests are solved or proven to be out of reach, up to "
        f"{max(r['parts'] for r in rows)} parts.",
        "As many harmonics as the solver chooses: with the fewest that the rank allows, "
        "many requests are out of reach.", ("inversion",), (left, right), rows,
        columns(data, "inversion", "fate"),
    )  # fmt: skip


def learning(data: Data) -> Chart:
    """Return the error of realised harmonics against the number of experiments."""
    rows = table(data, "learning", "learning")
    x = [r["iteration"] for r in rows]
    panel = Panel(
        "Error of realised harmonics", Axis("experiments", ticks=tuple(x)),
        Axis("error [%]", log=True),
        (
            Points("largest of the cycles", x, [r["most"] for r in rows], SECOND, "s", "--"),
            Points("median", x, [r["median"] for r in rows], OURS, "o", "-"),
        ),
        (Rule("2 %", y=2, colour=LIMIT),),
    )  # fmt: skip
    first, last = rows[0], rows[-1]
    return Chart(
        "learning", "", "Learning the plate",
        "A plate on flexures, 35 Hz, damping 3 %, motors 15 % apart: error of the harmonics of "
        "cycles not used for learning, after each experiment; three are the calibration.",
        f"The largest error falls from {first['most']:.0f} % to {last['most']:.2f} % in "
        f"{last['iteration']} experiments.", "", ("learning",), (panel,), rows,
        columns(data, "learning", "learning"),
    )  # fmt: skip


def parts(count: Any) -> str:
    """Return a number of parts in words."""
    return f"{count} part{'s' * (count > 1)}"
