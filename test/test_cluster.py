"""Runs on a Dask cluster: a real scheduler and real workers on the loopback."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import as_completed, wait
from itertools import islice
from pathlib import Path

import pytest
import yaml
from short_task import short_task

from plate_bringup import cluster
from plate_bringup.cluster import Cluster
from plate_bringup.identity import differences, facts
from plate_core import PlateError

pytestmark = pytest.mark.needs("distributed")

BENCH = Path(__file__).resolve().parents[1] / "bench"
WAIT_S = 100.0
"""Maximum time of each wait [s]."""

PROCESS = "(__import__('time').sleep({s}), __import__('os').getpid(), {k})"
"""A run: it takes `s` seconds and returns its process and its number."""

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
        """Start the scheduler, the first time on a free port."""
        port = self.address.rpartition(":")[2] or "0"
        file = self.folder / f"scheduler{len(self.processes)}.json"
        place = ("--host", "127.0.0.1", "--port", port, "--no-dashboard")
        process = self.start("scheduler", *place, "--scheduler-file", str(file))
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


@pytest.fixture
def processes(tmp_path):
    started = Processes(tmp_path)
    try:
        started.scheduler()
        yield started
    finally:
        started.end()


@pytest.fixture(name="messages")
def _told():
    return []


@pytest.fixture
def pool(processes, messages):
    """A cluster of two workers."""
    processes.workers = [processes.worker(), processes.worker()]
    with Cluster(processes.address, report=messages.append) as pool:
        yield pool


def submitted(pool, count, s=0.2):
    return [pool.submit(eval, PROCESS.format(s=s, k=k)) for k in range(count)]


def numbers(runs):
    return [run.result(WAIT_S)[2] for run in runs]


def test_no_run_is_lost_with_a_killed_worker(processes, pool, tmp_path):
    """Nor is one repeated whose result was here."""
    run = "(open({file!r}, 'a').write('{k} '), " + PROCESS + ")[1]"
    file = str(tmp_path / "begun")
    runs = [pool.submit(eval, run.format(file=file, s=0.2, k=k)) for k in range(20)]
    for first in islice(as_completed(runs, WAIT_S), 6):
        killed = first.result()[1]
    here = [k for k, run in enumerate(runs) if run.done()]
    os.kill(killed, signal.SIGKILL)
    assert numbers(runs) == list(range(20))
    assert {run.result()[1] for run in runs} <= {worker.pid for worker in processes.workers}
    begun = [int(k) for k in Path(file).read_text().split()]
    assert set(begun) == set(range(20))
    assert [begun.count(k) for k in here] == [1] * len(here)


def test_a_late_worker_takes_over_from_all_that_have_died(processes, pool):
    runs = submitted(pool, 10)
    next(as_completed(runs, WAIT_S))
    for worker in processes.workers:
        worker.kill()
    late = processes.worker()
    assert numbers(runs) == list(range(10))
    assert late.pid in {run.result()[1] for run in runs}


def changed_worker(processes, folder, code):
    """Start a worker that executes `code` first."""
    (folder / "change.py").write_text(code, encoding="utf-8")
    return processes.worker("--preload", str(folder / "change.py"))


SLOW_ADMISSION = """
import asyncio
from distributed import Worker

async def slow(worker, fast=Worker.set_resources, **resources):
    await asyncio.sleep(0.25)
    await fast(worker, **resources)

Worker.set_resources = slow
"""


def test_waiting_runs_reach_a_worker_that_is_admitted_slowly(processes, tmp_path):
    """Dask's memory monitor checks the status of the worker several times during the admission."""
    with Cluster(processes.address) as pool:
        runs = submitted(pool, 3)
        changed_worker(processes, tmp_path, SLOW_ADMISSION)
        assert numbers(runs) == list(range(3))


LOST_ADMISSION = """
from distributed import Worker

calls = []

async def lost_once(worker, real=Worker.set_resources, **resources):
    calls.append(resources)
    if len(calls) > 1:
        return await real(worker, **resources)
    worker.state.available_resources.update(resources)  # Dask also changes these first
    worker.state.total_resources.update(resources)
    raise OSError("the connection is lost")

Worker.set_resources = lost_once
"""


