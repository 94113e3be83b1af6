"""Parallel runs on many machines. A Dask scheduler distributes the runs to its workers.

`Cluster` has the interface of a pool of processes. Before a worker receives runs, it is compared
with this process. The worker must give the same results to the last bit.
"""

from __future__ import annotations

import asyncio
import ctypes
import hashlib
import importlib
import os
import pickle
import platform
import sys
import threading
import uuid
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import suppress
from functools import lru_cache, partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from plate_core import PlateError, config_path
from plate_solver import METHODS

from .loop import ALIKE, Setup, run

__all__ = ["Cluster", "code_of", "code_of_packages", "differences", "facts"]

PACKAGES = (
    "bringup", "core", "driver", "feeder", "native", "planner", "sim", "solver", "vision",
)  # fmt: skip
"""Packages `plate_*` on which every run depends."""

LIBRARIES = ("numpy", "scipy", "cv2", "shapely")
"""Modules whose versions can change a result."""

INSTALL = "pip install 'distributed==2026.8.0'"
"""Command that installs Dask, in the version of requirements-test.txt."""

CONNECT_S = 5.0
"""Maximum time for the connection to the scheduler [s]."""

RETURN_S = 60.0
"""Maximum time for the return of a lost scheduler [s]."""

POLL_S = 0.5
"""Interval between two searches for new workers [s]."""

FIRST_S = 60.0
"""Maximum time for the comparison of the first workers [s]."""

STOP_S = 5.0
"""Maximum time for each step when the cluster is closed [s]."""

TRIAL, TRIAL_CYCLES = "sort_4", 4
"""Scenario and number of its cycles that each worker runs for the comparison."""

REQUIRED = ("avx2", "fma")
"""Features of a processor. If a processor has them, the variables `ALIKE` give the same results."""


