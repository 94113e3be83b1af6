"""Runs on a Dask cluster: a real scheduler and real workers on the loopback."""

import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, as_completed
from importlib import import_module
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml
from short_task import short_task

from harness import pool as pool_module
from plate_bringup import cluster
from plate_bringup.cluster import Cluster
from plate_bringup.identity import differences, facts
from plate_core import PlateError

pytestmark = pytest.mark.needs("distributed")

BENCH = Path(__file__).resolve().parents[1] / "bench"
PAGE = BENCH.parent / "docs/guide/library.md"
WAIT_S = 100.0
"""Maximum time of each wait [s]."""

PROCESS = "(__import__('time').sleep({s}), __import__('os').getpid(), {k})"
"""A run: it takes `s` seconds and returns its process and its number."""

ENDLESS = "(open({!r}, 'w').close(), sum(0 for _ in iter(int, 1)))"
"""A run that makes a file and does not end."""

TIMINGS = {
    "solve_ms_median", "solve_ms_p99", "step_ms_median", "step_ms_p99", "late_cycles", "load",
}  # fmt: skip


class Processes:
    """A scheduler and its workers, ended by their process ids."""

    def __init__(self, folder):
        self.folder, self.processes, self.address = folder, [], ""

    def start(self, *words, **changed):
        env = {**os.environ, **changed}
        with open(self.folder / f"{len(self.processes)}.log", "w", encoding="utf-8") as log:
            words = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
            process = subprocess.Popen(words, cwd=self.folder, env=env, stdout=log, stderr=log)
        self.processes.append(process)
        return process

    def scheduler(self):
        """Start the scheduler without the project's packages, the first time on a free port."""
        port = self.address.rpartition(":")[2] or "0"
        file = self.folder / f"scheduler{len(self.processes)}.json"
        place = ("--host", "127.0.0.1", "--port", port, "--no-dashboard")
        words = ("scheduler", *place, "--scheduler-file", str(file))
        process = self.start(*words, PYTHONPATH="")
        until(lambda: file.exists() and file.read_text().strip())
        self.address = json.loads(file.read_text())["address"]
        return process

    def worker(self, *options, **changed):
        return self.start(
            "worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard",
            "--local-directory", str(self.folder), *options, **changed,
        )  # fmt: skip

    def end(self):
        for process in self.processes:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGKILL)
            process.wait(WAIT_S)


def until(true):
    end = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


@contextlib.contextmanager
def started(folder):
    """A new scheduler."""
    processes = Processes(folder)
    try:
        processes.scheduler()
        yield processes
    finally:
        processes.end()


