"""How the charts of the solvers are drawn: force map, realised forces, rotations, inversion."""

from __future__ import annotations

from typing import Any

import numpy as np
from draw import FAINT, OURS, PEER, SECOND, note
from matplotlib.figure import Figure

Rows = list[dict[str, Any]]

REFINED = {"none": "o", "velocity": "s", "cycle": "D"}
"""Marker of each map on which a request is met."""


def draw_force_map(figure: Figure, rows: Rows) -> None:
    """Worst-1 % error against time: many motions in one call, and one cycle as it is sent."""
    both = figure.subplots(1, 2, sharey=True)
    titles = ("many motions in one call, N = 2", "one finished cycle, 1 part")
    for axes, case, title in zip(both, ("batched", "methods"), titles, strict=True):
        for row in (r for r in rows if r["case"] == case):
            ours = row["method"] in ("forces", "average_force")
            colour = OURS if ours else PEER
            axes.plot(row["us"], row["p99"], "o", color=colour, ms=9 if ours else 6)
            name = row["method"].replace("triangular waves", "closed form,\ntriangular waves")
            high = row["us"] > 100
            axes.annotate(
                name, (row["us"], row["p99"]), (-8 if high else 8, 0), color=colour, fontsize=9,
                textcoords="offset points", va="center", ha="right" if high else "left",
            )  # fmt: skip
        axes.axhline(1e-6, color=FAINT, lw=1, ls="--")
        axes.set(yscale="log", xlabel="time of one part's force [us]", title=title)
        axes.margins(y=0.1)
    both[0].set_xlim(0, 2.2 * max(r["us"] for r in rows if r["case"] == "batched"))
    both[1].set(xscale="log", xlim=(1, 5e3))
    both[1].xaxis.set_major_formatter("{x:g}")
    both[0].set_ylabel("error of the worst 1 % [µmg]")


def draw_realised(figure: Figure, rows: Rows) -> None:
    """What the simulator's force misses against the time of a solve, for every option."""
    parts = sorted({r["parts"] for r in rows})
    grid = np.atleast_1d(figure.subplots(1, len(parts), sharex=True, sharey=True))
    sizes = sorted({r["size"] for r in rows})
    for axes, count in zip(grid, parts, strict=True):
        for row in (r for r in rows if r["parts"] == count):
            colour = OURS if row["method"] == "sinusoids" else SECOND
            fill = colour if row["size"] == sizes[0] else "white"
            axes.plot(
                row["median_ms"], row["error_percent"], REFINED[row["refine"]], color=colour,
                mfc=fill, ms=7,
            )  # fmt: skip
        axes.axhline(10, color=FAINT, lw=1, ls="--")
        axes.set(xscale="log", yscale="log", title=f"{count} parts")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_major_formatter("{x:g}")
    grid[0].set_ylabel("force missed over one cycle, RMS [%]")
    figure.supxlabel("median time of one cold solve, restarts included [ms]", fontsize=11)
    legend = [
        grid[0].plot([], [], "o", color=colour, label=method)[0]
        for method, colour in (("sinusoids", OURS), ("rotations", SECOND))
    ]
    legend += [
        grid[0].plot([], [], mark, color="black", mfc="white", label=f"refine={name}")[0]
        for name, mark in REFINED.items()
    ]
    for size, fill in zip(sizes, ("black", "white"), strict=False):
        legend += grid[0].plot([], [], "o", color="black", mfc=fill, label=f"up to {size:g} µmg")
    figure.legend(handles=legend, loc="outside upper center", ncols=4, fontsize=9.5)


def draw_rotations(figure: Figure, rows: Rows) -> None:
    """Guaranteed and realised forces of Method A, and the time of its linear problem."""
    both = figure.subplots(1, 2)
    titles = ("force at 10 parts, 10 % quantile", "time of the linear problem")
    labels = ("[µmg]", "[ms]")
    for axes, case, title, label in zip(both, ("force", "time"), titles, labels, strict=True):
        mine = [r for r in rows if r["case"] == case][::-1]
        place = np.arange(len(mine))
        colours = [OURS if r["ours"] else PEER for r in mine]
        if case == "force":
            axes.barh(place, [r["value"] for r in mine], color=colours, height=0.6)
        else:
            axes.scatter([r["value"] for r in mine], place, color=colours, s=60)
        for y, row in zip(place, mine, strict=True):
            note(axes, f"{row['value']:.2g}", (row["value"], y), "black", 7, -3)
        axes.set_yticks(place, [r["label"] for r in mine], fontsize=9)
        axes.set_title(title, fontsize=11, loc="right")
        axes.set_xlabel(label)
        axes.grid(False, axis="y")
        axes.margins(x=0.25)
    both[1].set_xscale("log")
    both[1].xaxis.set_major_formatter("{x:g}")


def draw_inversion(figure: Figure, rows: Rows) -> None:
    """What becomes of requests by the number of parts, and the time that it takes."""
    left, right = figure.subplots(1, 2, width_ratios=(3, 2), sharey=True)
    place = -np.arange(len(rows))
    solved = np.array([r["solved"] for r in rows])
    proven = np.array([r["proven"] for r in rows])
    left.barh(place, solved, color=OURS, label="solved")
    left.barh(place, proven, left=solved, color=SECOND, label="proven out of reach")
    left.barh(place, 100 - solved - proven, left=solved + proven, color="#dddddd", label="neither")
    left.set_yticks(place, [f"{r['parts']} parts, N = {r['harmonics']}" for r in rows])
    left.set(xlabel="requests up to 0.2 µmg [%]", xlim=(0, 100))
    left.grid(False, axis="y")
    right.plot([r["median_ms"] for r in rows], place, "o", color=OURS)
    right.set(xscale="log", xlabel="median time of a cold solve [ms]")
    right.xaxis.set_major_formatter("{x:g}")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
