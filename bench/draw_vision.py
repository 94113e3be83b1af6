"""How the chart of the detector is drawn."""

from __future__ import annotations

from typing import Any

from draw import FAINT, OURS, PALETTE, PEER
from matplotlib.figure import Figure

MARKERS = "os^Dvp"


def draw_vision(figure: Figure, rows: list[dict[str, Any]]) -> None:
    """Error against time, a panel for each scene; dashed: what is wanted."""
    methods = list(dict.fromkeys(row["method"] for row in rows))
    colours = dict(zip(methods, (OURS, PEER, *PALETTE[2:], FAINT, "#b02a37"), strict=False))
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    scenes = [(discs, place) for place in ("apart", "touching") for discs in (10, 100)]
    for axes, (discs, place) in zip(grid.ravel(), scenes, strict=True):
        axes.set(xscale="log", yscale="log", title=f"{discs} discs, {place}")
        for method, marker in zip(methods, MARKERS, strict=False):
            row = next(
                r for r in rows if (r["discs"], r["place"], r["method"]) == (discs, place, method)
            )
            if row["rms_px"] is None:
                continue
            wrong = row["missed_percent"] + row["false_percent"]
            axes.plot(
                row["least_ms"], row["rms_px"], marker, color=colours[method], ms=8, label=method,
                mfc="white" if wrong else colours[method],
            )  # fmt: skip
            if wrong:
                text = f"{row['missed_percent']:.0f} % missed"
                axes.annotate(
                    text, (row["least_ms"], row["rms_px"]), (7, 3),
                    textcoords="offset points", fontsize=8, color=colours[method],
                )  # fmt: skip
        limit = {10: 0.5, 100: 1.5}[discs], {"apart": 0.03, "touching": 0.06}[place]
        axes.plot([0.1, limit[0], limit[0]], [limit[1], limit[1], 0.01], color=FAINT, lw=1, ls="--")
        axes.set(xlim=(0.12, 60), ylim=(0.01, 1))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
    figure.supxlabel("least time for one image of 640 x 480 px [ms]", fontsize=11)
    figure.supylabel("centre RMS [px]", fontsize=11)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=9.5)