@pytest.fixture
def processes(tmp_path):
    with started(tmp_path) as processes:
        yield processes


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The folder of the modules of the workers of `both`."""
    return tmp_path_factory.mktemp("modules")


@pytest.fixture(scope="module", name="shared")
def _shared(tmp_path_factory, place):
    """A scheduler with two equal workers, and one with the variables that the page says. All tests
    share them that kill none. A worker has two threads, so that it can run for two clusters."""
    (line,) = re.findall(r"^ +(export .+)", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    said = subprocess.run(["bash", "-c", f"{line}; env -0"], capture_output=True, check=True).stdout
    alike = dict(one.split("=", 1) for one in said.decode().rstrip("\0").split("\0"))
    alike["PYTHONPATH"] = os.pathsep.join([str(place), os.environ.get("PYTHONPATH", "")])
    with started(tmp_path_factory.mktemp("shared")) as processes:
        path = {"PYTHONPATH": alike["PYTHONPATH"]}
        processes.workers = [processes.worker("--nthreads", "2", **path) for _ in range(2)]
        processes.alike = processes.worker("--nthreads", "2", **alike)
        logs = [processes.folder / f"{k}.log" for k in (1, 2, 3)]
        until(lambda: all("Registered to" in log.read_text(encoding="utf-8") for log in logs))
        yield processes


@pytest.fixture(name="pool")
def _pool(shared, messages):
    """A cluster of two workers. The messages cannot be printed, as with a closed standard error."""

    def report(text):
        messages.append(text)
        raise BrokenPipeError

    with Cluster(shared.address, report=report) as pool:
        yield pool


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    monkeypatch.setattr(cluster, "POLL_S", 0.05)


@pytest.fixture(name="messages")
def _told():
    return []


def submitted(pool, count, s=0.2):
    return [pool.submit(eval, PROCESS.format(s=s, k=k)) for k in range(count)]


def numbers(runs):
    return [run.result(WAIT_S)[2] for run in runs]


def await_runs_on(pool, workers):
    """Wait until each of these workers has executed a run. No other worker may execute one."""
    expected, found = {worker.pid for worker in workers}, set()

    def complete():
        found.update(run.result(WAIT_S)[1] for run in submitted(pool, 4, 0.1))
        assert found <= expected
        return found == expected

    until(complete)


def endless(pool, folder, count):
    """Submit runs without end, and wait until each of the two workers runs one. Both workers must
    be accepted before: a worker that is accepted later receives no runs that another one has."""
    files = [folder / f"begun{k}" for k in range(count)]
    for file in files:
        file.unlink(missing_ok=True)
    runs = [pool.submit(eval, ENDLESS.format(str(file))) for file in files]
    until(lambda: all(file.exists() for file in files[:2]))
    return runs, files


def test_no_run_is_lost_with_killed_workers(processes, tmp_path):
    """Nor is one repeated whose result was here. A late worker takes over from all."""
    workers = [processes.worker(), processes.worker()]
    run = "(open({file!r}, 'a').write('{k} '), " + PROCESS + ")[1]"
    file = str(tmp_path / "begun")
    with Cluster(processes.address) as pool:
        runs = [pool.submit(eval, run.format(file=file, s=0.1, k=k)) for k in range(20)]
        for first in islice(as_completed(runs, WAIT_S), 6):
            killed = first.result()[1]
        here = [k for k, run in enumerate(runs) if run.done()]
        os.kill(killed, signal.SIGKILL)
        for _ in islice(as_completed(runs, WAIT_S), 9):
            pass
        for worker in workers:
            worker.kill()
            worker.wait(WAIT_S)
        # On a busy computer, the workers may have executed all runs before they were killed.
        runs.append(pool.submit(eval, run.format(file=file, s=0.1, k=20)))
        late = processes.worker()
        assert numbers(runs) == list(range(21))
    ran = {run.result()[1] for run in runs}
    assert late.pid in ran <= {worker.pid for worker in [*workers, late]}
    begun = [int(k) for k in Path(file).read_text().split()]
    assert set(begun) == set(range(21))
    assert [begun.count(k) for k in here] == [1] * len(here)


ADMISSION = """
import asyncio
from distributed import Worker

calls = []

async def admit(worker, real=Worker.set_resources, **resources):
    calls.append(resources)
    if len(calls) > 1:
        await asyncio.sleep(0.25)
        return await real(worker, **resources)
    worker.state.available_resources.update(resources)  # Dask also changes these first
    worker.state.total_resources.update(resources)
    raise OSError("the connection is lost")

