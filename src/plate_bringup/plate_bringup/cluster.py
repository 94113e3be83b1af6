"""Parallel runs on several computers. A Dask scheduler distributes the runs to its workers.

`Cluster` has the interface of a pool of processes. A worker receives runs only if it produces
bit-identical results. Therefore the code, libraries and processor of the worker must agree with
those of this process.
"""

from __future__ import annotations

import asyncio
import ctypes
import hashlib
import pickle
import socket
import sys
import threading
import time
import traceback
import uuid
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import suppress
from typing import Any

from plate_core import PlateError

from .identity import clone, differences, facts

__all__ = ["Cluster"]

INSTALL = "pip install 'distributed==2026.8.0'"
"""Command that installs Dask, in the version of requirements-test.txt."""

ADDRESS = "the address after `Scheduler at:` in the output of `dask scheduler` (not its dashboard)"
"""Text that says which addresses are allowed."""

CONNECT_S = 5.0
"""Maximum time in which the scheduler must answer [s]."""

RETURN_S = 60.0
"""Maximum time for which the connection to the scheduler may be lost, and for which a connected
scheduler may not answer [s]."""

MAX_LOSSES = 10
"""Maximum number of losses of the connection between two results. A firewall, for example, can cut
each connection after some bytes."""

POLL_S = 0.5
"""Interval between two searches for new workers [s]."""

FIRST_S = 60.0
"""Maximum wait until the first worker is accepted [s]."""

STOP_S = 5.0
"""Time limit of the end of the connection in `shutdown` [s]."""

WATCH_S = 0.5
"""Interval in which a worker checks whether its run was canceled [s]."""

SHOWN = 5
"""Maximum number of differences that the message on a refused worker lists."""

AHEAD = 1000
"""Maximum number of unfinished runs in the memory of the scheduler. Further runs wait in this
process, as objects."""

RUN = "__import__('plate_bringup.cluster', fromlist=['_']).run_on_worker(call)"
"""Expression that a worker evaluates. The scheduler imports the module of a function that it
receives. It receives this text instead, so that it needs only Dask."""


