"""Spreading runs: their order, what is said of them, and what is kept."""

import time
from concurrent.futures import ThreadPoolExecutor
from importlib.machinery import PathFinder

import pytest

from harness import Cache, cache, parallel, resumed
from plate_core import PlateError


def late(seconds, value):
    time.sleep(seconds)
    return value


def refuse(seconds, value):
    raise PlateError(f"run {value} refused")


def test_results_come_in_order():
    notes = []
    work = [(0.2, "a"), (0.0, "b"), (0.1, "c"), (0.0, "d")]
    with ThreadPoolExecutor(4) as workers:
        results = list(parallel(workers, late, work, notes.append))
    assert results == ["a", "b", "c", "d"]
    assert [note.split(" in ")[0] for note in notes] == [f"{i} of 4 done" for i in (1, 2, 3, 4)]
    assert notes[-1].endswith("about 0 s left")


def test_a_refused_run_is_told_and_ends_the_work():
    with ThreadPoolExecutor(1) as workers:
        results = parallel(workers, late, [(0.0, 1)], [].append)
        assert list(results) == [1]
        with pytest.raises(PlateError, match="run 0 refused"):
            list(parallel(workers, refuse, [(0.0, i) for i in range(9)], [].append))


def test_what_is_left_is_not_started_when_nobody_wants_it():
    started = []
    with ThreadPoolExecutor(1) as workers:
        work = [(0.01, i) for i in range(50)]
        results = parallel(workers, lambda s, i: started.append(late(s, i)), work, [].append)
        next(results)
        results.close()
    assert 1 <= len(started) < 50


def test_an_interrupted_measurement_goes_on(tmp_path):
    started, path, work = [], tmp_path / "runs.jsonl", {str(i): (i,) for i in range(5)}

    def run(i):
        if i == 3 and len(started) < 5:
            raise PlateError("interrupted")
        started.append(i)
        return {"value": i / 3}

    with ThreadPoolExecutor(1) as workers, pytest.raises(PlateError, match="interrupted"):
        resumed(workers, run, work, Cache(path, "code"))
    assert len(path.read_text().splitlines()) == 3
    started[:] = [None] * 5
    with ThreadPoolExecutor(1) as workers:
        rows = resumed(workers, run, work, Cache(path, "code"))
        assert started[5:] == [3, 4]
        assert rows == [{"value": i / 3} for i in range(5)]
        resumed(workers, run, {"0": (0,)}, Cache(path, "other code"))
        assert started[5:] == [3, 4, 0]


def test_the_digest_is_that_of_the_sources(monkeypatch, tmp_path):
    for name in cache.PACKAGES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"NAME = {name!r}\n")
    # Also those that have been imported from elsewhere.
    found = lambda name: PathFinder.find_spec(name, [str(tmp_path)])  # noqa: E731
    monkeypatch.setattr(cache, "find_spec", found)
    marks = []
    for text in ("X = 1\n", "X = 1\n", "X = 2\n"):
        (tmp_path / "plate_sim" / "part.py").write_text(text)
        cache.code_of.cache_clear()
        cache.code_of_packages.cache_clear()
        marks.append(cache.code_of_packages())
    cache.code_of.cache_clear()
    cache.code_of_packages.cache_clear()
    assert marks[0] == marks[1] != marks[2]


def test_a_module_depends_on_what_it_imports():
    names = {"/".join(path.parts[-2:]) for path in cache.own_files("tasks.control")}
    assert {"tasks/control.py", "tasks/runs.py", "harness/cache.py"} <= names
    assert "tasks/serial.py" not in names