def test_a_worker_is_admitted_again_if_the_scheduler_did_not_receive_it(processes, tmp_path):
    with Cluster(processes.address) as pool:
        runs = submitted(pool, 3)
        changed_worker(processes, tmp_path, LOST_ADMISSION)
        assert [run.result(20.0)[2] for run in runs] == list(range(3))


def test_no_run_is_lost_with_a_scheduler_that_restarts(processes, pool):
    runs = submitted(pool, 20)
    next(as_completed(runs, WAIT_S))
    processes.processes[0].kill()
    processes.processes[0].wait(WAIT_S)
    for worker in processes.workers:
        worker.kill()
    processes.scheduler()
    processes.worker()
    assert numbers(runs) == list(range(20))


def test_a_worker_with_other_results_is_refused_by_name(processes, pool, messages):
    other = processes.worker(OPENBLAS_CORETYPE="Prescott")
    until(lambda: any("is refused" in line for line in messages))
    (line,) = (line for line in messages if "is refused" in line)
    assert "tcp://127.0.0.1:" in line
    assert "OPENBLAS_CORETYPE is 'Prescott', allowed: ''" in line
    found = {run.result(WAIT_S)[1] for run in submitted(pool, 10)}
    assert found
    assert other.pid not in found


def test_workers_without_the_packages_are_refused(processes, messages):
    processes.worker(PYTHONPATH="")
    with contextlib.ExitStack() as stack:
        while "is refused" not in "".join(messages):  # until it has joined
            try:
                stack.enter_context(Cluster(processes.address, report=messages.append))
            except PlateError as problem:
                assert "all 1 workers are refused" in str(problem)  # noqa: PT017
            stack.close()
    assert any("No module named 'plate_bringup'" in line for line in messages)


def test_what_is_canceled_ends_on_the_workers(pool, processes, messages):
    run = "(open({!r}, 'w').close(), sum(0 for _ in iter(int, 1)))"
    begun = [processes.folder / f"begun{k}" for k in range(2)]
    endless = [pool.submit(eval, run.format(str(file))) for file in begun]
    until(lambda: all(file.exists() for file in begun))
    pool.shutdown()
    assert not wait(endless, WAIT_S).not_done
    assert all(run.cancelled() for run in endless)
    with Cluster(processes.address, report=messages.append) as again:
        assert len({run.result(WAIT_S)[1] for run in submitted(again, 8)}) == 2


def test_a_run_ends_on_a_worker_of_which_the_cluster_does_not_know_yet(processes, monkeypatch):
    """Another cluster of the same code has accepted the worker."""
    for _ in range(2):
        processes.worker()
    monkeypatch.setattr(cluster, "POLL_S", 1000.0)
    run = "(open({!r}, 'w').close(), sum(0 for _ in iter(int, 1)))"
    begun = [processes.folder / f"begun{k}" for k in range(2)]
    with Cluster(processes.address) as unknowing:
        monkeypatch.undo()
        for file in begun:
            unknowing.submit(eval, run.format(str(file)))
        with Cluster(processes.address) as again:
            until(lambda: all(file.exists() for file in begun))
            unknowing.shutdown()
            assert len({run.result(WAIT_S)[1] for run in submitted(again, 8)}) == 2


def test_no_waiting_run_begins_after_a_stop(processes):
    """The message that cancels a run can reach a worker after the message that stops its run."""
    processes.worker()
    run = "(open({!r}, 'w').close(), sum(0 for _ in iter(int, 1)))"
    begun = [processes.folder / f"begun{k}" for k in range(3)]
    pool = Cluster(processes.address)
    results = [pool.submit(eval, run.format(str(file))) for file in begun]
    until(begun[0].exists)
    until(lambda: len(pool._sent) == 3)
    pool._sent.clear()  # nothing is canceled on the scheduler
    pool.shutdown()
    assert all(result.cancelled() for result in results)
    with Cluster(processes.address) as again:
        assert numbers(submitted(again, 2)) == [0, 1]
    assert [file.exists() for file in begun] == [True, False, False]


