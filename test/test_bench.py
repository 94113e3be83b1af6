"""The measuring programs: their output, their refusals, and that runs repeat."""

import ast
import json
import math
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path
from string import Formatter
from types import SimpleNamespace

import closed_loop
import numpy as np
import pytest
import run
import yaml
from shaking import from_rest
from short_task import short_task

from harness import MEASUREMENTS, Result, of_median, of_rate, rate_text
from harness.measurements import MAX_CORES, busy_cores
from harness.result import TEXTS
from plate_core import load_rig

BENCH = Path(__file__).resolve().parents[1] / "bench"
TIMINGS = {
    "solve_ms_median", "solve_ms_p99", "step_ms_median", "step_ms_p99", "late_cycles", "load",
}  # fmt: skip
"""Values that depend on the machine and on its load."""

TINY = short_task(0.01, 20)


def bench(program, *arguments):
    return subprocess.run(
        [sys.executable, str(BENCH / program), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Run the same two seeds in a place given by arguments: returns the rows."""
    folder = tmp_path_factory.mktemp("bench")
    scenario = folder / "tiny.yaml"
    scenario.write_text(yaml.safe_dump(TINY), encoding="utf-8")

    def rows(*place, file="", seeds="3:5"):
        file = folder / (file or f"rows{len(list(folder.iterdir()))}.json")
        words = [*map(str, ("--scenario", scenario, "--seeds", seeds, *place, "--json", file))]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["closed_loop", *words])
            assert closed_loop.main() == 0
        return json.loads(file.read_text(encoding="utf-8"))

    return rows


@pytest.fixture(scope="module")
def runs(tiny):
    """Rows of the same two seeds, twice: run by one process and by two."""
    return [tiny("--workers", workers) for workers in (1, 2)]


def without_timings(rows):
    return [{key: row[key] for key in row if key not in TIMINGS} for row in rows]


def test_a_terminated_command_has_written_the_rows_that_it_has_printed(tmp_path):
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(TINY), encoding="utf-8")
    words = [sys.executable, str(BENCH / "closed_loop.py"), "--scenario", "tiny.yaml"]
    words += ["--seeds", "0:1000", "--json", "rows.json"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        printed = [process.stdout.readline() for _ in range(3)]
        process.terminate()
        printed += process.stdout
        assert process.wait(100) == 130
    seeds = [row["seed"] for row in json.loads((tmp_path / "rows.json").read_text())]
    assert seeds == list(range(len(seeds)))
    assert len(seeds) >= sum(line.startswith("seed") for line in printed) >= 2


def test_closed_loop_writes_a_row_for_each_run(runs):
    assert [row["seed"] for row in runs[0]] == [3, 4]
    for row in runs[0]:
        assert row["success"], row["message"]
        assert row["dropped"] == 0
        assert 0 < row["rms_error_m"] < 5e-3
        assert row["limit_share_max"] <= 1


def test_no_distance_is_printed_if_parts_can_end_at_any_position(runs):
    row = runs[0][0] | {"rms_error_m": 0.0, "max_error_m": 0.0, "turn_error_deg": 1.2}
    for text in (closed_loop._row_text(row), closed_loop._summary_text([row])):
        assert "mm" not in text
        assert "1.20 deg" in text
    row["max_error_m"] = 0.001
    assert "1.000 mm" in closed_loop._row_text(row)
    assert "1.000 mm" in closed_loop._summary_text([row])


def test_seeds_differ(runs):
    first, second = without_timings(runs[0])
    assert first["rms_error_m"] != second["rms_error_m"]


def test_the_same_seed_gives_the_same_row_for_any_number_of_workers(runs):
    assert without_timings(runs[1]) == without_timings(runs[0])


def test_a_second_call_runs_only_the_missing_seeds(tiny, runs, capsys):
    first = tiny(file="continued.json", seeds="3:4")
    assert without_timings(first) == without_timings(runs[0][:1])
    capsys.readouterr()
    second = tiny(file="continued.json")
    assert second[0] == first[0]  # with its computing times
    assert without_timings(second) == without_timings(runs[0])
    out = capsys.readouterr().out
    assert "continued.json already contains 1 of these runs" in out
    assert "seed    3" not in out
    assert tiny(file="continued.json", seeds="4:5") == second
    assert "Gamma = 40.8, 1 run\n" in capsys.readouterr().out


@pytest.fixture
def refusal(monkeypatch, capsys):
    """Run a program in this process. Return its exit code and the last line of its error
    message."""

    def run_here(program, *arguments):
        monkeypatch.setattr(sys, "argv", [program.__name__, *arguments])
        try:
            code = program.main()
        except SystemExit as stop:
            code = stop.code
        return code, capsys.readouterr().err.strip().splitlines()[-1]

    return run_here


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--set", "kp=0.5"], "seed 3 was run with kp None, and this command has '0.5'"),
        (["--set", "method=A"], "seed 3 was run with method None, and this command has 'A'"),
        (["--rig", "desk"], "seed 3 was run with rig '"),
        (["--scenario", "sort_4"], "seed 3 was run with scenario '"),
    ],
)
def test_a_file_of_other_settings_is_refused_by_their_name(runs, tmp_path, refusal, words, text):
    file = tmp_path / "kept.json"
    file.write_text(json.dumps(runs[0]), encoding="utf-8")
    before = file.read_text(encoding="utf-8")
    scenario = runs[0][0]["scenario"]
    code, error = refusal(closed_loop, "--scenario", scenario, "--json", str(file), *words)
    assert (code, text in error) == (2, True), error
    assert file.read_text(encoding="utf-8") == before


@pytest.mark.parametrize(
    ("program", "arguments", "words"),
    [
        (closed_loop, ["--scenario", "sort_3"], ("'sort_3'", "allowed", "sort_10")),
        (closed_loop, ["--set", "colour=blue"], ("'colour'", "allowed", "method")),
        (closed_loop, ["--set", "noise"], ("'noise'", "allowed", "key=value")),
        (closed_loop, ["--set", "noise=-5"], ("noise is -5", "allowed: 0 to 50")),
        (closed_loop, ["--set", "kp=nan"], ("kp is nan", "allowed: 0 to 2")),
        (closed_loop, ["--planner", "mine.py"], ("'mine.py'", "allowed", "OwnPlanner")),
        (closed_loop, ["--planner", closed_loop.__file__], ("no class OwnPlanner",)),
        (closed_loop, ["--seeds", "3:3"], ("'3:3'", "allowed", "A < B")),
        (closed_loop, ["--seeds", "0:99999999999"], ("0:99999999999", "at most 100000")),
        (closed_loop, ["--json", "/dev/null/rows.json"], ("/dev/null",)),
        (run, ["simulator"], ("'simulator'", "allowed", "closed_loop")),
        (run, ["sim", "--out", "/proc/x"], ("out is /proc/x", "allowed: a folder")),
    ],
)
def test_wrong_arguments_are_refused_with_a_message_of_one_line(refusal, program, arguments, words):
    code, last = refusal(program, *arguments)
    assert code == 2
    assert "error: " in last
    for word in words:
        assert word in last


def test_every_table_has_its_texts_and_their_values():
    """Or a measurement of hours would fail at its end."""
    used = set()
    for path in (*BENCH.glob("stages/*.py"), *BENCH.glob("tasks/*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        keys = [key for node in nodes if isinstance(node, ast.Dict) for key in node.keys]
        in_dicts = {key.value for key in keys if isinstance(key, ast.Constant)}
        for call in (n for n in nodes if isinstance(n, ast.Call)):
            if ast.unparse(call.func) != "Table.of":
                continue
            named = {word.arg for word in call.keywords}
            given = named | (in_dicts if None in named else set())
            key = ast.literal_eval(call.args[0])
            used.add(key)
            text = TEXTS[key]["title"] + TEXTS[key].get("note", "")
            expected = {name.split("[")[0] for _, name, _, _ in Formatter().parse(text) if name}
            assert expected <= given, key
    assert used == set(TEXTS)


@pytest.mark.parametrize("chapter", ["stages", "tasks"])
def test_every_measurement_has_its_name(chapter):
    modules = {f.stem for f in (BENCH / chapter).glob("*.py") if "\ndef measure(" in f.read_text()}
    assert modules == {name for name, path in MEASUREMENTS.items() if path.startswith(chapter)}


def test_a_failing_measurement_is_named_and_the_others_run(monkeypatch, tmp_path, capsys):
    """Also if its result cannot be written, for example because the disk is full."""
    (tmp_path / f".unwritten.json.{os.getpid()}").mkdir()  # in place of the temporary file
    good = lambda _: Result([])  # noqa: E731
    for name, measure in {"bad": lambda _: 1 / 0, "unwritten": good, "good": good}.items():
        monkeypatch.setitem(sys.modules, f"tasks.{name}", SimpleNamespace(measure=measure))
        monkeypatch.setitem(MEASUREMENTS, name, f"tasks.{name}")
    monkeypatch.setattr(sys, "argv", ["run.py", "bad", "unwritten", "good", "--out", str(tmp_path)])
    assert run.main() == 1
    assert [file.name for file in tmp_path.glob("[!.]*")] == ["good.json"]
    output = capsys.readouterr().err
    assert "ZeroDivisionError" in output
    assert "unwritten.json: cannot be written" in output
    assert output.endswith("error: failed measurements: bad, unwritten\n")


@pytest.mark.needs("numba")
def test_a_measurement_writes_its_table_and_prints_it(tmp_path):
    done = bench("run.py", "force_map", "--quick", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "[1/1, 0:00] force_map" in done.stdout
    data = json.loads((tmp_path / "force_map.json").read_text(encoding="utf-8"))
    assert [file.name for file in tmp_path.iterdir()] == ["force_map.json"]
    assert data["quick"] is True
    [table] = data["tables"]
    for row in table["rows"]:
        assert set(table["columns"]) == set(row)
        assert row["us"] > 0
        assert math.isfinite(row["median"])
    ours = next(row for row in table["rows"] if row["case"] == "one")
    peer = table["rows"][-1]
    assert "average_force" in ours["method"]
    assert "quad" in peer["method"]
    assert ours["median"] < 1e-5


def test_all_stages_are_timed_although_cycles_begin_in_motion():
    from plate_bringup.loop import Setup
    from plate_bringup.loop import run as loop
    from stages.stages import FIRST, STAGES, stages_row
    from tasks.runs import sorting_scenario

    scenario, rig = sorting_scenario(2), load_rig()
    moments = list(islice(loop(Setup(scenario, effort={"restarts": 2}), rig), FIRST + 3))
    assert not all(moment.result.cycle.starts_at_rest for moment in moments)
    row = stages_row(rig, scenario, moments)
    assert all(row[name] > 0 for name in STAGES)
    assert row["answer"] == sum(row[name] for name in ("vision", "planner", "solver", "driver"))


@pytest.mark.parametrize(
    ("drive", "late_ms"),
    [("interpolated", 2), ("held, with its speed", 1), ("held", 1 + 2e3 / (2 * np.pi * 150))],
)
def test_a_drive_on_a_bus_is_as_late_as_its_setpoints(drive, late_ms):
    """Of a slow motion, beside the bus's latency: a line takes 2 ms, a step half of it in the mean,
    and without feed-forward the loop lags by 2 over its rate."""
    from tasks.drives import Driven

    line = Driven(drive, 1, latency_ms=3, jitter_ms=0, loop_hz=150)
    wave = 0.005 * np.sin(np.pi * np.arange(40) / 40) ** 4
    cycle = from_rest(0.5, np.outer(wave, [1, 0, 0]))
    line.send(SimpleNamespace(cycle=cycle))
    for _ in range(2):
        [motion] = line.play(np.inf)
    at = np.linspace(0.1, 0.4, 500)
    expected = cycle.pose(at - 1e-3 * (3 + late_ms))[:, 0]
    assert np.sqrt(np.mean((motion.pose(at)[:, 0] - expected) ** 2)) < 3e-5


def test_intervals_have_the_stated_coverage():
    # Wilson's interval by hand: (p + z²/2n ± z sqrt(p(1-p)/n + z²/4n²)) / (1 + z²/n)
    p, n, z = 0.7, 20, 1.959964
    middle, half = p + z * z / 2 / n, z * math.sqrt(p * (1 - p) / n + (z / 2 / n) ** 2)
    assert of_rate(14, n) == pytest.approx([(middle + s * half) / (1 + z * z / n) for s in (-1, 1)])
    assert rate_text(100, 100) == "100 of 100 (96 to 100 %)"
    rng, held = np.random.default_rng(1), 0
    for _ in range(200):
        low, high = of_median(rng.exponential(size=40))
        held += low <= math.log(2) <= high
    assert 0.9 < held / 200 < 0.99


def test_other_programs_are_noticed():
    """Of a computer that is busy anyway too."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        try:
            assert busy_cores() > MAX_CORES
        finally:
            busy.kill()
