"""Parallel runs: their results, progress, and stored results."""

import json
import os
import select
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.machinery import PathFinder
from pathlib import Path
from threading import Event

import pytest

from harness import Cache, Rows, cache, parallel, resumed
from plate_bringup import identity
from plate_core import PlateError


def late(seconds, value):
    time.sleep(seconds)
    return value


def refuse(seconds, value):
    raise PlateError(f"run {value} refused")


def test_results_come_with_their_index_as_they_are_done():
    notes, results, others_are_here = [], [], Event()

    def run(value):
        assert value != "a" or others_are_here.wait(60)
        return value

    with ThreadPoolExecutor(4) as workers:
        for result in parallel(workers, run, [*"abcd"], notes.append):
            results.append(result)
            if len(results) == 3:
                others_are_here.set()
    assert sorted(results) == list(enumerate("abcd"))
    assert results[-1] == (0, "a")
    assert [note.split(" runs")[0] for note in notes] == [f"{i} of 4" for i in (1, 2, 3, 4)]
    assert notes[-1].endswith("about 0 s left")


def test_a_refused_run_is_reported_and_ends_the_work():
    with ThreadPoolExecutor(1) as workers:
        results = parallel(workers, late, [(0.0, 1)])
        assert list(results) == [(0, 1)]
        with pytest.raises(PlateError, match="run 0 refused"):
            list(parallel(workers, refuse, [(0.0, i) for i in range(9)]))


def test_remaining_work_is_not_started_after_the_results_are_closed():
    started, closed = [], Event()

    def run(number):
        started.append(number)
        assert number == 0 or closed.wait(60)

    with ThreadPoolExecutor(1) as workers:
        results = parallel(workers, run, [(number,) for number in range(50)])
        next(results)
        results.close()
        closed.set()
    assert started in ([0], [0, 1])


def test_an_interrupted_measurement_can_be_continued(tmp_path):
    started, path, work = [], tmp_path / "runs.jsonl", {str(i): (i,) for i in range(5)}

    def run(i):
        if i == 3 and len(started) < 5:
            raise PlateError("interrupted")
        started.append(i)
        return {"value": i / 3}

    with ThreadPoolExecutor(1) as workers, pytest.raises(PlateError, match="interrupted"):
        resumed(workers, run, work, Cache(path, "code"))
    done = started.copy()  # a run that has begun before the error is also kept
    assert done in ([0, 1, 2], [0, 1, 2, 4])
    assert len(list(filter(None, path.read_text().splitlines()))) == len(done)
    started[:] = [None] * 5
    with ThreadPoolExecutor(1) as workers:
        rows = resumed(workers, run, work, Cache(path, "code"))
        assert started[5:] == [i for i in range(5) if i not in done]
        assert rows == [{"value": i / 3} for i in range(5)]
        resumed(workers, run, {"0": (0,)}, Cache(path, "other code"))
        assert started[-1] == 0


def test_a_measurement_continues_after_an_incomplete_line(tmp_path):
    """Such as after a full disk."""
    path = tmp_path / "runs.jsonl"
    first = Cache(path, "code")
    first["a"] = 1
    first["b"] = 2
    path.write_text(path.read_text()[:-5])
    Cache(path, "code")["c"] = 3
    again = Cache(path, "code")
    assert [key in again for key in "abc"] == [True, False, True]
    assert again["c"] == 3


def test_processes_end_with_a_killed_parent(tmp_path):
    code = "import os\nfrom harness import executor\nif __name__ == '__main__':\n"
    code += (
        "    print(executor(1).submit(os.getpid).result(), flush=True)\n    os.kill(os.getpid(), 9)"
    )
    (tmp_path / "program.py").write_text(code)
    words = [sys.executable, tmp_path / "program.py"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(words, env=env, stdout=subprocess.PIPE) as program:
        assert int(program.stdout.readline()) != program.pid
        # the pipe closes when the process of the executor has also ended
        assert select.select([program.stdout], [], [], 60)[0]
        assert program.stdout.read() == b""


def test_processes_end_whose_parent_is_killed_while_they_start(tmp_path):
    """They load the program, wait for the end of the parent, and then call their initial
    function."""
    code = (
        "import os, time\nfrom pathlib import Path\nfrom harness import executor\n"
        "if __name__ == '__main__':\n"
        "    executor(1).submit(os.getpid)\n"
        "    while not Path('parent').exists(): time.sleep(0.01)\n"
        "    os.kill(os.getpid(), 9)\n"
        "parent = os.getppid()\n"
        "Path('parent').touch()\n"
        "while os.getppid() == parent: time.sleep(0.01)\n"
    )
    (tmp_path / "program.py").write_text(code)
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "program.py"]
    with subprocess.Popen(words, cwd=tmp_path, env=env, stdout=subprocess.PIPE) as program:
        assert program.wait(60) == -signal.SIGKILL
        # the pipe closes when the process of the executor has also ended
        assert select.select([program.stdout], [], [], 30)[0]
        assert program.stdout.read() == b""


