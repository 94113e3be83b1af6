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

from graph.forks import end_with_parent

from harness.cache import Cache
from plate_bringup.cluster import Cluster

_cluster: list[Executor] = []
"""The cluster during the context of `on_cluster`. Otherwise empty."""


def cluster_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--cluster` to a command line."""
    text = "run on the workers of the Dask scheduler at this address, such as "
    text += "tcp://192.168.0.10:8786 (default: run on this computer)"
    parser.add_argument("--cluster", default="", metavar="ADDRESS", help=text)


def executor(workers: int | None = None) -> Executor:
    """Return an executor of new processes on this computer. Default: one process for each core. The
    processes also end if this process is killed."""
    count, context = workers or os.cpu_count(), get_context("spawn")
    return ProcessPoolExecutor(count, context, end_with_parent, (os.getpid(),))


@contextmanager
def on_cluster(address: str) -> Iterator[None]:
    """Context in which `by_case` runs its work on a cluster. If the address is empty, `by_case`
    runs it on this computer."""
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
    """Call run(*item) for each item of work. Yield the item's index and the result as soon as the
    call is done.

    If a call raises an error, the calls that have not begun are canceled. The error is raised when
    the calls that have begun are done. If the caller stops the iteration, the calls that have not
    begun are canceled.

    Parameters
    ----------
    note : callable
        Function that receives a text on the progress with each result.
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
            note(f"{count} of {len(work)} runs done in {elapsed:.0f} s, about {left:.0f} s left")
            yield runs[done], done.result()
    finally:
        for other in runs:
            other.cancel()
    if problem is not None:
        raise problem


def resumed(
    pool: Executor, run: Callable[..., Any], work: Mapping[str, tuple], cache: Cache
) -> list[Any]:
    """Return run(*item) for every item of work, in order. An item whose result is in the cache is
    not run again.

    Parameters
    ----------
    run : callable
        Function that returns values that JSON can represent.
    work : mapping of str to tuple
        Arguments of each call, by the key of its result in the cache.
    """
    missing = [key for key in work if key not in cache]
    for k, value in parallel(pool, run, [work[key] for key in missing]):
        cache[missing[k]] = value
    return [cache[key] for key in work]


def by_case(
    run: Callable[..., Any], cases: Mapping[Any, Sequence[tuple]], cache: Cache,
    workers: int | None = None,
) -> dict[Any, list[Any]]:  # fmt: skip
    """Return the results of run(*item) for all items of all cases, by case. By default, the calls
    run on all cores, or on the cluster of `on_cluster`. If `workers` is given, they run in that
    number of processes on this computer.

    Parameters
    ----------
    run : callable
        As in `resumed`.
    cases : mapping to sequence of tuple
        Arguments of the calls, by case. The name of the case, converted to text, is part of the key
        in the cache.
    """
    work = {f"{case} {k}": item for case, items in cases.items() for k, item in enumerate(items)}
    shared = nullcontext(_cluster[0]) if _cluster and workers is None else executor(workers)
    with shared as pool:
        found = iter(resumed(pool, run, work, cache))
    return {case: [next(found) for _ in items] for case, items in cases.items()}
