"""Runs in parallel, in processes of this machine."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from harness.cache import Cache


@contextmanager
def processes(count: int | None = None) -> Iterator[Executor]:
    """Give an executor of fresh processes, for each core one if not told."""
    with ProcessPoolExecutor(count or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        yield pool


def parallel(
    pool: Executor, run: Callable[..., Any], work: Sequence[tuple], note: Callable[[str], None]
) -> Iterator[Any]:
    """Yield run(*item) of every item of work, in order, as soon as those before are there too.

    Parameters
    ----------
    note : callable
        Takes a line on the progress whenever something is done.
    """
    began = time.monotonic()
    futures = [pool.submit(run, *item) for item in work]
    told = 0
    try:
        for done, _ in enumerate(as_completed(futures), 1):
            elapsed = time.monotonic() - began
            left = elapsed / done * (len(futures) - done)
            note(f"{done} of {len(futures)} done in {elapsed:.0f} s, about {left:.0f} s left")
            while told < len(futures) and futures[told].done():
                yield futures[told].result()
                told += 1
    finally:
        for future in futures:
            future.cancel()


def resumed(
    pool: Executor, run: Callable[..., Any], work: Mapping[str, tuple], cache: Cache
) -> list[Any]:
    """Return run(*item) of every item of work, in order; what is in the cache is not run again.

    Parameters
    ----------
    run : callable
        Gives values that JSON can hold.
    work : mapping of str to tuple
        Key in the cache -> arguments.
    """
    missing = [key for key in work if key not in cache]
    fresh = parallel(pool, run, [work[key] for key in missing], lambda _: None)
    for key, value in zip(missing, fresh, strict=True):
        cache[key] = value
    return [cache[key] for key in work]


def by_case(
    run: Callable[..., Any], cases: Mapping[Any, Sequence[tuple]], cache: Cache,
    workers: int | None = None,
) -> dict[Any, list[Any]]:  # fmt: skip
    """Return run(*item) of every item of every case, by case, on all cores if not told.

    Parameters
    ----------
    run : callable
        As of `resumed`.
    cases : mapping to sequence of tuple
        What the case is, its text being the key in the cache -> arguments of its runs.
    """
    work = {f"{case} {k}": item for case, items in cases.items() for k, item in enumerate(items)}
    with processes(workers) as pool:
        found = iter(resumed(pool, run, work, cache))
    return {case: [next(found) for _ in items] for case, items in cases.items()}
