"""Parts of a known radius on a bright plate: the cheapest way for each of them.

One that stands alone is measured by moments, the others by a fit that knows of their neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .brightness import fit_brightness
from .fit import fit_discs
from .marks import angles, paint_over
from .measure import RIM_PX, Discs, crowded, measure_alone
from .options import DetectorOptions
from .region import SEAM_PX, Region, usable_pixels
from .seeds import find_seeds

MAX_MISFIT = 0.2
"""Largest deviation of a part from an evenly dark disc."""

BLUR_PX = 1.5
"""Reach [px] of a part's blurred edge: how near a neighbour's pixels may come to a window."""


def find_discs(
    grey: np.ndarray,
    region: Region,
    options: DetectorOptions,
    size: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Discs:
    """Find discs of a known radius: seeds, then measurement, then a check of what was measured.

    Parameters
    ----------
    grey : (H, W) uint8
        Image [grey levels].
    region : Region
        Where the plate is.
    options : DetectorOptions
        What a part looks like.
    size : callable, optional
        Gives for image points (n, 2) [px] the radius there, as a share (n,) of the options'.
    """
    radius = options.radius_px
    light = fit_brightness(grey, region, options.min_plate_grey)
    seeds = np.empty((0, 2))
    if light is not None:
        usable = usable_pixels(region, *grey.shape)
        seeds = find_seeds(grey, region, light, usable, options.threshold, radius)
    if light is None or not len(seeds):
        nothing = np.empty(0)
        return Discs(np.empty((0, 2)), nothing, nothing, nothing, np.empty(0, bool), nothing)
    grey, mark = paint_over(grey, light, seeds, radius)
    shared = crowded(seeds, 2 * radius + RIM_PX + BLUR_PX)
    shared |= region.depth(*seeds.T) - SEAM_PX < radius + RIM_PX + 1
    discs, beside = measure_alone(grey, light, seeds[~shared], radius)
    discs = discs.select(~beside)
    shared[np.flatnonzero(~shared)[beside]] = True
    if np.any(shared):
        discs = discs.join(fit_discs(grey, light, usable, seeds[shared], radius))
    mark = mark[np.argsort(shared, kind="stable")]
    discs = replace(discs, angle=angles(mark, discs.centre))
    expected = np.full(len(discs.radius), radius) if size is None else radius * size(discs.centre)
    return discs.select(np.flatnonzero(_is_part(discs, region, options, expected)))


def _is_part(
    discs: Discs, region: Region, options: DetectorOptions, radius: np.ndarray
) -> np.ndarray:
    """Tell which discs (n,) look like a part on the plate; `radius` (n,) [px] is its there."""
    return (
        (np.abs(discs.radius / radius - 1) <= options.radius_tolerance)
        & (discs.darkness > 1 - options.threshold)
        & (discs.misfit < MAX_MISFIT)
        & (region.depth(*discs.centre.T) >= -options.margin_px)
    )
