"""Runs in parallel: in processes of this machine, or on a Dask cluster.

A cluster's scheduler and workers need the same checkout; on each of their machines:

    source env.sh && pip install -r requirements-bench.txt
    PYTHONPATH=bench:$PYTHONPATH dask scheduler                                      # on one
    PYTHONPATH=bench:$PYTHONPATH dask worker tcp://HOST:8786 --nworkers 2 --nthreads 1

What gives different numbers is refused: other sources of ours, other versions of the libraries.
"""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from importlib.metadata import version
from multiprocessing import get_context
from socket import gethostname
from typing import Any

from harness.cache import Cache, code_of_packages
from plate_core import PlateError

CONNECT_S = 5.0
"""How long a scheduler may take to answer, and to find its first worker [s]."""

LIBRARIES = ("numpy", "scipy")
"""What decides a run's numbers besides our own sources."""


@contextmanager
def processes(count: int | None = None) -> Iterator[Executor]:
    """Give an executor of fresh processes on this machine, for each core one if not told."""
    with ProcessPoolExecutor(count or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        yield pool


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Give an executor of the Dask cluster whose scheduler has an address.

    Raises
    ------
    PlateError
        If Dask is not installed, or no scheduler with workers is found there in `CONNECT_S`.
    """
    try:
        from distributed import Client
    except ImportError:
        raise PlateError(
            "a scheduler needs Dask, which is not installed, expected: "
            "pip install -r requirements-bench.txt"
        ) from None
    allowed = "allowed: the address of a running `dask scheduler`, such as tcp://HOST:8786"
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:  # TimeoutError is an OSError
        reason = str(error).splitlines()[0]
        raise PlateError(f"scheduler is {address!r}: no answer ({reason}), {allowed}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise PlateError(f"scheduler {address!r} has no workers, allowed: 1 or more") from None
        with client.get_executor(pure=False) as pool:
            yield pool


def parallel(
    pool: Executor, run: Callable[..., Any], work: Sequence[tuple], note: Callable[[str], None]
) -> Iterator[Any]:
    """Yield run(*item) of every item of work, in order, as soon as those before are there too.

    Parameters
    ----------
    note : callable
        Takes a line on the progress whenever something is done.

    Raises
    ------
    PlateError
        If a run is refused, or a worker has not the same code as we have.
    """
    began, mark = time.monotonic(), fingerprint()
    futures = [pool.submit(_checked, mark, pickle.dumps((run, item))) for item in work]
    told = 0
    try:
        for done, _ in enumerate(as_completed(futures), 1):
            elapsed = time.monotonic() - began
            left = elapsed / done * (len(futures) - done)
            note(f"{done} of {len(futures)} done in {elapsed:.0f} s, about {left:.0f} s left")
            while told < len(futures) and futures[told].done():
                yield _result(futures[told])
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


def _result(future: Future) -> Any:
    try:
        return future.result()
    except Exception as error:
        missing = next((e for e in (error, error.__cause__) if isinstance(e, ImportError)), None)
        if missing is None:
            raise
        raise PlateError(
            f"scheduler or workers lack code ({missing}), expected: the same checkout there, "
            "source env.sh, and bench in PYTHONPATH"
        ) from None


def _checked(mark: str, task: bytes) -> Any:
    """Run on a worker, if it has the same code; only then is the task looked at."""
    if fingerprint() != mark:
        raise PlateError(
            f"worker on {gethostname()} has other code ({fingerprint()}) than we have ({mark}), "
            "allowed: the same checkout and the same versions"
        )
    run, item = pickle.loads(task)
    return run(*item)


def fingerprint() -> str:
    """Return what decides a run's numbers: versions, and a digest of our sources."""
    versions = [f"{name} {version(name)}" for name in LIBRARIES]
    return ", ".join([f"sources {code_of_packages()}", *versions])