Worker.set_resources = admit
"""


def test_waiting_runs_reach_a_worker_whose_admission_fails_first_and_then_is_slow(
    processes, tmp_path
):
    """At first, the scheduler does not receive the admission. During the second admission, Dask's
    memory monitor checks the status of the worker several times."""
    (tmp_path / "change.py").write_text(ADMISSION, encoding="utf-8")
    with Cluster(processes.address) as pool:
        runs = submitted(pool, 3)
        processes.worker("--preload", str(tmp_path / "change.py"))
        assert numbers(runs) == list(range(3))


def test_no_run_is_lost_with_a_scheduler_that_restarts(processes):
    worker = processes.worker()
    with Cluster(processes.address) as pool:
        runs = submitted(pool, 8)
        next(as_completed(runs, WAIT_S))
        processes.processes[0].kill()
        processes.processes[0].wait(WAIT_S)
        worker.kill()
        processes.scheduler()
        processes.worker()
        assert numbers(runs) == list(range(8))


def test_a_worker_with_other_results_is_refused_by_name(shared, pool, messages):
    until(lambda: any("is refused" in line for line in messages))
    (line,) = (line for line in messages if "is refused" in line)
    assert "tcp://127.0.0.1:" in line
    assert "OPENBLAS_CORETYPE is 'Haswell', allowed: ''" in line
    await_runs_on(pool, shared.workers)


def test_workers_without_a_module_are_refused(shared, messages, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "only_here.py").write_text("NAMES = '', " + ", ".join(map(repr, "0123456789")))
    for k in range(10):
        (tmp_path / str(k)).touch()
    with pytest.raises(PlateError, match="all workers are refused"):
        Cluster(shared.address, agent="only_here", report=messages.append)
    found = [line for line in messages if "is refused: file 0 is missing, allowed: " in line]
    assert len(found) == 2  # the third worker also has other variables
    assert all("(put its folder into PYTHONPATH); " in line for line in found)
    assert all(line.endswith("; 6 more differences") for line in found)


def test_a_worker_that_does_not_answer_is_reported(shared, messages, monkeypatch):
    """It joins before it is compared, such as a frozen one."""
    monkeypatch.setattr(cluster, "FIRST_S", 0.2)
    monkeypatch.setattr(Cluster, "_check_worker", lambda *words: None)
    with Cluster(shared.address, modules=("json",), report=messages.append):
        assert messages == ["waiting for workers; their comparison takes more than 0.2 s"]


def test_a_worker_without_the_packages_is_refused(shared, pool, messages):
    worker = shared.worker(PYTHONPATH="")
    until(lambda: any("No module named 'plate_bringup'" in line for line in messages))
    worker.kill()


def test_what_is_canceled_ends_on_the_workers(shared, pool, tmp_path):
    await_runs_on(pool, shared.workers)
    runs, files = endless(pool, tmp_path, 3)
    for run in reversed(runs):  # the third one begins if another one ends before
        run.cancel()
    await_runs_on(pool, shared.workers)
    assert not files[2].exists()
    runs, files = endless(pool, tmp_path, 3)
    ended = []
    for run in runs:
        run.add_done_callback(ended.append)
    pool.shutdown()
    assert ended == runs[::-1]
    assert all(run.cancelled() for run in runs)
    with Cluster(shared.address) as again:
        await_runs_on(again, shared.workers)
    assert not files[2].exists()


def test_the_runs_of_a_killed_command_end_on_the_workers(shared, pool, tmp_path):
    files = [tmp_path / f"begun{k}" for k in range(2)]
    command = [
        "import sys, time",
        "from plate_bringup.cluster import Cluster",
        "pool = Cluster(sys.argv[1])",
        "accepted = lambda: str(pool._scheduler_info()).count(repr(pool._key))",
        "while accepted() < 2: time.sleep(0.05)",
        f"for file in sys.argv[2:]: pool.submit(eval, {ENDLESS!r}.format(file))",
        "time.sleep(1000)",
    ]
    words = [sys.executable, "-c", "\n".join(command), shared.address, *map(str, files)]
    with subprocess.Popen(words) as process:
        until(lambda: all(file.exists() for file in files))
        process.kill()
    await_runs_on(pool, shared.workers)


def cut_connections(address):
    """Cut the scheduler's connections to all clients."""
    from distributed import Client

    with Client(address, set_as_default=False) as own:
        own.run_on_scheduler(
            lambda own, dask_scheduler: [
                one.comm.abort() for name, one in dask_scheduler.client_comms.items() if name != own
            ],
            own.id,
        )


def test_no_run_is_lost_with_a_connection_that_is_cut(pool, shared, messages):
    """The runs on the workers end, and the command sends all unfinished runs again."""
    runs = submitted(pool, 12)
    next(as_completed(runs, WAIT_S))
    cut_connections(shared.address)
    assert numbers(runs) == list(range(12))
    lines = [line.partition(": ")[2] for line in messages if shared.address in line]
    advice = "(if the scheduler has ended, start it and its workers again)"
    assert lines == [f"connection lost; trying for 60 s {advice}", "connected again"]


@pytest.mark.parametrize("progress", [True, False])
def test_a_connection_that_is_always_cut_ends_the_command(pool, shared, monkeypatch, progress):
    """A firewall can cut each connection after some bytes. Losses between results do not count
    together."""
    monkeypatch.setattr(cluster, "MAX_LOSSES", 2)
    run = pool.submit(eval, "sum(0 for _ in iter(int, 1))")
    if progress:
        for _ in range(3):
            cut_connections(shared.address)
            until(lambda: pool._losses)
            assert numbers(submitted(pool, 1, 0)) == [0]
        assert not run.done()
        return
    until(lambda: cut_connections(shared.address) or run.done())
    with pytest.raises(PlateError, match="was lost 3 times, and no run ended meanwhile"):
        run.result(WAIT_S)
    with pytest.raises(PlateError, match="was lost 3 times"):
        pool.submit(eval, "0").result(WAIT_S)


def test_a_run_is_not_lost_if_the_connection_is_cut_while_its_result_is_transmitted(
    pool, monkeypatch
):
    client, cuts = pool._client, []
    transmit = client._gather_remote

    async def cut_first(*options):
        if not cuts:
            cuts.append(1)
            client.scheduler_comm.comm.abort()
        return await transmit(*options)

    monkeypatch.setattr(client, "_gather_remote", cut_first)
    assert numbers(submitted(pool, 4)) == list(range(4))
    assert cuts


