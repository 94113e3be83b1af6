"""Hostile agents: each end of an agent is named, and no process outlives its episode."""

import ctypes
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import pytest

from plate_core import PlateError

pytestmark = pytest.mark.needs("gymnasium")


@pytest.fixture(scope="module")
def bench():
    import plate_gym.bench

    yield plate_gym.bench
    plate_gym.bench.isolation.stop()


HOSTILE = """
import ctypes, json, os, signal, subprocess, sys, threading, time
from pathlib import Path

from plate_gym.result import ROW

class Base:
    action, observation = "motion", "parts"
    def __init__(self, brief, seed): self.space = brief.action_space
    def act(self, seen, info):
        self.do()
        return 0 * self.space.sample()

def noted(process):
    with open("pids", "a") as file:
        print(process, file=file)

def until_noted(count):
    Path("pids").touch()
    while Path("pids").read_bytes().count(b"\\n") < count: time.sleep(0.01)

def sends(reply):
    os.write(3, json.dumps(reply).encode() + b"\\n")
    time.sleep(1e6)

class Unreadable(Exception):
    def __str__(self): raise RuntimeError

class Generator(Base):
    def do(self): raise GeneratorExit
class Any(Base):
    def do(self): raise BaseException("\\x1b[2Jgone")
class Interrupt(Base):
    def do(self): raise KeyboardInterrupt
class NoText(Base):
    def do(self): raise Unreadable
class LongText(Base):
    def do(self): raise ValueError("x" * 10**8)
class Fault(Base):
    def do(self): ctypes.string_at(0)
class Parent(Base):
    def do(self): os.kill(os.getppid(), signal.SIGKILL); time.sleep(1e6)
class Group(Base):
    def do(self): os.kill(0, signal.SIGKILL); time.sleep(1e6)
class Closes(Base):
    def do(self): os.closerange(0, 1000)
class EndsSlowly(Base):  # as on a busy computer: its main thread ends 2 s before the other one
    def do(self):
        def end():
            time.sleep(0.2)
            os.close(3)
            time.sleep(2.0)
            os._exit(7)
        threading.Thread(target=end).start()
        ctypes.CDLL(None).syscall(60, 0)
class Forges(Base):
    def do(self): os.write(3, b'{"row": {}}\\n'); time.sleep(1e6)
class Fills(Base):
    def do(self): os.write(3, b"{" * 10**6)
class OtherSeed(Base):
    def do(self): sends({"row": {key: kind() for key, kind in ROW.items()} | {"seed": 4}})
class Negative(Base):
    def do(self): sends({"row": {key: kind(-1) for key, kind in ROW.items()} | {"seed": 3}})
class Number(Base):
    def do(self): sends({"error": 5})
class Never(Base):
    def do(self): signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 64)); time.sleep(1e6)
class Stops(Base):
    def do(self): os.kill(os.getpid(), signal.SIGSTOP)
class Large(Base):
    def do(self): self.kept = b"x" * 2_000_000_000
class LargeTogether(Base):
    def do(self):
        for _ in range(3):
            if not os.fork():
                kept = b"x" * 600_000_000
                time.sleep(1e6)
        time.sleep(1e6)
class Many(Base):
    def do(self):
        for _ in range(300):
            if not os.fork(): time.sleep(1e6)
        time.sleep(1e6)
class Daemon(Base):
    def do(self):
        noted(subprocess.Popen(["sleep", "1000"], start_new_session=True, env={}).pid)
        if not os.fork():
            os.setsid()
            if not os.fork():
                noted(os.getpid())
                os.closerange(0, 1000)
                time.sleep(1e6)
            os._exit(0)
        until_noted(2)
        raise RuntimeError("done")
class DaemonOfKiller(Base):
    def do(self):
        if not os.fork():
            os.setsid()
            if os.fork(): os._exit(0)
            noted(os.getpid())
            time.sleep(1e6)
        until_noted(1)
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(1e6)
class NamelessOfKiller(Base):
    def do(self):
        noted(subprocess.Popen(["sleep", "1000"], start_new_session=True, env={}).pid)
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(1e6)
class Beats(Base):
    def do(self):
        while True:
            os.write(3, b".")
            time.sleep(0.1)
class Rare(Base):
    def do(self): os.kill(os.getpid(), 40); time.sleep(1e6)
class LargeFile(Base):
    def do(self): os.posix_fallocate(os.memfd_create("a"), 0, 2_000_000_000)
class Prints(Base):
    def do(self):
        for _ in range(100): print("x" * 10**6)
        raise RuntimeError("done")
class Escapes(Base):
    def do(self):
        os.write(2, "A\\x1b[2JB\\x9b2JC\\u202eD\\tE\\rF\\nG".encode() + b"\\x9b")
        raise RuntimeError("done")
"""


