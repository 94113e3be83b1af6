"""The coin experiment (section 5 of the paper): out/coin/coin.png and coin.json.

python bench/coin.py [--out FOLDER]

The plate turns about its centre, to and fro, not alike in both senses. A coin is carried around at
a constant rate, and slowly outwards, as a point part beside it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from harness import ROOT
from matplotlib.figure import Figure

from plate_core import PlateCycle, load_rig
from plate_core.limits import usage
from plate_sim import simulate
from plate_sim.bodies import simulate_bodies
from plate_sim.footprint import disc

FREQUENCY, SPIN = 25.0, 1.05
"""Of the plate: theta' = SPIN (sin wt + cos(2 wt) / 2) [Hz], [rad/s]; within the rig's limits."""

COIN_RADIUS = 9.525e-3
"""Of a 1 cent coin [m]."""

START, SECONDS = 0.08, 60
"""Where the coin begins [m], and for how long it is watched [s]."""

COIN, POINT = "#0b6e99", "#d1651e"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "out/coin")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    rig, cycle = load_rig(), plate_motion()
    mu, gravity = rig.friction.mu, rig.friction.gravity
    start, still, count = np.array([[START, 0.0]]), np.zeros((1, 2)), round(SECONDS * FREQUENCY)
    coin = simulate_bodies(
        cycle, disc(COIN_RADIUS), start, 0, still, 0, mu, gravity, cycles=count, samples=4
    )
    point = simulate(cycle, start, still, mu, gravity, count, 4, 1e-7)
    tracks = {"coin": coin.position[::4, 0], "point": point.position[::4, 0]}
    result: dict[str, Any] = {"share_of_limits": usage(rig, cycle).worst, "median_rad_s": SPIN / 2}
    for name, track in tracks.items():
        angle, radius = polar(track)
        late = len(angle) // 60
        rate = np.diff(angle[late::25]) / (25 / FREQUENCY)
        result[name] = {
            "rate_rad_s": [float(rate[0]), float(rate[-1])],
            "radius_m": [float(radius[0]), float(radius[-1])],
        }
    (folder / "coin.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    draw(tracks, rig.plate.half).savefig(folder / "coin.png", dpi=130)
    print(json.dumps(result, indent=2))


def plate_motion() -> PlateCycle:
    """Return the plate's turning to and fro about its centre."""
    t = np.arange(256) / (256 * FREQUENCY)
    w = 2 * np.pi * FREQUENCY
    pose, twist, accel = np.zeros((3, 256, 3))
    pose[:, 2] = SPIN / w * (-np.cos(w * t) + 0.25 * np.sin(2 * w * t))
    twist[:, 2] = SPIN * (np.sin(w * t) + 0.5 * np.cos(2 * w * t))
    accel[:, 2] = SPIN * w * (np.cos(w * t) - np.sin(2 * w * t))
    return PlateCycle.from_samples(1 / FREQUENCY, pose, twist, accel)


def polar(track: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return angle [rad] and radius [m] of places (n, 2)."""
    return np.unwrap(np.arctan2(track[:, 1], track[:, 0])), np.hypot(track[:, 0], track[:, 1])


def draw(tracks: dict[str, np.ndarray], half: np.ndarray) -> Figure:
    """Draw the coin's path on the plate, its angle and its radius."""
    mpl.use("agg")
    mpl.rcParams.update({"axes.spines.top": False, "axes.spines.right": False})
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    path, turns, radii = figure.subplots(1, 3, width_ratios=[1.9, 1, 1])
    x, y = 1e3 * half
    path.fill([-x, x, x, -x], [-y, -y, y, y], color="#eeeeee")
    track = 1e3 * tracks["coin"]
    path.plot(*track.T, color=COIN, lw=0.8)
    for at in track[:: round(2 * FREQUENCY)][:6]:
        path.add_patch(mpl.patches.Circle(at, 1e3 * COIN_RADIUS, fill=False, color=COIN, lw=0.8))
    path.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="Coin, every 2 s at first")
    for name, style in (("coin", "-"), ("point", "--")):
        angle, radius = polar(tracks[name])
        t = np.arange(len(angle)) / FREQUENCY
        colour = COIN if name == "coin" else POINT
        turns.plot(t, angle / (2 * np.pi), style, color=colour, label=name)
        radii.plot(t, 1e3 * radius, style, color=colour, label=name)
    turns.set(xlabel="time [s]", title="Turns: constant rate")
    radii.set(xlabel="time [s]", title="Radius [mm]: outwards")
    turns.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
