"""95 % confidence intervals of a success rate (Wilson) and of a median (bootstrap)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["of_median", "of_rate", "rate_text"]

RESAMPLES = 2000
"""Number of random resamples for the interval of a median."""

MAX_DRAWN = 1_000_000
"""Maximum number of values that are drawn at the same time."""


def of_rate(good: int, runs: int) -> tuple[float, float]:
    """Return the Wilson interval of the fraction of successful runs, 0 to 1."""
    # SciPy is imported here, because the import takes half a second
    from scipy.stats import binomtest

    found = binomtest(good, runs).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def of_median(values: Sequence[float]) -> tuple[float, float]:
    """Return the bootstrap interval of a median, computed from random resamples with a fixed
    seed."""
    rng, drawn_from, count = np.random.default_rng(0), np.asarray(values), len(values)
    # A few resamples at a time need little memory. The random numbers are the same.
    sizes = np.diff([*range(0, RESAMPLES, max(1, MAX_DRAWN // count)), RESAMPLES])
    medians = [np.median(rng.choice(drawn_from, (size, count)), axis=1) for size in sizes]
    low, high = np.percentile(np.concatenate(medians), (2.5, 97.5))
    return float(low), float(high)


def rate_text(good: int, runs: int) -> str:
    """Return a text with the number of successful runs and the interval of their fraction."""
    low, high = of_rate(good, runs)
    return f"{good} of {runs} ({100 * low:.0f} to {100 * high:.0f} %)"