@pytest.fixture
def hostile(bench, tmp_path, monkeypatch):
    """A function that runs a hostile agent, with low limits. If the agent shall fail for another
    reason, `decision_s` is the default limit, which also allows for a busy computer."""
    (tmp_path / "hostile.py").write_text(HOSTILE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)

    def run(name, decision_s=bench.LIMITS.decision_s):
        limits = bench.Limits(decision_s=decision_s, memory_gb=1)
        messages = []
        found = bench.evaluate(
            f"hostile:{name}", "Sort4-v1", [3], workers=1, report=messages.append, limits=limits
        )
        return found, messages

    return run


@pytest.fixture
def printed(bench, capfd):
    """A function that returns the output that a new supervisor has written."""
    bench.isolation.stop()
    yield lambda: capfd.readouterr().err
    bench.isolation.stop()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Generator", "step 0: GeneratorExit$"),
        ("Any", r"step 0: BaseException: \?\[2Jgone$"),
        ("Interrupt", "step 0: KeyboardInterrupt$"),
        ("NoText", r"step 0: Unreadable: \(its text cannot be read: RuntimeError\)$"),
        ("LongText", r"step 0: ValueError: x{200,300}\.\.\.$"),
        ("Fault", "step 0: its process died: it was ended by SIGSEGV$"),
        ("Rare", "step 0: its process died: it was ended by signal 40$"),
        ("LargeFile", r"step 0: OSError: \[Errno 27\] File too large$"),
        ("Parent", "its supervisor failed: it has ended$"),
        ("Group", "step 0: its process died: it was ended by SIGKILL$"),
        ("Closes", "step 0: its process died: it exited with code 0 before its last step$"),
        ("EndsSlowly", "step 0: its process died: it exited with code 7 before its last step$"),
        ("Forges", " has , allowed: time_s, "),
        ("OtherSeed", "seed of the row is 4, allowed: 3$"),
        ("Negative", ": start_ms is -1.0, allowed: 0 or more$"),
        ("Number", "step 0: its process closed its pipe, or sent no valid reply$"),
        ("Fills", "step 0: its process closed its pipe, or sent no valid reply$"),
    ],
)
def test_any_end_of_an_agent_is_named_as_its_own(bench, hostile, name, words):
    with pytest.raises(PlateError, match=f"^agent hostile:{name}, Sort4-v1, seed 3.*{words}"):
        hostile(name)


@pytest.mark.parametrize(
    ("name", "failure"),
    [
        ("Never", "no decision within 2 s"),
        ("Stops", "no decision within 2 s"),
        ("Large", "more than 1 GB of memory"),
        ("LargeTogether", "more than 1 GB of memory"),
        ("Many", "more than 256 processes"),
    ],
)
def test_an_episode_in_which_a_limit_is_exceeded_counts_as_failed(bench, hostile, name, failure):
    found, messages = hostile(name, 2.0) if "decision" in failure else hostile(name)
    found = json.loads(json.dumps(found))
    assert messages[0] == f"failed: agent hostile:{name}, Sort4-v1, seed 3, step 0: {failure}"
    (row,) = found["tasks"]["Sort4-v1"]["rows"]
    assert (row["success"], row["failure"]) == (False, failure)
    assert found["tasks"]["Sort4-v1"]["success"] == 0
    bench.validate(found)
    row["success"] = True
    with pytest.raises(PlateError, match="success is True, allowed in a row with a failure: False"):
        bench.validate(found)


@pytest.mark.parametrize(
    "text",
    [
        "{}", '{"error": 5}', '{"failure": null}', "[]", '{"row": []}', '{"row": {}, "error": "a"}',
        '{"row": {}, "steps": "1"}', '{"error": "a", "more": 1}', "[" * 50_000, "NaN", "",
    ],
)  # fmt: skip
def test_a_reply_of_another_form_is_refused(bench, text):
    with pytest.raises(ValueError):
        bench.isolation.parsed(text.encode())


@pytest.mark.parametrize(
    ("end", "words"),
    [("", r"no reply within 0\.1 s"), ("&", "it has ended")],
    ids=["runs", "dead"],
)
def test_the_wait_for_forged_signs_of_life_ends(bench, tmp_path, monkeypatch, end, words):
    """An agent can stop its supervisor and send these lines itself. The wait must still end."""
    program = tmp_path / "supervisor"
    program.write_text(f"#!/bin/sh\nfor k in $(seq 200); do echo .; sleep 0.1; done {end}\n")
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(bench.isolation, "ENDING_S", 0.1)
    supervisor = bench.isolation.Supervisor()
    with pytest.raises(OSError, match=words):
        supervisor._reply(100 if end else 0.1)
    supervisor.close()


SUPERVISOR = """#!/bin/sh
echo .
read request
case $request in
*endless*) echo begun > begun; while echo .; do sleep 0.1; done;;
*) until [ -e ended ]; do echo .; sleep 0.1; done; echo '{"error": "done"}'; read end; exit 0;;
esac
"""