def test_a_scheduler_that_does_not_answer_is_replaced(pool, monkeypatch, messages):
    """Such as a frozen one, or one behind a tunnel that has lost its network."""

    client = pool._client
    sync = client.sync

    async def no_answer(**words):
        await asyncio.sleep(2 * WAIT_S)

    def short_wait(call, *more, callback_timeout=None, **words):
        if call is no_answer:
            assert callback_timeout == cluster.RETURN_S
            callback_timeout = 0.1
        return sync(call, *more, callback_timeout=callback_timeout, **words)

    monkeypatch.setattr(client, "sync", short_wait)
    monkeypatch.setattr(client.scheduler, "identity", no_answer, raising=False)
    until(lambda: any("connected again" in line for line in messages))
    assert numbers(submitted(pool, 2, 0)) == [0, 1]


def test_the_reason_is_named_if_the_connection_stays_lost(pool, monkeypatch):
    def other_version(address):
        raise PlateError("the scheduler has another version")

    monkeypatch.setattr(cluster, "RETURN_S", 0.0)  # as after a standby of this computer
    monkeypatch.setattr(cluster, "_connect", other_version)
    run = pool.submit(eval, "sum(0 for _ in iter(int, 1))")
    pool._client.loop.add_callback(pool._client._close)
    with pytest.raises(PlateError, match="no connection for 0 s; the scheduler has anoth"):
        run.result(WAIT_S)


def test_a_connection_that_is_lost_at_the_start_is_named(shared, monkeypatch):
    connect = cluster._connect

    def connect_and_lose(address):
        client = connect(address)
        client.close()
        return client

    monkeypatch.setattr(cluster, "_connect", connect_and_lose)
    with pytest.raises(PlateError, match="the connection is lost"):
        Cluster(shared.address)
    monkeypatch.setattr("distributed.Client", Mock(side_effect=OSError("cut")))
    with pytest.raises(PlateError, match=r"no Dask scheduler answers .*OSError: cut"):
        connect(shared.address)


def test_a_paused_worker_is_reported_once(pool, monkeypatch, messages):
    """Dask pauses a worker whose memory is full."""
    worker = {"resources": {pool._key: 1}, "status": "paused"}
    answer, checks = {"workers": {"tcp://1.2.3.4:5": worker}}, []
    monkeypatch.setattr(pool, "_scheduler_info", lambda: checks.append(1) or answer)
    until(lambda: len(checks) > 2)  # the thread of the pool checks
    (line,) = (line for line in messages if "tcp://1.2.3.4:5" in line)
    assert "more free memory" in line


def test_facts_that_cannot_be_read_refuse_a_worker(monkeypatch):
    """Also after an OSError. After the OSError of a lost connection, the check is repeated."""
    monkeypatch.setattr(cluster, "facts", Mock(side_effect=OSError("no disk")))
    found = asyncio.run(cluster._compare_and_admit("key", {}, (False, (), ""), None))
    assert found == ["OSError: no disk"]


def test_the_scheduler_receives_a_limited_number_of_runs(shared, monkeypatch, tmp_path):
    monkeypatch.setattr(cluster, "AHEAD", 1)
    with Cluster(shared.address) as pool:
        runs = [pool.submit(eval, ENDLESS.format(str(tmp_path / "begun"))), *submitted(pool, 2, 0)]
        until((tmp_path / "begun").exists)
        assert len(pool._sent) == 1
        runs[0].cancel()
        assert numbers(runs[1:]) == [0, 1]


RAISED = "(_ for _ in ()).throw(__import__({!r}, fromlist=['_']).{})"
"""A run that raises an exception."""


