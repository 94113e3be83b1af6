"""Parallel runs by any `concurrent.futures.Executor`: processes on this computer, or a cluster."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext
from multiprocessing import get_context
from typing import Any

from harness.cache import Cache
from plate_bringup.cluster import Cluster

_cluster: list[Executor] = []
"""The cluster of `on_cluster`, in its context."""


def cluster_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--cluster` to a command line."""
    text = "address of a Dask scheduler, such as tcp://192.168.0.10:8786 (this computer)"
    parser.add_argument("--cluster", default="", metavar="ADDRESS", help=text)


def executor(workers: int | None = None) -> Executor:
    """Return an executor of new processes on this computer. Default: one for each core."""
    return ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn"))


@contextmanager
def on_cluster(address: str) -> Iterator[None]:
    """Let `by_case` run on a cluster in this context. If the address is empty, it runs on this
    computer."""
    if not address:
        yield
        return
    with Cluster(address, bench=True) as pool:
        _cluster.append(pool)
        try:
            yield
        finally:
            _cluster.clear()


def parallel(
    pool: Executor,
    run: Callable[..., Any],
    work: Sequence[tuple],
    note: Callable[[str], None] = lambda text: None,
) -> Iterator[tuple[int, Any]]:
    """Yield the index of an item of work and run(*item), for each item as soon as it is done.

    If a run raises an error, the runs that have not begun are canceled, and the error is raised
    after the others. If the caller stops early, the rest is canceled.

    Parameters
    ----------
    note : callable
        Receives a line on the progress with each result.
    """
    began, count, problem = time.monotonic(), 0, None
    runs = {pool.submit(run, *item): k for k, item in enumerate(work)}
    try:
        for done in as_completed(runs):
            if done.cancelled():
                continue
            if failed := done.exception():
                problem = problem or failed
                for other in runs:
                    other.cancel()
                continue
            count += 1
            elapsed = time.monotonic() - began
            left = elapsed / count * (len(work) - count)
            note(f"{count} of {len(work)} done in {elapsed:.0f} s, about {left:.0f} s left")
            yield runs[done], done.result()
    finally:
        for other in runs:
            other.cancel()
    if problem is not None:
        raise problem


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
    for k, value in parallel(pool, run, [work[key] for key in missing]):
        cache[missing[k]] = value
    return [cache[key] for key in work]


def by_case(
    run: Callable[..., Any], cases: Mapping[Any, Sequence[tuple]], cache: Cache,
    workers: int | None = None,
) -> dict[Any, list[Any]]:  # fmt: skip
    """Return run(*item) for every item of every case, by case. Default: on all cores, or on the
    cluster of `on_cluster`. If `workers` is given, that number of processes on this computer.

    Parameters
    ----------
    run : callable
        As in `resumed`.
    cases : mapping to sequence of tuple
        Arguments of the runs, by case. The text of a case is part of the key in the cache.
    """
    work = {f"{case} {k}": item for case, items in cases.items() for k, item in enumerate(items)}
    shared = nullcontext(_cluster[0]) if _cluster and workers is None else executor(workers)
    with shared as pool:
        found = iter(resumed(pool, run, work, cache))
    return {case: [next(found) for _ in items] for case, items in cases.items()}