class Cluster(Executor):
    """Executor that runs functions on the workers of a Dask scheduler.

    Each worker process executes one run at a time. If a worker dies, other workers repeat its runs.
    If the scheduler restarts within `RETURN_S`, unfinished runs are sent to it again. Workers can
    join at any time.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as `tcp://192.168.0.10:8786`.
    bench : bool
        Whether the functions are in `bench` or `tools` of the clone. If so, each worker must have a
        clone with the same code. The place of the clone does not matter, unless arguments contain
        absolute paths.
    modules : sequence of str
        Further modules and packages that each worker must have with the same code.
    tell : callable
        Function that receives lines of text about the cluster: its dashboard, and refused workers.
    end : callable, optional
        Called by `shutdown` on each worker that has a run, to end this run. By default, an
        exception is raised in the thread of the run.

    Raises
    ------
    PlateError
        If Dask is missing, if the scheduler does not answer or has another version, or if all
        workers would give other results.
    """

    def __init__(
        self,
        address: str,
        bench: bool = False,
        modules: Sequence[str] = (),
        tell: Callable[[str], None] = lambda text: print(text, file=sys.stderr, flush=True),
        end: Callable[[], object] | None = None,
    ) -> None:
        self._address, self._tell, self._end = address, tell, end
        self._client = _connect(address)
        if bench:
            _make_bench_importable()
        self._terms = facts(bench, tuple(modules)), bench, tuple(modules)
        # Only workers with this resource receive runs. Each worker has the resource once.
        self._key = f"plate-{hashlib.sha256(repr(self._terms).encode()).hexdigest()[:16]}"
        self._pool = self._client.get_executor(pure=False, resources={self._key: 1})
        self._token = uuid.uuid4().hex
        self._calls: dict[Future[Any], tuple[Any, ...]] = {}
        self._sent: dict[Future[Any], Future[Any]] = {}
        self._lost: set[Future[Any]] = set()
        self._asked: dict[str, str] = {}
        self._admitted: list[str] = []
        self._ending, self._waits = threading.Event(), False
        served = "dashboard" in self._identity()["services"]
        tell(f"cluster {address}, " + (self._client.dashboard_link if served else "no dashboard"))
        try:
            self._await_workers()
        except BaseException:
            self.shutdown()
            raise
        threading.Thread(target=self._watch, daemon=True).start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a run, see `Executor`. A run that has begun can also be canceled. Its result is
        then dropped, but it continues on its worker until it ends or `shutdown` ends it."""
        result: Future[Any] = Future()
        # The run is sent as bytes, because the scheduler also reads arguments and cannot import
        # modules of bench.
        from distributed.protocol.pickle import dumps

        self._calls[result] = (_work, self._token, dumps((fn, args, kwargs)))
        result.add_done_callback(self._forget)
        self._send(result)
        return result

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """Cancel all unfinished runs, end the runs that workers have begun, and disconnect."""
        if self._ending.is_set():
            return
        self._ending.set()
        for result in list(self._calls):
            result.cancel()
        stopped = threading.Thread(target=self._stop_runs, daemon=True)
        stopped.start()
        stopped.join(STOP_S)
        self._client.close(timeout=STOP_S)

    def _stop_runs(self) -> None:
        if self._admitted and self._client.status == "running":
            call = (_stop, self._token, self._end)
            self._client.run(*call, workers=self._admitted, on_error="ignore")

    def _send(self, result: Future[Any]) -> None:
        """Send a run to the scheduler."""
        if (call := self._calls.get(result)) is None:
            return
        try:
            sent = self._pool.submit(*call)
        except Exception as problem:
            if not self._lose(result):
                raise PlateError(f"cluster {self._address}: {_text(problem)}") from problem
            return
        self._sent[result] = sent
        sent.add_done_callback(partial(self._take, result))
        if result.done():  # the run was canceled in the meantime
            self._release(result)

    def _take(self, result: Future[Any], sent: Future[Any]) -> None:
        """Pass on the outcome of a run. If the run was lost with the scheduler, do nothing."""
        if sent.cancelled():
            self._lose(result)
            return
        problem = sent.exception()
        if type(problem).__name__ == "KilledWorker":
            problem = PlateError(f"a run has ended several workers: {problem}")
        with suppress(InvalidStateError):  # raised if the run was canceled in the meantime
            if problem is None:
                result.set_result(sent.result())
            else:
                result.set_exception(problem)

    def _lose(self, result: Future[Any]) -> bool:
        """Record that a run must be sent again. Return whether this is possible."""
        if self._client.status == "closed":
            return False
        if not result.done():
            self._lost.add(result)
        return True

    def _forget(self, result: Future[Any]) -> None:
        del self._calls[result]
        self._lost.discard(result)
        self._release(result)
        if result.cancelled():
            result.set_running_or_notify_cancel()

    def _release(self, result: Future[Any]) -> None:
        """Cancel a run, if it has not ended, and let the cluster forget its outcome. A worker that
        dies would otherwise cause its repetition."""
        if (sent := self._sent.pop(result, None)) is not None:
            sent.cancel()

    def _watch(self) -> None:
        """Compare each new worker with this process, and send lost runs again."""
        while not self._ending.wait(POLL_S):
            if self._client.status == "closed":
                away = f"cluster {self._address}: the scheduler was away for {RETURN_S:g} s"
                for result in list(self._calls):
                    with suppress(InvalidStateError):
                        result.set_exception(PlateError(away))
                return
            with suppress(Exception):  # the connection is lost
                if self._client.status == "running":
                    self._ask_new()
                    for result in list(self._lost):
                        self._lost.discard(result)
                        self._send(result)

    def _await_workers(self) -> None:
        """Wait until the first worker is accepted. Return also if there are no workers.

        Raises
        ------
        PlateError
            If all workers are refused.
        """
        for _ in range(int(FIRST_S / POLL_S)):
            count = self._ask_new()
            if self._admitted:
                return
            if not count:
                return
            if self._waits:
                raise PlateError(f"cluster {self._address}: all {count} workers are refused")
            self._ending.wait(POLL_S)

    def _ask_new(self) -> int:
        """Start the comparison of each new worker. Report if no worker is left. Return the number
        of workers."""
        workers = self._identity()["workers"]
        self._admitted = [name for name, one in workers.items() if self._key in one["resources"]]
        for name in set(self._asked) - set(workers):
            self._asked.pop(name, None)
        for name in set(workers) - set(self._asked) - set(self._admitted):
            self._asked[name] = ""
            threading.Thread(target=self._ask, args=(name,), daemon=True).start()
        if self._waits != (waits := not self._admitted and all(self._asked.values())):
            self._waits = waits
            if waits:
                refused = f"; all {len(workers)} are refused" if workers else ""
                self._tell(f"waiting for workers{refused}")
        return len(workers)

    def _identity(self) -> Any:
        """Return facts about the scheduler and its workers. `Client.scheduler_info` sometimes lists
        no workers, because Dask's own periodic query replaces its result."""
        return self._client.sync(self._client.scheduler.identity, n_workers=-1)

    def _ask(self, name: str) -> None:
        """Compare a worker with this process. Afterwards the worker has the resource, or it is
        refused."""
        try:
            call = (_admit, self._key, *self._terms)
            found = self._client.run(*call, workers=[name], on_error="return")[name]
        except Exception as problem:  # the worker or the scheduler is lost
            found = OSError(problem)
        if isinstance(found, OSError):
            self._asked.pop(name, None)
            return
        if isinstance(found, BaseException):
            found = [_text(found)]
        if found:
            self._asked[name] = "; ".join(found)
            self._tell(f"worker {name} is refused: {self._asked[name]}")


