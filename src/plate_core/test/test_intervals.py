"""Confidence intervals."""

import tracemalloc

import numpy as np

from plate_core.intervals import of_median


def test_the_interval_of_a_median_is_that_of_one_large_draw_but_needs_less_memory():
    values = np.random.default_rng(1).normal(size=3001).tolist()
    drawn = np.random.default_rng(0).choice(values, (2000, 3001))
    expected = tuple(np.percentile(np.median(drawn, axis=1), (2.5, 97.5)))
    tracemalloc.start()
    found = of_median(values)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found == expected
    assert peak < drawn.nbytes
