"""Spreading runs: their order, what is said of them, and workers that would give other numbers."""

import pickle
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from plate_core import PlateError

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.fixture(name="module")
def _module(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH))
    import spread

    return spread


def late(seconds, value):
    time.sleep(seconds)
    return value


def refuse(seconds, value):
    raise PlateError(f"run {value} refused")


class Nobody(Executor):
    """An executor whose workers lack a module."""

    def submit(self, *_):
        future = Future()
        future.set_exception(ModuleNotFoundError("No module named 'loop'"))
        return future


@pytest.fixture(autouse=True)
def _pickled_here(monkeypatch):
    """This file is no module that could be imported: run what was pickled without pickling it."""
    monkeypatch.setattr(pickle, "dumps", lambda task: task)
    monkeypatch.setattr(pickle, "loads", lambda task: task)


def test_results_come_in_order_whoever_is_first(module):
    notes = []
    work = [(0.2, "a"), (0.0, "b"), (0.1, "c"), (0.0, "d")]
    with ThreadPoolExecutor(4) as pool:
        results = list(module.spread(pool, late, work, notes.append))
    assert results == ["a", "b", "c", "d"]
    assert [note.split(" in ")[0] for note in notes] == [f"{i} of 4 done" for i in (1, 2, 3, 4)]
    assert notes[-1].endswith("about 0 s left")


def test_a_refused_run_is_told_and_ends_the_work(module):
    with ThreadPoolExecutor(1) as pool:
        results = module.spread(pool, late, [(0.0, 1)], [].append)
        assert list(results) == [1]
        with pytest.raises(PlateError, match="run 0 refused"):
            list(module.spread(pool, refuse, [(0.0, i) for i in range(9)], [].append))


def test_what_is_left_is_not_started_when_nobody_wants_it(module):
    started = []
    with ThreadPoolExecutor(1) as pool:
        work = [(0.01, i) for i in range(50)]
        results = module.spread(pool, lambda s, i: started.append(late(s, i)), work, [].append)
        next(results)
        results.close()
    assert 1 <= len(started) < 50


def test_an_interrupted_measurement_goes_on(module, tmp_path):
    started, path, work = [], tmp_path / "runs.jsonl", [(i,) for i in range(5)]

    def run(i):
        if i == 3 and len(started) < 5:
            raise PlateError("interrupted")
        started.append(i)
        return {"value": i / 3}

    with ThreadPoolExecutor(1) as pool:
        with pytest.raises(PlateError, match="interrupted"):
            list(module.resumed(pool, run, work, path))
        assert len(path.read_text().splitlines()) == 3
        started[:] = [None] * 5
        rows = list(module.resumed(pool, run, work, path))
        assert started[5:] == [3, 4]
        assert rows == [{"value": i / 3} for i in range(5)]
        # Of other code nothing counts.
        list(module.resumed(pool, run, work[:1], path, ("harness",)))
        assert started[5:] == [3, 4, 0]


def test_workers_without_our_code_are_told_of(module):
    with pytest.raises(
        PlateError, match=r"lack code \(No module named 'loop'\), expected: the same"
    ):
        list(module.spread(Nobody(), late, [(0.0, 1)], [].append))


def test_a_worker_with_other_code_refuses(module):
    mark = module.fingerprint()
    assert mark.startswith("sources ")
    assert "numpy " in mark
    assert module._checked(mark, (late, (0.0, 5))) == 5
    with pytest.raises(PlateError, match=r"other code \(sources .*\) than we have \(sources 0\)"):
        module._checked("sources 0", (late, (0.0, 5)))


def test_the_fingerprint_is_that_of_the_sources(module, monkeypatch, tmp_path):
    for name in module.SOURCES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"NAME = {name!r}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(module, "find_spec", _fresh(tmp_path))
    marks = []
    for text in ("X = 1\n", "X = 1\n", "X = 2\n"):
        (tmp_path / "plate_sim" / "part.py").write_text(text)
        module.fingerprint.cache_clear()
        marks.append(module.fingerprint())
    module.fingerprint.cache_clear()
    assert marks[0] == marks[1] != marks[2]


def _fresh(folder):
    """Find modules in a folder, also those that have been imported from elsewhere."""
    from importlib.machinery import PathFinder

    return lambda name: PathFinder.find_spec(name, [str(folder)])