def _connect(address: str) -> Any:
    """Return a client of Dask.

    Raises
    ------
    PlateError
        If Dask is missing, or if the scheduler does not answer or has another version.
    """
    try:
        import distributed
    except ImportError as problem:
        raise PlateError(f"cluster is {address!r}, which requires Dask: {INSTALL}") from problem
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Dask warns of other versions; they are refused here
        try:
            with distributed.Client(address, timeout=CONNECT_S, set_as_default=False) as client:
                there = client.get_versions()["scheduler"]["packages"]["distributed"]
        except Exception as problem:
            raise PlateError(
                f"cluster is {address!r}, where no Dask scheduler answers within {CONNECT_S:g} s "
                f"({_text(problem)}), allowed: the address that `dask scheduler` prints"
            ) from problem
        if there != distributed.__version__:
            raise PlateError(
                f"cluster {address}: the scheduler's package `distributed` has version {there}, "
                f"allowed: {distributed.__version__} (the version on this computer)"
            )
        return distributed.Client(address, timeout=RETURN_S, set_as_default=False)


def _text(problem: BaseException) -> str:
    return " ".join(f"{type(problem).__name__}: {problem}".split())


# Functions that run on the workers


_RUNNING: dict[str, int] = {}
"""Threads of the present runs of this worker, by the token of their `Cluster`."""


class _Stopped(Exception):
    """Raised in a run that `shutdown` ends."""


def _work(token: str, call: bytes) -> Any:
    """Run a function so that `_stop` can end it, which `shutdown` calls."""
    _RUNNING[token] = threading.get_ident()
    try:
        function, args, kwargs = pickle.loads(call)
        return function(*args, **kwargs)
    finally:
        _RUNNING.pop(token, None)


def _stop(token: str, end: Callable[[], object] | None) -> None:
    """End the present run of a `Cluster` on this worker."""
    if (thread := _RUNNING.get(token)) is None:
        return
    if end is not None:
        end()
    else:
        raised = ctypes.py_object(_Stopped)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), raised)


async def _admit(
    key: str, expected: dict[str, str], bench: bool, modules: tuple[str, ...], dask_worker: Any
) -> list[str]:
    """Compare this worker with another process. If it would give the same results, give it the
    resource `key`. Return the differences."""
    if bench:
        _make_bench_importable()
    found = differences(expected, await asyncio.to_thread(facts, bench, modules))
    if not found and key not in dask_worker.state.total_resources:
        status = type(dask_worker.status)
        running = dask_worker.status == status.running
        if running:
            dask_worker.status = status.paused
        await dask_worker.set_resources(**{key: 1})
        if running:  # the scheduler then sends waiting runs to this worker
            dask_worker.status = status.running
    return found


# Functions that run on both sides


def differences(expected: dict[str, str], found: dict[str, str]) -> list[str]:
    """Return a text for each fact that differs."""
    return [
        f"{name} is {found.get(name)!r}, allowed: {expected.get(name)!r}"
        for name in expected | found
        if expected.get(name) != found.get(name)
    ]


