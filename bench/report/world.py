"""The charts of simulator, vision and the closed loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from plate_sim.bodies import STEP as BODY_STEP
from plate_sim.friction import STEP
from plate_sim.points import TOLERANCE
from report.chart import (
    FAINT,
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

LEAST_MM = 1e-12
"""Errors below this [mm] are rounding, and drawn here."""

DEFAULT_TOLERANCE = f"{TOLERANCE:g} m"
"""Setting of the simulator that is our default."""

SIMULATORS = {
    "by events": (OURS, "o"), "in steps": (SECOND, "s"), "plate_sim": (OURS, "o"),
    "pymunk": (PEER, "D"), "MuJoCo": (THIRD, "^"),
}  # fmt: skip
"""Colour and marker of our integrators and the peers."""


def sim(data: Data) -> Chart:
    """Return error against speed of the simulator: parts alone, and parts that collide."""
    rows = table(data, "sim", "error")
    looks = {
        method: (f"points, {method}" if method in ("by events", "in steps") else method, *look, "-")
        for method, look in SIMULATORS.items()
    }
    panels = [
        speed_panel(
            f"1 part, shaken at {gamma} µg", "error of the travel after 1 s [mm]", looks,
            [r | {"error": max(r["error_mm"], LEAST_MM)} for r in rows if r["gamma"] == gamma],
            lambda r: r["method"] == "by events" and r["setting"] == DEFAULT_TOLERANCE,
        )
        for gamma in sorted({r["gamma"] for r in rows})
    ]  # fmt: skip
    panels += disc_panels(data)
    if "bodies" in data:
        panels.append(body_panel(data))
    speeds = table(data, "sim", "speed")
    lead = ", ".join(f"{r['lead']:.0f}" for r in speeds if r["scene"] == "all ways")
    counts = ", ".join(str(r["parts"]) for r in speeds if r["scene"] == "all ways")
    return Chart(
        "sim", "c", "Simulator: error against speed, beside its peers",
        "Each point is a setting (tolerance or step). Parts alone are judged in scenes whose "
        "answer is known; discs that collide by how deep they overlap, which true ones never do; "
        "a body that turns against scipy. Down and to the right is better.",
        f"At pymunk's error, {lead} times as fast as pymunk with {counts} parts that move all "
        f"ways, and to an error of {min(r['error_mm'] for r in rows):.0e} mm where that is wanted.",
        f"Points by events at a tolerance of {DEFAULT_TOLERANCE}: at once the fastest and the most "
        f"exact. Discs in steps of {1e3 * STEP:g} ms where parts touch: friction and knocks in one "
        f"step, at an overlap that no camera sees. Bodies that turn, in {1e3 * BODY_STEP:g} ms, "
        "only where a scene needs it.",
        tuple(n for n in ("sim", "bodies") if n in data), tuple(panels), [*rows, *disc_rows(data)],
        columns(data, "sim", "error") | {"gamma": "peak accel. [µg], or parts"},
    )  # fmt: skip


def disc_rows(data: Data) -> list[Row]:
    """Return the settings of discs and bodies in the form of the other rows."""
    found: list[Row] = [
        {"method": r["method"], "gamma": "a body", "setting": r["setting"],
         "error_mm": r["error_mm"], "error_percent": None, "speed": r["speed"]}
        for r in (table(data, "bodies", "bodies") if "bodies" in data else ())
    ]  # fmt: skip
    return found + [
        {"method": r["method"], "gamma": f"{r['parts']} discs", "setting": f"{r['step_ms']:g} ms",
         "error_mm": 1e-3 * r["overlap_um"], "error_percent": None, "speed": r["speed"]}
        for r in table(data, "sim", "discs")
    ]  # fmt: skip


def disc_panels(data: Data) -> list[Panel]:
    """Return overlap against speed for colliding discs."""
    rows = [
        r | {"error": max(r["overlap_um"], 0.01), "setting": f"steps of {r['step_ms']:g} ms"}
        for r in table(data, "sim", "discs")
    ]
    looks = {
        method: ("discs, ours" if method == "plate_sim" else method, *look, "")
        for method, look in SIMULATORS.items()
    }
    return [
        speed_panel(
            f"{count} discs that collide", "deepest overlap [µm]", looks,
            [r for r in rows if r["parts"] == count],
            lambda r: r["method"] == "plate_sim" and r["step_ms"] <= 1.01e3 * STEP,
        )
        for count in sorted({r["parts"] for r in rows})
    ]  # fmt: skip


def body_panel(data: Data) -> Panel:
    """Return error against speed of a disc that turns."""
    looks = {
        "bodies": ("bodies that turn, ours", SECOND, "s", "-"),
        "scipy RK45": ("scipy", FAINT, "x", "-"),
    }
    return speed_panel(
        "1 body that slides and turns", "error of centre or rim after 0.2 s [mm]", looks,
        [r | {"error": r["error_mm"]} for r in table(data, "bodies", "bodies")],
        lambda r: r["setting"] == f"{1e3 * BODY_STEP:g} ms",
    )  # fmt: skip


def speed_panel(
    title: str,
    label: str,
    looks: Mapping[str, tuple[str, str, str, str]],
    rows: list[Row],
    is_default: Callable[[Row], bool],
) -> Panel:
    """Return a panel of `error` against `speed`; `looks` are name, colour, marker and line of each
    method, and our default has a mark."""
    points = []
    for method in dict.fromkeys(r["method"] for r in rows):
        mine = [r for r in rows if r["method"] == method]
        name, colour, marker, line = looks[method]
        points.append(
            Points(
                name, [r["speed"] for r in mine], [r["error"] for r in mine], colour, marker, line,
                notes=tuple(r["setting"] for r in mine),
            )
        )  # fmt: skip
    return Panel(
        title, Axis("simulated s per s of one core", log=True), Axis(label, log=True),
        tuple(points), better="more less",
        marks=tuple(Mark(r["speed"], r["error"]) for r in rows if is_default(r)),
    )  # fmt: skip


def cost(data: Data) -> Chart:
    """Return the cost of every stage, and of every model of the simulator, by parts."""
    stages = table(data, "stages", "stages")
    counts = [r["parts"] for r in stages]
    names = (
        ("solver", OURS, "o", "-"), ("vision", PEER, "s", "-"), ("driver", SECOND, "D", "-"),
        ("planner", THIRD, "^", "-"), ("simulator", FAINT, "v", ":"), ("camera", FAINT, "x", "--"),
    )  # fmt: skip
    points = [
        Points(name, counts, [r[name] for r in stages], colour, marker, line)
        for name, colour, marker, line in names
    ]
    points.append(
        Points("image to setpoints", counts, [r["answer"] for r in stages], "#111111", "", "-")
    )
    points.append(
        Points("one cycle: the limit", counts, [r["period"] for r in stages], LIMIT, "", "-")
    )
    first = Panel(
        "Every stage, one image", Axis("parts on the plate", ticks=tuple(counts)),
        Axis("median time for one image [ms]", log=True), tuple(points),
    )  # fmt: skip
    models = table(data, "sim", "cost")
    looks = {
        "by events": (OURS, "o", "points, by events"), "points": (SECOND, "s", "points, in steps"),
        "discs": (THIRD, "D", "discs that touch"), "bodies": (FAINT, "^", "bodies that turn"),
        "pymunk": (PEER, "x", "pymunk, 1 ms"),
    }  # fmt: skip
    second = Panel(
        "The simulator's models", Axis("parts", log=True),
        Axis("time of 1 simulated s [s]", log=True),
        tuple(
            Points(
                label, [r["parts"] for r in models],
                [1 / r[name] if r.get(name) else None for r in models], colour, marker, "-",
            )
            for name, (colour, marker, label) in looks.items()
            if any(r.get(name) for r in models)
        ),
        (Rule("real time", y=1),),
    )  # fmt: skip
    last = stages[-1]
    return Chart(
        "cost", "g", "Cost against the number of parts",
        "Cores of the nodes, without ROS. The stages between image and setpoints have to fit into "
        "one cycle of the plate; camera and simulator stand in for the machine.",
        f"{last['parts']} parts: {last['answer']:.1f} ms from image to setpoints, "
        f"{100 * last['answer'] / last['period']:.0f} % of a cycle of {last['period']:.0f} ms; "
        f"the solver is {100 * last['solver'] / last['answer']:.0f} % of it.", "",
        ("stages", "sim"), (first, second), stages, columns(data, "stages", "stages"),
    )  # fmt: skip


def span(rows: list[Row], key: str) -> str:
    """Return the least and greatest value of a column."""
    values = [row[key] for row in rows]
    return f"{min(values):.2g} to {max(values):.2g}"


def vision(data: Data) -> Chart:
    """Return error against time of finding discs, a panel for each scene."""
    rows = table(data, "vision", "vision")
    colours = (OURS, PEER, SECOND, THIRD, "#8a6d00", LIMIT)
    methods = list(dict.fromkeys(r["method"] for r in rows))
    panels = []
    for place in ("apart", "touching"):
        for discs in sorted({r["discs"] for r in rows}):
            points = []
            for method, colour, marker in zip(methods, colours, "osD^vx", strict=False):
                mine = [
                    r for r in rows
                    if (r["discs"], r["place"], r["method"]) == (discs, place, method)
                    and r["rms_px"] is not None
                ]  # fmt: skip
                wrong = [r["missed_percent"] + r["false_percent"] for r in mine]
                points.append(
                    Points(
                        method, [r["loop_ms"] for r in mine], [r["rms_px"] for r in mine],
                        colour, marker, hollow=tuple(w > 0 for w in wrong),
                        notes=tuple(
                            f"missed {r['missed_percent']:.0f} %, invented "
                            f"{r['false_percent']:.0f} %" for r in mine
                        ),
                        labels=tuple(
                            f"{r['missed_percent']:.0f} % missed" if w else ""
                            for r, w in zip(mine, wrong, strict=True)
                        ),
                    )
                )  # fmt: skip
            ours = points[0]
            panels.append(
                Panel(
                    f"{discs} discs, {place}", Axis("time for one image, in a loop [ms]", log=True),
                    Axis("error of the centres, RMS [px]", log=True), tuple(points),
                    marks=(Mark(ours.x[0], ours.y[0]),), better="less less",
                )
            )  # fmt: skip
    ours = [r for r in rows if r["method"] == methods[0]]
    return Chart(
        "vision", "d", "Vision: error against time, beside its peers",
        "Images of 640 x 480 px by the simulated camera with noise; 1 px is about 1 mm. Hollow: "
        "parts are missed or invented, so no front goes there. Down and to the left is better.",
        f"Ours: {span(ours, 'rms_px')} px in {span(ours, 'loop_ms')} ms in a loop of its own, in "
        f"{span(ours, 'turns_ms')} ms in turns with the peers; no disc missed or invented, also "
        "where they touch.",
        "plate_vision.detect: the most exact in every scene. Contours are faster where discs "
        "touch, but cannot part them, and err four to six times as much.",
        ("vision",), tuple(panels), rows, columns(data, "vision", "vision"),
    )  # fmt: skip