def test_an_error_of_a_run_is_raised_here(pool):
    with pytest.raises(ZeroDivisionError):
        pool.submit(eval, "1 / 0").result(WAIT_S)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere", "tcp://[", "udp://x:1"])
def test_an_address_without_a_scheduler_is_refused(address):
    with pytest.raises(PlateError, match="no Dask scheduler answers") as problem:
        Cluster(address)
    assert repr(address) in str(problem.value)


def test_a_server_of_another_kind_is_refused():
    """Such as the dashboard, whose address is also printed: it does not answer in Dask's way."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(PlateError, match="no Dask scheduler answers within 5 s"):
            Cluster(address)


def test_the_address_of_a_worker_is_refused(processes, tmp_path):
    processes.worker()
    log = tmp_path / f"{len(processes.processes) - 1}.log"
    until(lambda: "Registered to" in log.read_text(encoding="utf-8"))
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


def test_a_sweep_has_the_rows_of_one_by_processes(processes, tmp_path):
    """With a scenario and a planner that only this folder has, and one worker killed."""
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(short_task(0.01, 20)), encoding="utf-8")
    planner = (BENCH.parent / "examples/own_planner.py").read_text(encoding="utf-8")
    (tmp_path / "mine.py").write_text(planner, encoding="utf-8")
    workers = [processes.worker(), processes.worker()]
    words = [sys.executable, str(BENCH / "closed_loop.py"), "--scenario", "tiny.yaml"]
    words += ["--planner", "mine.py"]
    places = {"here": (), "there": ("--cluster", processes.address)}
    rows = {}
    for name, place in places.items():
        command = [*words, "--seeds", "0:4", *place, "--json", f"{name}.json"]
        with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as sweep:
            for line in sweep.stdout:
                if place and line.startswith("seed") and workers[0].poll() is None:
                    workers[0].kill()
        assert sweep.returncode == 0
        rows[name] = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
    assert [row["seed"] for row in rows["there"]] == list(range(4))
    here, there = (
        [{key: row[key] for key in row if key not in TIMINGS} for row in rows[name]]
        for name in places
    )
    assert here == there


@pytest.mark.needs("gymnasium")
def test_agents_are_evaluated_in_processes_of_the_workers(processes, tmp_path):
    """An agent that reports its parent process, in the file of its seed."""
    from plate_gym import bench  # only where there is gymnasium

    agent = """
import os
from plate_gym.agents import AGENTS

class Mine(AGENTS["A"]):
    def __init__(self, brief, seed):
        with open(f"{seed}.txt", "w") as file:
            file.write(str(os.getppid()))
        super().__init__(brief, seed)
"""
    (tmp_path / "mine.py").write_text(agent, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    workers = [processes.worker(**bench.ALIKE, PYTHONPATH=path) for _ in range(2)]
    words = ["--agent", "mine:Mine", "--task", "Sort4-v1", "--seeds", "0:2", "--json", "mine.json"]
    command = [sys.executable, "-m", "plate_gym.bench", *words]
    there = subprocess.run(
        [*command, "--cluster", processes.address], cwd=tmp_path, timeout=2 * WAIT_S, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    assert there.returncode == 0, there.stderr
    found = json.loads((tmp_path / "mine.json").read_text(encoding="utf-8"))
    parents = {int(file.read_text()) for file in tmp_path.glob("*.txt")}
    assert len(list(tmp_path.glob("[0-9]*.txt"))) == 2
    assert not parents & {os.getpid(), *(worker.pid for worker in workers)}
    (tmp_path / "mine.json").rename(tmp_path / "there.json")
    here = subprocess.run(command, cwd=tmp_path, timeout=2 * WAIT_S, check=False)
    assert here.returncode == 0
    again = json.loads((tmp_path / "mine.json").read_text(encoding="utf-8"))
    rows = [
        [
            {key: row[key] for key in row if key not in bench.TIMES}
            for row in one["tasks"]["Sort4-v1"]["rows"]
        ]
        for one in (found, again)
    ]
    assert rows[0] == rows[1]
    assert [row["seed"] for row in rows[0]] == [0, 1]