@pytest.mark.parametrize(
    ("run", "error", "words"),
    [
        ("1 / 0", ZeroDivisionError, "division"),
        (RAISED.format("builtins", "TimeoutError('slow')"), TimeoutError, "slow"),
        (RAISED.format("concurrent.futures", "CancelledError('own')"), CancelledError, "own"),
        (RAISED.format("asyncio", "CancelledError()"), PlateError, "has raised asyncio"),
        (RAISED.format("builtins", "GeneratorExit()"), PlateError, "has raised GeneratorExit"),
        (RAISED.format("distributed", "Reschedule('own')"), Exception, "own"),
        (RAISED.format("only_there", "Odder('its text')"), PlateError, "Odder: its text"),
        ("__import__('only_there').fail()", PlateError, "Odder: <unlocked"),
        ("__import__('threading').Lock()", TypeError, "pickle"),
        ("__import__('only_there').Odd()", PlateError, "cannot be read here: ModuleNotFoundError"),
        ("__import__('sys').exit(3)", PlateError, "a run has raised SystemExit: 3"),
    ],
)
def test_an_error_of_a_run_is_raised_here(pool, place, run, error, words):
    """Also if only the worker can read its result. The worker continues."""
    text = "class Odd: pass\nclass Odder(Exception): pass\n"
    text += "def fail(): raise Odder(__import__('threading').Lock())\n"
    (place / "only_there.py").write_text(text, encoding="utf-8")
    with pytest.raises(error, match=words):
        pool.submit(eval, run).result(WAIT_S)
    assert numbers(submitted(pool, 2, 0)) == [0, 1]


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("tcp://127.0.0.1:1", "ConnectionRefusedError"), ("nowhere", "missing port"),
        ("tcp://[", "ValueError"), ("udp://x:1", "unknown address scheme"),
        ("tls://127.0.0.1:1", "ConnectionRefusedError"), ("http://x:1", "unknown address scheme"),
    ],
)  # fmt: skip
def test_an_address_without_a_scheduler_is_refused(address, reason):
    """`dask scheduler` prints two addresses, that of its dashboard last."""
    with pytest.raises(PlateError, match=f"no Dask scheduler answers .*{reason}") as problem:
        Cluster(address)
    assert repr(address) in str(problem.value)
    assert "after `Scheduler at:`" in str(problem.value)
    assert "not its dashboard" in str(problem.value)


@pytest.mark.parametrize("first", ["caller", "thread"])
def test_a_server_of_another_kind_is_refused(first, monkeypatch):
    """It does not answer in Dask's way. The time limit of the caller or that of the thread is
    reached first."""
    monkeypatch.setattr(cluster, "CONNECT_S", 0.3)
    if first == "thread":
        result = Future.result
        monkeypatch.setattr(Future, "result", lambda self, timeout=None: result(self, WAIT_S))
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(PlateError, match=r"answers \(TimeoutError: no answer within 0.3 s"):
            Cluster(address)


def test_a_long_search_for_a_computer_is_not_awaited(monkeypatch):
    """The search for the address of a name can take longer, and cannot be interrupted."""
    monkeypatch.setattr(cluster, "CONNECT_S", 0.1)
    refused = threading.Event()
    monkeypatch.setattr(socket, "create_connection", lambda *where: refused.wait(WAIT_S))
    with pytest.raises(PlateError, match=r"no answer within 0\.1 s"):
        Cluster("tcp://far:8786")
    refused.set()


@pytest.mark.parametrize("older", ["", "[]", None])
@pytest.mark.parametrize("program", ["closed_loop", "gym"])
def test_a_refused_command_leaves_no_file_and_no_other_one(
    program, older, tmp_path, monkeypatch, capsys
):
    if program == "closed_loop":
        from closed_loop import main
    else:
        pytest.importorskip("gymnasium")
        from plate_gym.bench import main

        older = older and None
    path = tmp_path / "rows.json"
    if older is not None:
        path.write_text(older)
    words = ["--cluster", "tcp://127.0.0.1:1", "--json", str(path)]
    monkeypatch.setattr(sys, "argv", [program, *words])
    assert main() == 2
    assert "ConnectionRefusedError" in capsys.readouterr().err
    assert [file.read_text() for file in tmp_path.iterdir()] == [older] * (older is not None)


@pytest.mark.parametrize("program", ["closed_loop", "run", "plate_gym.bench"])
def test_an_interrupt_while_the_command_waits_ends_it(program, tmp_path, monkeypatch, capsys):
    if program == "plate_gym.bench":
        pytest.importorskip("gymnasium")

    def interrupt(*words, **options):
        raise KeyboardInterrupt

    module = import_module(program)
    monkeypatch.setattr(pool_module if program == "run" else module, "Cluster", interrupt)
    path = tmp_path / "rows.json"
    words = ["--out", str(tmp_path)] if program == "run" else ["--json", str(path)]
    monkeypatch.setattr(sys, "argv", [program, "--cluster", "tcp://127.0.0.1:1", *words])
    assert module.main() == 130
    message = capsys.readouterr().err
    assert message.startswith("stopped")
    assert str(path) not in message
    assert not list(tmp_path.iterdir())


