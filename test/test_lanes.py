"""Workers of a run of the tests: who takes which files, and who gives way."""

from types import SimpleNamespace

import pytest

pytest.importorskip("xdist")

import lanes

FILES = ("src/a.py", "test/b.py", "src/c.py", "test/d.py")
TESTS = [f"{file}::test_{n}" for n in range(3) for file in FILES]


@pytest.fixture(autouse=True)
def _files(tmp_path, monkeypatch):
    """All files of test/ except d.py start nodes."""
    monkeypatch.setattr(lanes, "ROOT", tmp_path)
    lanes.computes.cache_clear()
    (tmp_path / "test").mkdir()
    for name in ("b", *map(str, range(9))):
        (tmp_path / f"test/{name}.py").write_text("from graph.session import session\n")
    (tmp_path / "test/d.py").write_text("from plate_bringup.loop import run\n")
    yield
    lanes.computes.cache_clear()


class Worker:
    """Workers as in pytest-xdist: `tests` are the assigned tests."""

    def __init__(self, number, count):
        self.workerinput = {"workerid": f"gw{number}", "workercount": count}
        self.gateway = SimpleNamespace(id=f"gw{number}")
        self.shutting_down, self.tests = False, []

    def send_runtest_some(self, indices):
        assert not self.shutting_down
        self.tests += indices

    def shutdown(self):
        self.shutting_down = True


def started(tests, count):
    """The distribution of tests among workers that have just begun."""
    config = SimpleNamespace(
        option=SimpleNamespace(loadscopereorder=True),
        getvalue=lambda name: [f"{count}*popen"] if name == "tx" else None,
    )
    workers, found = [Worker(n, count) for n in range(count)], lanes.Lanes(config)
    for worker in workers:
        found.add_node(worker)
        found.add_node_collection(worker, tests)
    found.schedule()
    return found, workers


def run(found, workers, tests, of=None):
    """Let workers run all that they are given, one test each in turn; the files of each."""
    ran = {worker: [] for worker in workers}
    while any(len(ran[w]) < len(w.tests) for w in workers if of in (None, w)):
        for worker in workers:
            if of in (None, worker) and len(ran[worker]) < len(worker.tests):
                ran[worker].append(test := worker.tests[len(ran[worker])])
                found.mark_test_complete(worker, test)
    return [[tests[test].split("::")[0] for test in ran[worker]] for worker in workers]


def test_half_of_the_workers_begin_with_real_nodes_and_take_what_is_left():
    found, (front, behind) = started(TESTS, 2)
    files, _ = run(found, [front, behind], TESTS, of=front)
    assert files == ["test/b.py"] * 3 + ["src/c.py"] * 3 + ["test/d.py"] * 3
    _, files = run(found, [front, behind], TESTS, of=behind)
    assert files == ["src/a.py"] * 3
    assert found.tests_finished
    assert behind.shutting_down
    assert front.shutting_down


def test_tests_of_real_nodes_give_way_only_when_nothing_else_is_left():
    nodes = [f"test/{n}.py::test" for n in range(9)]
    tests = [*nodes, "src/a.py::test", "src/c.py::test"]
    found, workers = started(tests, 4)
    first, second, behind, last = run(found, workers, tests)
    assert all(name.startswith("test/") for name in first + second + behind[1:])
    assert (behind[0], last) == ("src/a.py", ["src/c.py"])
    assert sum(map(len, (first, second, behind, last))) == len(tests)
    assert len(behind) > 1
    assert all(worker.shutting_down for worker in workers)
    assert found.tests_finished


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("file", ["src/a.py", "test/b.py"])
def test_files_of_one_kind_are_all_run(file, count):
    tests = [f"{file}::test_{n}" for n in range(5)] + [f"{file}::Group::test"]
    found, workers = started(tests, count)
    assert [name for names in run(found, workers, tests) for name in names] == [file] * 6
    assert all(worker.shutting_down for worker in workers)
    assert found.tests_finished


@pytest.mark.parametrize(
    ("number", "count", "front"),
    [(0, 1, True), (1, 2, False), (1, 3, False), (1, 4, True), (2, 4, False), (4, 4, True)],
)
def test_workers_of_later_lanes_have_lower_priority(monkeypatch, number, count, front):
    """A worker that replaces a crashed one gets its lane, or an earlier one."""
    given = []
    monkeypatch.setattr("os.nice", given.append)
    lanes.give_way({"workerid": f"gw{number}", "workercount": count})
    assert given == ([] if front else [lanes.BEHIND])
