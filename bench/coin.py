"""The coin experiment (section 5 of the paper): out/coin/coin.png and coin.json.

python bench/coin.py [--out FOLDER]

The plate rotates back and forth about its centre, faster in one direction than in the other. A coin
moves around the centre at a constant rate, and slowly outwards, until it falls off the edge.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from harness import ROOT
from plate_core import PlateCycle, Rig, load_rig, piped
from plate_core.motion import usage
from plate_sim import WorldState, run_cycle
from stages.scenes import wave_cycle

FREQUENCY, SPIN = 25, 1.05
"""Frequency w/(2 pi) [Hz] and SPIN [rad/s] of the plate's rotation theta' = SPIN (sin wt + cos(2
wt) / 2). This motion is within the rig's limits."""

COIN_RADIUS = 9.525e-3
"""Radius of a 1 cent coin [m]."""

START, MAX_S = 0.08, 3600
"""Initial distance of the coin from the plate's centre [m], and maximum duration [s]."""

SHOWN, MEAN = 2.0, 10
"""Time between two drawn positions of the coin, and time over which its angular and radial speeds
are averaged [s]."""

INK, COIN = "#3b3b3b", "#0b6e99"


@piped()
def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "out/coin")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    rig, cycle = load_rig(), plate_motion()
    track = simulate_coin(rig, cycle)
    angle, radius = to_polar(track)
    rate, drift = mean_speeds(angle), mean_speeds(radius)
    result: dict[str, Any] = {
        "share_of_limits": usage(rig, cycle).worst,
        "median_of_plate_rad_s": SPIN / 2,
        "falls_off_s": (len(track) - 1) / FREQUENCY,
        "turns": float(angle[-1] / (2 * np.pi)),
        "rate_rad_s": [float(rate[0]), float(rate[-1])],
        "radius_m": [float(radius[0]), float(radius[-1])],
        "drift_mps": [float(drift[0]), float(drift[-1])],
    }
    (folder / "coin.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    draw(track, rate, radius, rig.plate.half).savefig(folder / "coin.png", dpi=110)
    print(json.dumps(result, indent=2))


def plate_motion() -> PlateCycle:
    """Return the plate's rotation back and forth about its centre."""
    return wave_cycle(FREQUENCY, np.array([0.0, 0.0, SPIN]))


def simulate_coin(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return the positions (k, 2) [m] of the coin at the starts of cycles, until it leaves the
    plate."""
    rig = replace(rig, parts=replace(rig.parts, radius_m=COIN_RADIUS))
    state = WorldState.at_rest(("coin",), np.array([[START, 0.0]]))
    track = [state.position[0]]
    while state.on_plate[0] and len(track) < MAX_S * FREQUENCY:
        state = run_cycle(state, cycle, rig)
        track.append(state.position[0])
    return np.array(track)


def to_polar(track: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the polar coordinates of positions (n, 2) [m]: angle [rad] and radius [m]."""
    return np.unwrap(np.arctan2(track[:, 1], track[:, 0])), np.hypot(track[:, 0], track[:, 1])


def mean_speeds(values: np.ndarray) -> np.ndarray:
    """Return the mean angular and radial speeds over intervals of `MEAN` seconds. The result omits
    the first interval."""
    return np.diff(values[MEAN * FREQUENCY :: MEAN * FREQUENCY]) / MEAN


def draw(track: np.ndarray, rate: np.ndarray, radius: np.ndarray, half: np.ndarray) -> Figure:
    """Draw the coin's path on the plate, its angular speed and its radius."""
    mpl.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "font.size": 12})
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    axes = figure.subplot_mosaic([["path", "rate"], ["path", "radius"]], width_ratios=[2.1, 1])
    minutes = np.arange(len(track)) / (60 * FREQUENCY)
    x, y = 1e3 * half
    path = axes["path"]
    path.fill([-x, x, x, -x], [-y, -y, y, y], color="#eeeeee")
    places = 1e3 * track[:: FREQUENCY // 5]
    lines = LineCollection(
        list(np.stack([places[:-1], places[1:]], axis=1)), array=minutes[:: FREQUENCY // 5][:-1],
        cmap="viridis_r", lw=0.9,
    )  # fmt: skip
    path.add_collection(lines)
    figure.colorbar(lines, ax=path, label="time [min]", location="bottom", shrink=0.6, aspect=40)
    angle, _ = to_polar(track)
    first = np.searchsorted(angle, 2 * np.pi - 0.3)
    for centre in [*track[:first][:: round(SHOWN * FREQUENCY)], track[-1]]:
        path.add_patch(
            Circle(1e3 * centre, 1e3 * COIN_RADIUS, fc="#ffffffb0", ec=INK, lw=1, zorder=3)
        )
    path.plot(0, 0, "+", color=INK)
    path.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    path.set_title("First turn every 2 s, and the last coin")
    axes["radius"].plot(minutes, 1e3 * radius, color=COIN)
    axes["radius"].set(ylim=(0, None), title="Radius [mm]", xlabel="time [min]")
    t = MEAN * (np.arange(len(rate)) + 1.5) / 60
    axes["rate"].plot(t, rate, color=COIN)
    axes["rate"].axhline(SPIN / 2, color=INK, ls="--", lw=0.8)
    axes["rate"].text(t[-1], SPIN / 2, "median of the plate's", ha="right", va="bottom", color=INK)
    axes["rate"].set(xlim=axes["radius"].get_xlim(), ylim=(0, 0.62), title="Angular speed [rad/s]")
    return figure


if __name__ == "__main__":
    main()