def test_the_digest_is_that_of_the_sources(monkeypatch, tmp_path):
    for name in identity.PACKAGES:
        (tmp_path / f"plate_{name}").mkdir()
        (tmp_path / f"plate_{name}" / "__init__.py").write_text(f"NAME = {name!r}\n")
    # Also modules that were imported from elsewhere.
    found = lambda name: PathFinder.find_spec(name, [str(tmp_path)])  # noqa: E731
    monkeypatch.setattr(identity, "find_spec", found)
    marks = []
    for file, text in (("a.py", "1"), ("a.py", "1"), ("a.py", "2"), ("b.hpp", "3")):
        (tmp_path / "plate_sim" / file).write_text(text)
        marks.append(identity.code_of_packages.__wrapped__())
    assert marks[0] == marks[1]
    assert len(set(marks)) == 3


def test_a_module_depends_on_what_it_imports():
    names = {"/".join(path.parts[-2:]) for path in cache.own_files("tasks.rigs")}
    assert {"tasks/rigs.py", "tasks/runs.py", "harness/cache.py"} <= names
    assert "tasks/serial.py" not in names


MARKS = {"code": "c", "settings": "s", "machine": {"numpy": "2", "scipy": "1"}}
MACHINE = json.dumps(MARKS["machine"])


def test_two_calls_at_once_do_not_write_one_file(tmp_path):
    path = tmp_path / "rows.json"
    with Rows(path, MARKS) as rows:
        rows.add({"seed": 1})
        with pytest.raises(PlateError, match=r"rows.json is in use"):
            Rows(path, MARKS)
    assert list(Rows(path, MARKS).by_seed) == [1]


def test_a_second_call_finds_the_rows_of_the_first(tmp_path):
    path = tmp_path / "made" / "rows.json"
    with suppress(KeyboardInterrupt), Rows(path, MARKS) as rows:
        for seed in (7, 3):
            rows.add({"seed": seed, "success": True})
        raise KeyboardInterrupt
    assert json.loads(path.read_text()) == [
        {"seed": seed, "success": True, **MARKS} for seed in (3, 7)
    ]
    assert sorted(Rows(path, MARKS).by_seed) == [3, 7]
    assert [file.name for file in path.parent.iterdir()] == ["rows.json"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            f'[{{"seed": 3, "code": "other", "settings": "s", "machine": {MACHINE}}}]',
            ("seed 3", "code 'other'", "'c'"),
        ),
        (
            f'[{{"seed": 3, "code": "c", "settings": "x", "machine": {MACHINE}}}]',
            ("seed 3", "settings 'x'", "'s'"),
        ),
        (
            '[{"seed": 3, "code": "c", "settings": "s", "machine": {"numpy": "1", "scipy": "1"}}]',
            ("seed 3", "numpy '1'", "'2'"),
        ),
        (
            '[{"seed": 3, "code": "c", "settings": "s", "machine": {"numpy": "2"}}]',
            ("seed 3", "scipy None", "'1'"),
        ),
        (
            '[{"seed": 3, "code": "c", "settings": "s", "machine": "here"}]',
            ("seed 3", "machine 'here'", "{'numpy': '2'"),
        ),
        ('[{"seed": 3}]', ("code, machine, seed, settings",)),
        (
            f'[{{"seed": "3", "code": "c", "settings": "s", "machine": {MACHINE}}}]',
            ("code, machine, seed, settings",),
        ),
        ('{"seed": 3}', ("code, machine, seed, settings",)),
        ("[" * 100_000, ("is not JSON",)),
        ("[{", ("is not JSON",)),
    ],
)
def test_rows_of_another_code_and_other_files_are_refused_and_kept(tmp_path, content, words):
    path = tmp_path / "rows.json"
    path.write_text(content)
    with pytest.raises(PlateError) as problem:
        Rows(path, MARKS)
    for word in (str(path), "allowed", *words):
        assert word in str(problem.value)
    assert path.read_text() == content


def test_without_new_rows_the_file_stays_the_same(tmp_path):
    path = tmp_path / "rows.json"
    content = json.dumps([{"seed": 3, **MARKS}])
    path.write_text(content)
    with Rows(path, MARKS):
        pass
    assert path.read_text() == content
    with Rows(tmp_path / "other.json", MARKS):
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["rows.json"]


def test_rows_also_go_to_a_pipe(tmp_path):
    with Rows(Path("/dev/null"), MARKS) as rows:
        rows.add({"seed": 1})
    assert not Path("/dev/null").is_file()
    with pytest.raises(OSError, match="null"):
        Rows(Path("/dev/null/rows.json"), MARKS)
