"""Stability maps: borders between success and failure of the methods, measured and by theory."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from harness import Cache, Result, rounded
from maps import gamma, harmonics, separation, stick, suspension
from maps.grid import Grid, StabilityMap, crossing

MAPS: dict[str, StabilityMap] = {
    module.MAP.key: module.MAP for module in (separation, harmonics, gamma, stick, suspension)
}
"""All maps by their keys. The file `maps/KEY.py` defines the map KEY."""


def measure(quick: bool) -> Result:
    """Measure all maps."""
    samples, sentences = [], []
    for stability_map in MAPS.values():
        found = grids(stability_map, quick, Cache.of(f"maps.{stability_map.key}"))
        samples += [{"map": stability_map.key, **row} for grid in found for row in grid.rows]
        sentences.append(f"{stability_map.title}. {border_sentence(stability_map, found)}")
    return Result([], sentences, samples)


def grids(stability_map: StabilityMap, quick: bool, cache: Cache) -> list[Grid]:
    """Return a map's grids from the cache. If the cache does not contain them, measure the
    grids."""
    key = f"{stability_map.key}, quick" if quick else stability_map.key
    if key not in cache:
        cache[key] = rounded([asdict(grid) for grid in stability_map.measure(quick)])
    return [Grid(**grid) for grid in cache[key]]


def borders(stability_map: StabilityMap, grid: Grid) -> tuple[list[float], list[float]]:
    """Return y of the measured and of the predicted border for each x. NaN if there is no border at
    this x."""
    position = np.log(grid.y) if "y" in stability_map.log else np.array(grid.y)
    columns = np.array(grid.z, dtype=float).T
    observed = [
        crossing(position.tolist(), column.tolist(), stability_map.level) for column in columns
    ]
    if "y" in stability_map.log:
        observed = np.exp(observed).tolist()
    along = np.log if "x" in stability_map.log else np.asarray
    predicted = np.interp(along(grid.x), along(grid.line_x), grid.line_y, left=np.nan, right=np.nan)
    return observed, predicted.tolist()


def border_sentence(stability_map: StabilityMap, found: list[Grid]) -> str:
    """Return a sentence on the difference between the measured and the predicted borders."""
    places = [pair for grid in found for pair in zip(*borders(stability_map, grid), strict=True)]
    pairs = [pair for pair in places if np.all(np.isfinite(pair))]
    if not pairs:
        return "No border is measured where one is predicted."
    off = np.abs(np.log([o / p for o, p in pairs]))
    return (
        f"Measured and theoretical border differ by {100 * np.expm1(np.median(off)):.0f} % "
        f"(median), at most {100 * np.expm1(np.max(off)):.0f} %."
    )