class Cluster(Executor):
    """Executor that runs functions on the workers of a Dask scheduler.

    Each worker executes one run at a time. If a worker dies, other workers repeat its runs. If the
    scheduler restarts within `RETURN_S`, it receives the unfinished runs again. Workers can join at
    any time. If a run is canceled or this process ends for any reason, a `_Stopped` is raised in
    the run on its worker.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as `tcp://192.168.0.10:8786`.
    bench : bool
        Whether the functions are in the folders `bench` or `tools` of a clone of the repository. If
        True, each worker must have a clone with the same code. The path of the clone can differ,
        unless arguments contain absolute paths.
    modules : sequence of str
        Further packages of the project. Each worker must have the same code of these packages, and
        the same versions of the libraries that they import.
    agent : str
        Name of a module that is not part of the project, such as a user's agent. Each worker must
        have the same files of this module, and the same versions of the libraries that it imports.
    report : callable
        Function that is called with lines of text, such as the reasons why workers are refused.

    Raises
    ------
    PlateError
        If Dask is missing, if the scheduler does not answer or has another version, or if all
        workers are refused, because their versions or code differ from this process. A run raises a
        PlateError if the connection is lost for more than `RETURN_S` or again and again, if Dask
        cannot execute the run, or if its result cannot be read here.
    """

    def __init__(
        self,
        address: str,
        bench: bool = False,
        modules: Sequence[str] = (),
        agent: str = "",
        report: Callable[[str], None] = lambda text: print(text, file=sys.stderr, flush=True),
    ) -> None:
        self._address, self._report = address, report
        self._client, self._room = _connect(address), asyncio.Semaphore(AHEAD)
        if bench:
            _make_bench_importable()
        terms = bench, tuple(modules), agent
        self._terms = facts(*terms), terms
        # The scheduler sends runs only to workers with this resource. Each accepted worker has one
        # unit of the resource, so it executes one run at a time.
        self._key = f"plate-{hashlib.sha256(repr(self._terms).encode()).hexdigest()[:16]}"
        self._calls: dict[Future[Any], tuple[Any, ...]] = {}
        self._sent: dict[Future[Any], Any] = {}
        self._refusals: dict[str, str] = {}
        self._paused: set[str] = set()
        self._lock = threading.Lock()  # held while a run is submitted, or the client is replaced
        self._ending, self._failed, self._waits = threading.Event(), "", False
        self._losses = 0
        try:
            self._await_workers()
        except BaseException:
            self.shutdown()
            raise
        threading.Thread(target=self._watch, daemon=True).start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a run, as `concurrent.futures.Executor` describes. A run that has begun can also
        be canceled."""
        result: Future[Any] = Future()
        with self._lock:
            if self._ending.is_set():
                raise RuntimeError("a run was submitted after shutdown")
            if self._failed:
                result.set_exception(PlateError(self._failed))
                return result
            self._calls[result] = fn, args, kwargs
            result.add_done_callback(self._remove_run)
            self._begin(result)
        return result

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """Cancel all unfinished runs, and disconnect."""
        with self._lock:  # after this, no run is added
            if self._ending.is_set():
                return
            self._ending.set()
        # The newest runs first: they wait, and begin if an older run ends before they are canceled.
        for result in reversed(list(self._calls)):
            result.cancel()
        with self._lock:
            _close(self._client)

    def _begin(self, result: Future[Any]) -> None:
        self._client.loop.add_callback(self._execute, self._client, self._room, result)

    async def _execute(self, client: Any, room: asyncio.Semaphore, result: Future[Any]) -> None:
        """Send a run to the scheduler, and pass its result or exception to the caller.

        If the connection is lost, this method ends without a result. Dask's own executor is not
        used: if the connection is lost during the transfer of a result, its future never ends.
        """
        from distributed.protocol.pickle import dumps

        async with room:
            while (call := self._calls.get(result)) is not None and client.status == "running":
                try:
                    # Run and result are sent as bytes. If they were sent as objects, the scheduler
                    # would decode the arguments, but it cannot import their modules. If a result
                    # could not be encoded or decoded, Dask would report no error.
                    words = {"call": dumps(call)}
                except Exception as problem:  # an argument cannot be encoded, for any reason
                    return _set(result, None, problem)
                key, resources = f"run-{uuid.uuid4()}", {self._key: 1}
                try:
                    run = client.submit(eval, RUN, words, key=key, resources=resources)
                except OSError:  # the connection is lost
                    return None
                self._sent[result] = run
                if result.done():  # canceled by another thread in the meantime
                    self._release_run(result)
                try:
                    _deliver(result, await run)
                    self._losses = 0
                except BaseException as problem:
                    if run.status == "error":
                        text = f"cluster {self._address}: Dask could not execute a run: "
                        if type(problem).__name__ == "KilledWorker":
                            text += "several workers ended during it (check their memory): "
                        _set(result, None, PlateError(text + _error_text(problem)))
                    elif not isinstance(problem, Exception):  # the client is closed
                        raise
                    # After any other exception, the result is lost, and the run is sent again.
        return None

    def _remove_run(self, result: Future[Any]) -> None:
        del self._calls[result]
        self._release_run(result)
        if result.cancelled():
            result.set_running_or_notify_cancel()

    def _release_run(self, result: Future[Any]) -> None:
        """Cancel a run if it has not ended. Drop the last reference to it, so that Dask deletes its
        result in the cluster. Otherwise the cluster would repeat it after the death of its
        worker."""
        if (run := self._sent.pop(result, None)) is not None and not run.done():
            run.client.loop.add_callback(run.cancel)

    def _fail(self, reason: str) -> None:
        """End all runs, and refuse further ones, because the connection is closed."""
        with self._lock:
            self._failed = f"cluster {self._address}: {reason}"
        for result in list(self._calls):
            _set(result, None, PlateError(self._failed))

    def _watch(self) -> None:
        """Check each new worker. If the connection is lost, connect again."""
        while not self._ending.wait(POLL_S):
            try:
                self._check_new_workers()
            except Exception:  # after any error, a new connection is the remedy
                if self._ending.is_set() or not self._connect_again():
                    return

    def _connect_again(self) -> bool:
        """Replace the client, and send all unfinished runs again. Return False if the scheduler
        does not answer within `RETURN_S`, after `MAX_LOSSES`, or during `shutdown`."""
        self._losses += 1
        if self._losses > MAX_LOSSES:
            self._fail(f"the connection was lost {self._losses} times, and no run ended meanwhile")
            return False
        self._tell(
            f"cluster {self._address}: connection lost; trying for {RETURN_S:g} s (if the "
            "scheduler has ended, start it and its workers again)"
        )
        _close(self._client)
        end, reason = time.monotonic() + RETURN_S, ""
        while not self._ending.wait(POLL_S):
            try:
                client = _connect(self._address)
            except PlateError as problem:
                reason = f"; {problem}"
                if time.monotonic() > end:  # at least one attempt, also after a standby
                    break
                continue
            with self._lock:
                if self._ending.is_set():
                    _close(client)
                    return False
                self._client, self._room = client, asyncio.Semaphore(AHEAD)
                self._refusals = {}
                for result in list(self._calls):
                    self._begin(result)
            self._tell(f"cluster {self._address}: connected again")
            return True
        self._fail(f"no connection for {RETURN_S:g} s{reason}")
        return False

    def _tell(self, text: str) -> None:
        with suppress(OSError, ValueError):  # for example if the standard error is closed
            self._report(text)

    def _await_workers(self) -> None:
        """Wait until the first worker is accepted, for at most `FIRST_S`.

        Raises
        ------
        PlateError
            If all workers are refused, or the connection is lost.
        """
        for _ in range(int(FIRST_S / POLL_S)):
            count, accepted = self._check_new_workers()
            if accepted or not count:
                return
            if self._waits:
                raise PlateError(f"cluster {self._address}: all workers are refused")
            self._ending.wait(POLL_S)
        self._tell(f"waiting for workers; their comparison takes more than {FIRST_S:g} s")

    def _check_new_workers(self) -> tuple[int, int]:
        """Start the check of each new worker. Report if all workers are refused, if there is no
        worker, or if a worker is paused. Return the number of workers, and the number of accepted
        workers.

        Raises
        ------
        PlateError
            If the connection is lost.
        """
        client, workers = self._client, self._scheduler_info()["workers"]
        accepted = {name for name, worker in workers.items() if self._key in worker["resources"]}
        for name in set(self._refusals) - set(workers):
            self._refusals.pop(name, None)
        for name in set(workers) - set(self._refusals) - accepted:
            self._refusals[name] = ""
            client.loop.add_callback(self._check_worker, client, name)
        paused = {name for name in accepted if workers[name]["status"] == "paused"}
        for name in paused - self._paused:
            self._tell(f"worker {name} receives no runs until it has more free memory")
        self._paused = paused
        if self._waits != (waits := not accepted and all(list(self._refusals.values()))):
            self._waits = waits
            if waits:
                advice = f"start one: dask worker {self._address} --nthreads 1"
                refused = "all are refused" if workers else advice
                self._tell(f"waiting for workers; {refused}")
        return len(workers), len(accepted)

    def _scheduler_info(self) -> Any:
        """Return information about the scheduler and its workers. `Client.scheduler_info` is not
        used, because it sometimes lists no workers: a periodic query of Dask replaces its result.

        Raises
        ------
        PlateError
            If the connection is lost, or if the scheduler does not answer within `RETURN_S`.
        """
        client, reason = self._client, "it is closed"
        if client.status == "running" and not client._handle_report_task.done():
            try:
                query = client.scheduler.identity
                return client.sync(query, n_workers=-1, callback_timeout=RETURN_S)
            except Exception as problem:  # Dask raises exceptions of many types
                reason = _error_text(problem)
        raise PlateError(f"cluster {self._address}: the connection is lost ({reason})")

    async def _check_worker(self, client: Any, name: str) -> None:
        """Compare a worker with this process, and then accept or refuse it."""
        try:
            call = (_compare_and_admit, self._key, *self._terms)
            found = (await client.run(*call, workers=[name], on_error="return"))[name]
        except Exception as problem:  # the worker or the scheduler is lost
            found = OSError(problem)
        if isinstance(found, OSError):
            self._refusals.pop(name, None)
            return
        if isinstance(found, BaseException):
            found = [_error_text(found)]
        if found:
            more = f"; {len(found) - SHOWN} more differences" if len(found) > SHOWN else ""
            self._refusals[name] = "; ".join(found[:SHOWN]) + more
            self._tell(f"worker {name} is refused: {self._refusals[name]}")


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
        raise PlateError(
            f"cluster is {address!r}, but Dask is not installed: {INSTALL}"
        ) from problem
    try:
        kind, scheduler_version = _query_within_limit(address)
        if kind != "Scheduler":
            raise PlateError(
                f"cluster is {address!r}, which is the address of a {kind}, allowed: {ADDRESS}"
            )
        if scheduler_version != distributed.__version__:
            raise PlateError(
                f"cluster {address}: the scheduler's package `distributed` has version "
                f"{scheduler_version}, allowed: {distributed.__version__} (the version on this "
                "computer)"
            )
        with warnings.catch_warnings():
            # Suppress Dask's warning of different versions, because other code refuses different
            # versions.
            warnings.simplefilter("ignore")
            client: Any = distributed.Client(address, timeout=RETURN_S, set_as_default=False)
    except PlateError:
        raise
    except Exception as problem:
        raise PlateError(
            f"cluster is {address!r}, where no Dask scheduler answers ({_error_text(problem)}), "
            f"allowed: {ADDRESS}"
        ) from problem
    # Dask's client sometimes does not connect again. Then it stays in this state forever. Therefore
    # it closes if its connection is lost, and `Cluster` replaces it.
    client._reconnect = client._close
    return client


def _close(client: Any) -> None:
    """Close a client of Dask, also if its connection is lost."""
    with suppress(Exception):
        client.close(timeout=STOP_S)
    client._loop_runner.stop()  # `close` does not do this if the client has closed itself


def _query_within_limit(address: str) -> tuple[str, str]:
    """Return the result of `_query_server`.

    Raises
    ------
    Exception
        Of any type, if the server cannot be reached or does not answer within `CONNECT_S`.
    """
    from distributed.comm.addressing import get_address_host_port

    found: Future[tuple[str, str]] = Future()

    def query() -> None:
        try:
            # Dask tries to connect until its time limit is over. This connection fails at once if
            # no server uses the address.
            socket.create_connection(get_address_host_port(address), CONNECT_S).close()
            found.set_result(asyncio.run(asyncio.wait_for(_query_server(address), CONNECT_S)))
        except BaseException as problem:
            found.set_exception(problem)

    # The thread can outlive this function, because the search for the address of a computer by its
    # name cannot be interrupted.
    threading.Thread(target=query, daemon=True).start()
    # The limits of the thread and of this function are equal. Either can be reached first, and both
    # have the same text.
    with suppress(TimeoutError):
        return found.result(CONNECT_S)
    raise TimeoutError(f"no answer within {CONNECT_S:g} s")


async def _query_server(address: str) -> tuple[str, str]:
    """Return the kind of a Dask server, and the version of its package `distributed`. This function
    does not use Dask's client, because the client waits forever if the server is not a Dask
    server."""
    from distributed import Security
    from distributed.comm import connect
    from distributed.core import send_recv

    options = Security().get_connection_args("client")
    # The limit of the caller, which has a text of its own, ends this connection earlier.
    comm = await connect(address, timeout=2 * CONNECT_S, **options)
    try:
        about = await send_recv(comm, op="identity", reply=True)
        versions = await send_recv(comm, op="versions", reply=True)
    finally:
        comm.abort()
    return about["type"], versions["packages"]["distributed"]


def _deliver(result: Future[Any], outcome: tuple[bytes, str]) -> None:
    """Pass the outcome of a run, as `run_on_worker` returns it, to the caller."""
    encoded, error = outcome
    try:
        value = pickle.loads(encoded)
    except BaseException as unread:  # decoding runs code of the user, which can raise anything
        text = f"the result of a run cannot be read here: {_error_text(unread)}"
        _set(result, None, PlateError(f"{text}; the run has raised {error}" if error else text))
        return
    if error:
        _set(result, None, value)
    else:
        _set(result, value, None)


def _set(result: Future[Any], value: Any, problem: BaseException | None) -> None:
    """Set the result or the exception of a run. If the caller has canceled the run in the meantime,
    do nothing."""
    with suppress(InvalidStateError):
        if problem is None:
            result.set_result(value)
        else:
            result.set_exception(problem)


def _error_text(problem: BaseException) -> str:
    return " ".join("".join(traceback.format_exception_only(problem)).split())


# Functions that run on the workers


class _Stopped(BaseException):
    """Exception that ends a run on a worker."""


def run_on_worker(call: bytes) -> tuple[bytes, str]:
    """Run a function on a worker. Return its encoded result and an empty text, or its encoded
    exception and the text of this exception. The exception is not raised, because Dask uses some
    exceptions itself, such as a CancelledError or a `distributed.Reschedule`.

    If Dask cancels the run, raise a `_Stopped` in it. Dask cancels a run if the process that has
    submitted it cancels it, ends, or loses its connection.
    """
    from distributed import get_worker
    from distributed.protocol.pickle import dumps

    worker, thread = get_worker(), threading.get_ident()
    key, ended, lock = worker.get_current_task(), threading.Event(), threading.Lock()

    def is_canceled() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    def watch() -> None:
        while not is_canceled():
            if ended.wait(WATCH_S):
                return
        with lock:
            if not ended.is_set():
                stopped = ctypes.py_object(_Stopped)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), stopped)

    threading.Thread(target=watch, daemon=True).start()
    error: BaseException
    try:
        function, args, kwargs = pickle.loads(call)
        return dumps(function(*args, **kwargs)), ""
    except _Stopped:
        raise
    except Exception as problem:
        error = problem
    except BaseException as problem:
        error = PlateError(f"a run has raised {_error_text(problem)}")
    finally:
        with lock:
            # Python raises the exception of `watch` after this call at the latest. It is not raised
            # in the code of Dask.
            ended.set()
    text = _error_text(error)
    try:
        return dumps(error), text
    except Exception:  # some exceptions cannot be encoded, such as those with an open file
        return dumps(PlateError(f"a run has raised {text}")), text


_FACTS = threading.Lock()
"""Held while the facts of this worker are computed, because two clusters can check it at the same
time. In some versions of CPython, `ast.parse` can fail if two threads call it (cpython issue
106905)."""


def _facts_alone(*terms: Any) -> dict[str, str]:
    """Call `facts`, in one thread at a time."""
    with _FACTS:
        return facts(*terms)


async def _compare_and_admit(
    key: str,
    expected: dict[str, str],
    terms: tuple[bool, tuple[str, ...], str],
    dask_worker: Any,
) -> list[str]:
    """Compare the facts of this worker with those of the process that asks (`expected`). If they
    are equal, give this worker the resource `key`. `terms` are the arguments of `facts`. Return the
    differences."""
    if terms[0]:
        _make_bench_importable()
    try:
        found = differences(expected, await asyncio.to_thread(_facts_alone, *terms))
    except Exception as problem:  # if an OSError left this function, the check would be repeated
        return [_error_text(problem)]
    if not found and key not in dask_worker.state.total_resources:
        try:
            await dask_worker.set_resources(**{key: 1})
        except BaseException:
            # Dask changes the worker before it informs the scheduler. Undo this change, so that the
            # next check informs the scheduler again.
            dask_worker.state.total_resources.pop(key, None)
            dask_worker.state.available_resources.pop(key, None)
            raise
        # The scheduler sends waiting runs to a worker only when the worker's status changes to
        # running. Therefore pause and resume the worker. No other task may run between these two
        # changes, because Dask's memory monitor can also end a pause.
        status = type(dask_worker.status)
        if dask_worker.status == status.running:
            dask_worker.status = status.paused
            dask_worker.status = status.running
    return found


def _make_bench_importable() -> None:
    """Add the folder `bench` of the clone to the folders from which Python imports modules. If
    there is no clone, do nothing."""
    folder = clone()
    if folder is not None and str(folder / "bench") not in sys.path:
        sys.path.append(str(folder / "bench"))