def until(condition):
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_an_exception_from_another_thread_ends_one_supervisor(bench, tmp_path, monkeypatch):
    """A cluster raises it to end a run. Another run on the same worker continues, and its
    supervisor ends later, because it is idle."""
    isolation = bench.isolation
    isolation.stop()
    program = tmp_path / "supervisor"
    program.write_text(SUPERVISOR)
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(isolation, "IDLE_S", 0.1)
    monkeypatch.setattr(isolation, "ENDING_S", 0.1)
    monkeypatch.chdir(tmp_path)
    replies = {}

    def play(name):
        try:
            replies[name] = isolation.play({"agent": name}, bench.LIMITS)
        except ZeroDivisionError:
            replies[name] = "stopped"

    threads = {name: Thread(target=play, args=(name,)) for name in ("short", "endless")}
    for thread in threads.values():
        thread.start()
    until(lambda: (tmp_path / "begun").exists() and len(isolation._all) == 2)
    number = ctypes.c_ulong(threads["endless"].ident)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(number, ctypes.py_object(ZeroDivisionError))
    threads["endless"].join()
    monkeypatch.setattr(isolation, "ENDING_S", 60.0)  # the other one ends by itself
    (left,) = isolation._all
    assert left._process.poll() is None
    (tmp_path / "ended").touch()
    threads["short"].join()
    assert replies == {"endless": "stopped", "short": {"steps": 0, "error": "done"}}
    assert left._process.wait(60) == 0
    until(lambda: not isolation._all)


def reply_of(bench, name, folder, code):
    """The reply of a supervisor in which the code `code` has changed something."""
    request = {"agent": f"hostile:{name}", "world": "nominal", "task": "Sort4-v1", "seed": 3}
    request |= {"path": sys.path, "folder": str(folder)}
    request |= {"limits": {"decision_s": 10, "memory_gb": 1}}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
    code = f"import plate_gym.isolation, plate_gym.supervisor as own\n{code}\nown.main()"
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as process:
        process.stdin.write(json.dumps(request).encode() + b"\n")
        reply = next(line for line in process.stdout if line != bench.isolation.ALIVE)
    return json.loads(reply)


def test_signs_of_life_do_not_extend_an_episode_beyond_its_limit(bench, hostile, tmp_path):
    """An agent that sends them itself."""
    code = "plate_gym.isolation.EPISODE_FACTOR = 0.2"
    reply = reply_of(bench, "Beats", tmp_path, code)
    assert reply["failure"] == "no end of the episode within 2 s"


@pytest.mark.parametrize("full", ["memory", "the disk"])
def test_an_episode_ends_before_files_fill_the_computer(bench, hostile, tmp_path, full):
    """The run ends too, because other programs may have made the files."""
    code = (
        "free = iter([2e9, 0.51e9])\n"
        f"own._free_bytes = lambda folder: {{'{full}': next(free, 0.49e9)}}"
    )
    reply = reply_of(bench, "Never", tmp_path, code)
    assert reply["error"].endswith(f"step 0: stopped, because only 0.49 GB of {full} are free")


def test_free_memory_and_disks_are_those_of_the_system(bench, tmp_path):
    import shutil

    import plate_gym.supervisor

    free = plate_gym.supervisor._free_bytes(str(tmp_path))
    assert free["the disk"] == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.2)
    assert 0 < free["memory"] < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert set(plate_gym.supervisor._free_bytes(str(tmp_path / "deleted"))) == set(free) - {
        "the disk"
    }


@pytest.mark.parametrize("name", ["Daemon", "DaemonOfKiller", "NamelessOfKiller"])
def test_no_process_of_an_agent_outlives_its_episode(hostile, tmp_path, name):
    with pytest.raises(PlateError, match=r"RuntimeError: done|its supervisor failed"):
        hostile(name)
    pids = (tmp_path / "pids").read_text().split()
    assert len(pids) == (2 if name == "Daemon" else 1)
    for pid in pids:
        try:
            status = Path(f"/proc/{pid}/status").read_text()
        except OSError:
            continue
        assert "State:\tZ" in status  # ended, but not yet noticed by the process with id 1


def test_most_of_a_long_output_is_omitted(hostile, printed):
    with pytest.raises(PlateError, match="RuntimeError: done"):
        hostile("Prints")
    output = printed()
    assert output.count("x") < 101_000
    assert "seed 3, step 0: omitted the agent's output after 100,000 bytes\n" in output


def test_output_of_an_agent_cannot_imitate_that_of_the_supervisor(hostile, printed):
    with pytest.raises(PlateError, match="RuntimeError: done"):
        hostile("Escapes")
    lines = printed().splitlines()
    assert lines == ["agent: A?[2JB?2JC?D E", "agent: F", "agent: G\ufffd"]
