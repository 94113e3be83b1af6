"""Spread runs over processes of this machine, or over a Dask cluster.

A cluster's scheduler and workers need the same checkout; on each of their machines:

    source env.sh && pip install -r requirements-bench.txt
    PYTHONPATH=bench:$PYTHONPATH dask scheduler                                      # on one
    PYTHONPATH=bench:$PYTHONPATH dask worker tcp://HOST:8786 --nworkers 2 --nthreads 1

What gives different numbers is refused: other sources of ours, other versions of the libraries.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from socket import gethostname
from typing import Any

from plate_core import PlateError

CONNECT_S = 5.0
"""How long a scheduler may take to answer, and to find its first worker [s]."""

SOURCES = (
    "loop", "plate_core", "plate_driver", "plate_planner", "plate_sim", "plate_solver",
    "plate_vision",
)  # fmt: skip
"""What a run consists of: all of it must be the same everywhere."""

LIBRARIES = ("numba", "numpy", "scipy")
"""What decides its numbers besides."""


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Give an executor of `count` fresh processes on this machine."""
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
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


def spread(
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
    pool: Executor, run: Callable[..., dict[str, Any]], work: Sequence[tuple], path: Path,
    modules: tuple[str, ...] = (),
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Yield run(*item) of every item of work, in order; what a file has already is not run again.

    Results are appended to the file as soon as those before are there too, so that a measurement
    that was interrupted goes on where it was. Those of other code count for nothing.

    Parameters
    ----------
    run : callable
        Gives values that JSON can hold.
    path : Path
        Lines of JSON: [code, name of run, arguments, result].
    modules : tuple of str
        What counts as code besides `SOURCES`.
    """
    code = fingerprint(SOURCES + modules)
    known = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            *key, row = json.loads(line)
            known[json.dumps(key)] = row
    keys = [json.dumps([code, run.__name__, list(item)]) for item in work]
    missing = [item for item, key in zip(work, keys, strict=True) if key not in known]
    fresh = spread(pool, run, missing, lambda _: None)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        for item, key in zip(work, keys, strict=True):
            if key not in known:
                known[key] = next(fresh)
                file.write(json.dumps([code, run.__name__, list(item), known[key]]) + "\n")
                file.flush()
            yield known[key]


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


@lru_cache
def fingerprint(names: tuple[str, ...] = SOURCES) -> str:
    """Return what decides a run's numbers: versions, and a digest of our sources."""
    digest = hashlib.sha256()
    for name in names:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(f"no module {name}")
        origin = Path(spec.origin)
        files = sorted(origin.parent.rglob("*.py")) if origin.stem == "__init__" else [origin]
        for file in files:
            digest.update(file.relative_to(origin.parent).as_posix().encode() + file.read_bytes())
    versions = [f"{name} {version(name)}" for name in LIBRARIES]
    return ", ".join([f"sources {digest.hexdigest()[:12]}", *versions])