def test_the_address_of_a_worker_is_refused(shared):
    log = shared.folder / "1.log"
    (address,) = re.findall(r"Start worker at: +(tcp://\S+)", log.read_text(encoding="utf-8"))
    with pytest.raises(PlateError, match="the address of a Worker, allowed: "):
        Cluster(address)


def test_without_dask_the_command_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(PlateError, match="pip install 'distributed=="):
        Cluster("tcp://127.0.0.1:1")


def test_the_command_is_that_of_the_pinned_version():
    pin = cluster.INSTALL.split("'")[1]
    assert pin in (BENCH.parent / "requirements-test.txt").read_text(encoding="utf-8")


def test_facts_differ_by_name():
    here = facts()
    assert not differences(here, dict(here))
    assert differences(here, here | {"numpy": "1.0"}) == [
        f"numpy is '1.0', allowed: {here['numpy']!r}"
    ]
    assert differences({"gymnasium": "1.4"}, {}) == ["gymnasium is missing, allowed: '1.4'"]


def test_two_clusters_check_a_worker_one_after_the_other(monkeypatch):
    """Python's parser fails sometimes in two threads."""
    inside, together = [], []

    def slow_facts(name):
        inside.append(name)
        together.append(len(inside))
        time.sleep(0.02)
        inside.remove(name)
        return {}

    monkeypatch.setattr(cluster, "facts", slow_facts)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(cluster._facts_alone, range(4)))
    assert together == [1] * 4


@pytest.mark.needs("gymnasium")
def test_the_libraries_of_further_packages_are_facts():
    assert facts(modules=("plate_gym",))["gymnasium"] == version("gymnasium")


def both_rows(words, address, folder, env, rows_of, times):
    """Run a command on this computer and on a cluster at the same time. Return the rows of both,
    without computing times."""
    places = {"here": ("--workers", "1"), "there": ("--cluster", address)}
    runs = [
        subprocess.Popen([*words, *place, "--json", f"{name}.json"], cwd=folder, env=env)
        for name, place in places.items()
    ]
    assert [run.wait(2 * WAIT_S) for run in runs] == [0, 0]
    return [
        [
            {key: row[key] for key in row if key not in times}
            for row in rows_of(json.loads((folder / f"{name}.json").read_text(encoding="utf-8")))
        ]
        for name in places
    ]


def test_a_sweep_has_the_rows_of_one_by_processes(shared, tmp_path):
    """With a scenario and a planner that only this folder has."""
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(short_task(0.01, 20)), encoding="utf-8")
    planner = (BENCH.parent / "examples/own_planner.py").read_text(encoding="utf-8")
    (tmp_path / "mine.py").write_text(planner, encoding="utf-8")
    words = [sys.executable, str(BENCH / "closed_loop.py"), "--scenario", "tiny.yaml"]
    words += ["--planner", "mine.py", "--seeds", "0:4"]
    rows = both_rows(words, shared.address, tmp_path, None, lambda found: found, TIMINGS)
    assert rows[0] == rows[1]
    assert [row["seed"] for row in rows[0]] == list(range(4))


@pytest.mark.needs("gymnasium")
def test_agents_are_evaluated_in_processes_of_the_workers(shared, place, tmp_path):
    """An agent that reports its parent process, in the file of its seed. The part does not follow
    its path, so that the episodes are short."""
    from plate_gym import bench  # only where there is gymnasium

    agent = """
import os

class Mine:
    action, observation = "motion", "parts"

    def __init__(self, brief, seed):
        self.space = brief.action_space
        self.space.seed(seed)
        with open(f"{seed}.txt", "w") as file:
            file.write(str(os.getppid()))

    def act(self, observation, info):
        return self.space.sample()
"""
    (place / "mine.py").write_text(agent, encoding="utf-8")
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(place), os.environ["PYTHONPATH"]])}
    words = ["--agent", "mine:Mine", "--task", "Follow1-v1", "--seeds", "0:2"]
    words = [sys.executable, "-m", "plate_gym.bench", *words]
    rows = both_rows(
        words, shared.address, tmp_path, env,
        lambda found: found["tasks"]["Follow1-v1"]["rows"], bench.TIMES,
    )  # fmt: skip
    assert rows[0] == rows[1]
    assert [row["seed"] for row in rows[0]] == [0, 1]
    parents = {int(file.read_text()) for file in shared.folder.glob("*.txt")}
    assert len(list(shared.folder.glob("[0-9]*.txt"))) == 2
    assert not parents & {os.getpid(), shared.alike.pid}
