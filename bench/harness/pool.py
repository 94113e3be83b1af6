"""Parallel runs by any `concurrent.futures.Executor`, such as processes on this computer."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from harness.cache import Cache


def executor(workers: int | None = None) -> Executor:
    """Return an executor of new processes on this computer. Default: one for each core."""
    return ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn"))


def parallel(
    pool: Executor, run: Callable[..., Any], work: Sequence[tuple], note: Callable[[str], None]
) -> Iterator[Any]:
    """Yield run(*item) for every item of work, in order. If the caller stops early, the rest is
    canceled.

    Parameters
    ----------
    note : callable
        Receives a line on the progress with each result.
    """
    began = time.monotonic()
    for done, result in enumerate(pool.map(run, *zip(*work, strict=True)), 1):
        elapsed = time.monotonic() - began
        left = elapsed / done * (len(work) - done)
        note(f"{done} of {len(work)} done in {elapsed:.0f} s, about {left:.0f} s left")
        yield result


def resumed(
    pool: Executor, run: Callable[..., Any], work: Mapping[str, tuple], cache: Cache
) -> list[Any]:
    """Return run(*item) for every item of work, in order. A cached item is not run again.

    Parameters
    ----------
    run : callable
        Returns values that JSON can represent.
    work : mapping of str to tuple
        Arguments, by key in the cache.
    """
    missing = [key for key in work if key not in cache]
    fresh = pool.map(run, *zip(*(work[key] for key in missing), strict=True))
    for key, value in zip(missing, fresh, strict=True):
        cache[key] = value
    return [cache[key] for key in work]


def by_case(
    run: Callable[..., Any], cases: Mapping[Any, Sequence[tuple]], cache: Cache,
    workers: int | None = None,
) -> dict[Any, list[Any]]:  # fmt: skip
    """Return run(*item) for every item of every case, by case. Default: on all cores.

    Parameters
    ----------
    run : callable
        As in `resumed`.
    cases : mapping to sequence of tuple
        Arguments of the runs, by case. The text of a case is part of the key in the cache.
    """
    work = {f"{case} {k}": item for case, items in cases.items() for k, item in enumerate(items)}
    with executor(workers) as pool:
        found = iter(resumed(pool, run, work, cache))
    return {case: [next(found) for _ in items] for case, items in cases.items()}