@lru_cache
def facts(bench: bool = False, modules: tuple[str, ...] = ()) -> dict[str, str]:
    """Return facts about this process that determine the results of a seed.

    The facts are the versions of Python, C library and `LIBRARIES`, the environment variables of
    `ALIKE`, the processor, digests of the code, and a digest of the first cycles of short runs. If
    `bench`, they include a digest of `bench` and `tools` of the clone.
    """
    found = {
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "C library": " ".join(platform.libc_ver()),
    }
    for name in LIBRARIES:
        found[name] = str(importlib.import_module(name).__version__)
    found |= {name: os.environ.get(name, "") for name in ALIKE}
    found["processor"] = _processor(ALIKE.items() <= os.environ.items())
    found["code of the packages"] = code_of_packages()
    found |= {f"code of {name}": code_of(name) for name in modules}
    if bench:
        found["code of bench"] = _code_of_bench()
    found["first cycles"] = _first_cycles()
    return found


def _processor(alike: bool) -> str:
    """Return the model of the processor. If only the required features determine the results,
    return these features."""
    lines = [line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines()]
    about = {name.strip(): value.strip() for name, _, value in reversed(lines)}
    if alike and set(REQUIRED) <= set(about.get("flags", "").split()):
        return f"{platform.machine()} with {', '.join(REQUIRED)}"
    keys = ("vendor_id", "cpu family", "model", "model name")
    return " ".join([platform.machine(), *(about.get(key, "") for key in keys)]).strip()


@lru_cache
def code_of_packages() -> str:
    """Return a digest of `PACKAGES`, with their kernels and the configuration."""
    return code_of(*(f"plate_{name}" for name in PACKAGES))


def code_of(*modules: str) -> str:
    """Return a digest of the sources of modules or packages, including their kernels. The digest of
    `plate_core` includes its configuration."""
    mark = hashlib.sha256()
    for name in modules:
        try:
            spec = find_spec(name)
        except ValueError:  # raised for names such as __main__
            spec = None
        if spec is None or spec.origin is None:
            return f"no module {name}"
        origin = Path(spec.origin)
        if spec.submodule_search_locations is not None:
            _digest(mark, origin.parent, name)
        else:
            mark.update(origin.read_bytes())
        if name == "plate_core":
            _digest(mark, config_path("rig.yaml").parent, "config")
    return mark.hexdigest()[:16]


def _digest(mark: Any, place: Path, name: str) -> None:
    """Add the sources in a folder to a digest."""
    for path in sorted(place.rglob("*")):
        if path.suffix in (".py", ".hpp", ".cpp", ".yaml"):
            mark.update(f"{name}/{path.relative_to(place).as_posix()}\n".encode())
            mark.update(path.read_bytes())


def _code_of_bench() -> str:
    """Return a digest of `bench` and `tools` of the clone from which this package was installed."""
    clone = _clone()
    if clone is None:
        return "no clone"
    mark = hashlib.sha256()
    for name in ("bench", "tools"):
        _digest(mark, clone / name, name)
    return mark.hexdigest()[:16]


def _make_bench_importable() -> None:
    """Add `bench` of the clone, if there is one, to the folders from which modules are imported."""
    clone = _clone()
    if clone is not None and str(clone / "bench") not in sys.path:
        sys.path.append(str(clone / "bench"))


def _clone() -> Path | None:
    """Return the clone from which this package was installed. None if there is none."""
    parents = Path(__file__).resolve().parents
    return next((folder for folder in parents if (folder / "bench/harness").is_dir()), None)


def _first_cycles() -> str:
    """Return a digest of the first cycles of the scenario `TRIAL` by each method."""
    mark = hashlib.blake2b(digest_size=8)
    for method in dict.fromkeys(METHODS.values()):
        for moment in islice(run(Setup(TRIAL, method=method)), TRIAL_CYCLES):
            cycle = moment.answer.cycle
            for knots in (cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel):
                mark.update(knots.tobytes())
            mark.update(moment.world.position.tobytes())
    return mark.hexdigest()
