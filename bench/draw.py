"""How the charts are drawn: one function each, and what they share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plate_sim.points import TOLERANCE

OURS, PEER, SECOND, FAINT = "#0b6e99", "#d1651e", "#5a9e4b", "#8a8a8a"
"""Colours: our default method, the peer, our second method, notes."""

PALETTE = ("#0b6e99", "#d1651e", "#5a9e4b", "#7d4f9e")

SIMULATED = {"simulator": "parts", "camera": "camera"}
"""Names of the stages that only the simulation has."""

DEFAULT_TOLERANCE = f"{TOLERANCE:g} m"
"""Setting of the simulator that is our default."""

LEAST_MM = 1e-12
"""Errors below this [mm] are rounding, and drawn here."""


def draw_sim(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Error against speed, a point for each setting."""
    both = figure.subplots(1, 2, sharey=True)
    looks = (
        ("by events", OURS, "o-"), ("in steps", SECOND, "s-"), ("pymunk", PEER, "o-"),
        ("MuJoCo", FAINT, "^-"),
    )  # fmt: skip
    for axes, gamma in zip(both, sorted({r["gamma"] for r in rows}), strict=True):
        for method, colour, look in looks:
            mine = [r for r in rows if r["gamma"] == gamma and r["method"] == method]
            if not mine:
                continue
            x, y = [r["speed"] for r in mine], [max(r["error_mm"], LEAST_MM) for r in mine]
            axes.plot(x, y, look, color=colour, label=method, ms=5)
            if method != "by events":
                up = 6 if method == "MuJoCo" else -10
                for k in (0, len(mine) - 1):
                    note(axes, mine[k]["setting"], (x[k], y[k]), colour, 2, up)
            else:
                k = next(k for k, r in enumerate(mine) if r["setting"] == DEFAULT_TOLERANCE)
                mark(axes, x[k], y[k], "our default")
        axes.set(xscale="log", yscale="log", xlabel="simulated s per s of one core")
        axes.set_title(f"shaken at {gamma} µg")
        axes.margins(x=0.2, y=0.08)
        axes.yaxis.set_major_formatter("{x:g}")
    both[0].set_ylabel("error of the travel after 1 s [mm]")
    figure.legend(*both[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)


def draw_learning(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Error of realised harmonics against the number of experiments."""
    axes = figure.subplots()
    x = [r["iteration"] for r in rows]
    axes.plot(x, [r["most"] for r in rows], "s--", color=SECOND, label="largest of the cycles")
    axes.plot(x, [r["median"] for r in rows], "o-", color=OURS, label="median")
    axes.axhline(2, color=FAINT, ls=":", lw=1)
    note(axes, "2 %", (x[-1], 2), FAINT, -20, 4)
    axes.set(yscale="log", xlabel="experiments", ylabel="error of realised harmonics [%]", xticks=x)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend()


def draw_cost(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Speed against the number of parts, for each model of the ladder."""
    axes = figure.subplots()
    looks = {
        "by events": (OURS, "o-", "points, by events"), "points": (SECOND, "s-", "points"),
        "discs": (SECOND, "s--", "discs that touch"), "bodies": (SECOND, "s:", "finite bodies"),
        "pymunk": (PEER, "o-", "pymunk, 1 ms"),
    }  # fmt: skip
    for name, (colour, look, label) in looks.items():
        if rows[0].get(name):
            axes.plot(
                [r["parts"] for r in rows], [r[name] for r in rows], look, color=colour,
                label=label, ms=5,
            )  # fmt: skip
    axes.axhline(1, color=FAINT, lw=1)
    note(axes, "real time", (rows[0]["parts"], 1), FAINT, 0, 4)
    axes.set(xscale="log", yscale="log", xlabel="parts", ylabel="simulated s per s of one core")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.legend(fontsize=9.5)


def draw_solver(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Error against time of every single target, by number of parts."""
    parts = sorted({r["parts"] for r in rows})
    grid = figure.subplots(1, len(parts), sharex=True, sharey=True)
    looks = (
        ("RotationSolver", SECOND, "s"), ("scipy lm", PEER, "x"), ("SinusoidSolver", OURS, "o"),
    )  # fmt: skip
    for axes, count in zip(grid, parts, strict=True):
        for method, colour, marker in looks:
            mine = [r for r in rows if r["parts"] == count and r["method"] == method]
            y = [max(r["error"], 1e-11) for r in mine]
            label = method + (" (default)" if method == "SinusoidSolver" else "")
            axes.plot(
                [r["ms"] for r in mine], y, marker, color=colour, ms=4, alpha=0.6, label=label
            )
        axes.axhline(1e-4, color=FAINT, lw=1, ls="--")
        axes.set(xscale="log", yscale="log", title=f"{count} part{'s' * (count > 1)}")
    grid[0].set_ylabel("largest error of a force [µmg]")
    figure.supxlabel("time of one cold solve [ms]", fontsize=11)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside upper center", ncols=3)


def draw_stages(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Time of each stage against the number of parts."""
    axes = figure.subplots()
    names = ("solver", "vision", "driver", "planner")
    colours = dict(zip(names, PALETTE, strict=True))
    x = [r["parts"] for r in rows]
    ends = []
    for name in names:
        axes.plot(x, [r[name] for r in rows], "o-", color=colours[name], ms=5)
        ends.append((rows[-1][name], name, colours[name]))
    for name, look in (("simulator", ":"), ("camera", "--")):
        axes.plot(x, [r[name] for r in rows], look, color=FAINT, lw=1.5)
        ends.append((rows[-1][name], f"simulated {SIMULATED[name]}", FAINT))
    axes.plot(x, [r["answer"] for r in rows], "-", color="black", lw=1)
    axes.plot(x, [r["period"] for r in rows], "-", color="#b02a37", lw=2)
    ends += [(rows[-1]["answer"], "image to setpoints", "black")]
    ends += [(rows[-1]["period"], "one cycle: the limit", "#b02a37")]
    axes.set(yscale="log", xlabel="parts on the plate", ylabel="median time for one image [ms]")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xticks(x)
    label_ends(axes, x[-1], ends)


def draw_tracking(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Tracking error against speed for each number of parts, and the frontier of both methods."""
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    counts = sorted({r["parts"] for r in rows})
    shades = colormaps["viridis_r"](np.linspace(0.15, 1, len(counts)))
    for count, colour in zip(counts, shades, strict=True):
        mine = [r for r in rows if r["parts"] == count and r["method"] == "sinusoids"]
        x, y = [r["speed_mm_s"] for r in mine], [r["rms_mm"] for r in mine]
        left.plot(x, y, "-", color=colour, lw=1.5, label=f"{count}")
        for r in mine:
            fill = colour if r["kept"] else "white"
            left.plot(r["speed_mm_s"], r["rms_mm"], "o", color=colour, mfc=fill, ms=6)
    bounds = sorted({r["bound_mm_s"] for r in rows if r["method"] == "sinusoids"})
    for bound in bounds:
        left.axvline(bound, color=FAINT, ls="--", lw=1)
    left.annotate(
        "aT/16", (bounds[0], 0.02), (-3, 0), color=FAINT, rotation=90, fontsize=9, ha="right",
        va="bottom", xycoords=("data", "axes fraction"), textcoords="offset points",
    )  # fmt: skip
    left.plot([], [], "o", color=FAINT, mfc="white", ms=6, label="not kept")
    left.set(
        xscale="log", yscale="log", xlabel="speed along the path [mm/s]",
        ylabel="RMS distance from the path's point [mm]",
    )  # fmt: skip
    left.set_xticks([2, 5, 10, 20, 40, 80, 160, 320, 1000])
    left.minorticks_off()
    left.legend(title="sinusoids, parts", fontsize=9, title_fontsize=9, ncols=2)
    for method, colour in (("sinusoids", OURS), ("rotations", SECOND)):
        mine = [r for r in rows if r["method"] == method]
        if not mine:
            continue
        most = [
            max([r["speed_mm_s"] for r in mine if r["parts"] == n and r["kept"]], default=np.nan)
            for n in counts
        ]
        right.plot(counts, most, "o-", color=colour, label=method)
        bound = [next(r["bound_mm_s"] for r in mine if r["parts"] == n) for n in counts]
        right.plot(counts, bound, "--", color=colour, lw=1)
    right.plot([], [], "--", color=FAINT, label="aT/16: no part faster")
    right.set(yscale="log", xlabel="parts", ylabel="fastest speed kept [mm/s]", xticks=counts)
    right.legend(fontsize=9)
    for axis in (left.xaxis, left.yaxis, right.yaxis):
        axis.set_major_formatter("{x:g}")


def draw_steering(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Time and missed share against the number of parts."""
    left, right = figure.subplots(1, 2)
    for method, colour in (("sinusoids", OURS), ("rotations", SECOND)):
        mine = [r for r in rows if r["method"] == method]
        x = [r["parts"] for r in mine]
        label = method + (" (default)" if method == "sinusoids" else "")
        left.plot(x, [r["warm_ms"] for r in mine], "o-", color=colour, label=label)
        left.plot(x, [r["cold_ms"] for r in mine], "o:", color=colour, mfc="white")
        right.plot(x, [r["missed_percent"] for r in mine], "o-", color=colour)
        right.plot(x, [r["predicted_percent"] for r in mine], "o:", color=colour, mfc="white")
    left.set(yscale="log", xlabel="parts", ylabel="median time of a solve [ms]")
    left.yaxis.set_major_formatter("{x:g}")
    right.set(xlabel="parts", ylabel="displacement missed, RMS [% of asked]", ylim=(0, None))
    right.axhline(15, color=FAINT, ls="--", lw=1)
    right.annotate(
        "good enough", (1, 15), (0, 3), xycoords=("axes fraction", "data"), fontsize=8.5,
        textcoords="offset points", ha="right", color=FAINT,
    )  # fmt: skip
    for axes, full, empty in ((left, "warm", "cold start"), (right, "in truth", "as predicted")):
        axes.set_xticks(x)
        axes.plot([], [], "o-", color=FAINT, label=full)
        axes.plot([], [], "o:", color=FAINT, mfc="white", label=empty)
        axes.legend(handles=axes.get_lines()[-2:], fontsize=9)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], loc="outside upper center", ncols=2)


def mark(axes: Axes, x: float, y: float, text: str, right: bool = False) -> None:
    """Put a ring round our default and name it, on its left or right."""
    axes.plot(x, y, "o", ms=15, mfc="none", mec="black", mew=1.3)
    axes.annotate(
        text, (x, y), (12 if right else -12, 0), textcoords="offset points",
        ha="left" if right else "right", va="center", fontsize=9.5,
    )  # fmt: skip


def note(
    axes: Axes, text: str, place: tuple[float, float], colour: str, right: float = 7, up: float = 4
) -> None:
    """Write a small word beside a point, `right` and `up` of it [points]."""
    axes.annotate(text, place, (right, up), textcoords="offset points", fontsize=8.5, color=colour)


def label_ends(axes: Axes, x: float, ends: Iterable[tuple[float, str, str]]) -> None:
    """Name lines at their right ends, moved apart (logarithmic axis)."""
    placed, least = -np.inf, 0.062 * float(np.diff(np.log10(axes.get_ylim()))[0])
    for y, text, colour in sorted(ends):
        placed = max(float(np.log10(y)), placed + least)
        axes.annotate(
            text, (x, 10**placed), (10, 0), textcoords="offset points", color=colour,
            va="center", fontsize=10, annotation_clip=False,
        )  # fmt: skip
