"""`make demo` as a stranger would use it."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

pytest.importorskip("rclpy")

import play
from demo import arguments
from graph.demo import LAST, StatusLine, clear_folder, make_run_folder, rig_title, watch_task
from graph.demo import demo as run
from graph.observer import Received, Record
from graph.processes import Interrupted
from PIL import Image
from rclpy.serialization import serialize_message
from record.film import decode_record
from short_task import short_task
from std_msgs.msg import Header

from plate_bringup import load_graph
from plate_core import PlateError, load_rig
from plate_core.ros import to_time
from plate_interfaces.msg import Parts, TaskStatus

ROOT = Path(__file__).resolve().parents[1]
MARK = "PLATE_TEST_RUN"
NODES = {"simulator", "detector", "planner", "solver", "driver"}


def demo(*words, mark="", env=(), **options):
    return subprocess.Popen(
        [sys.executable, str(ROOT / "tools" / "demo.py"), *words],
        env=os.environ | {MARK: mark} | dict(env),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def marked(mark):
    """Processes that a run has started, identified by their environment."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"{MARK}={mark}".encode() in path.read_bytes():
                found.append(int(path.parent.name))
        except OSError:
            continue  # it has ended, or is not ours
    return found


def names_of(processes):
    return {Path(f"/proc/{pid}/comm").read_text().strip() for pid in processes}


def test_programs_find_their_modules_with_a_safe_path():
    """With PYTHONSAFEPATH, Python does not search the folder of the program for modules."""
    done = subprocess.run(
        ["bash", "-c", ". ./env.sh && exec python tools/demo.py --domain 500"],
        cwd=ROOT, env=os.environ | {"PYTHONSAFEPATH": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    assert "domain is 500" in done.stderr
    assert done.returncode == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenario", "folow_3"], "scenario is 'folow_3' (did you mean follow_3?), allowed: "),
        (["--method", "sinusoid"], "method is 'sinusoid' (did you mean sinusoids?), allowed: "),
        (["--transport", "serail"], "transport is 'serail' (did you mean serial?), allowed:"),
        (["--rig", "no/such/rig.yaml"], "no/such/rig.yaml: no such file"),
        (["--transport", "serial", "--port", "/dev/none"], "serial port /dev/none is not there"),
        (["--port", "/dev/null"], "serial port /dev/null is a device, but no serial port, allowed"),
        (["--transport", "sim", "--port", "/dev/null"], "port is '/dev/null', but transport sim"),
        (["--transport", "serial", "--lockstep"], "transport is serial, but --lockstep requires "),
        (["--transport", "cia402", "--port", "/dev/null"], "port is '/dev/null', but transport"),
        (["--transport", "odrive", "--rig", "linear_motors"], "rig linear_motors.yaml: its motors"),
        (["--transport", "cia402", "--lockstep"], "transport is cia402, but --lockstep requires "),
        (["--image-rate", "0.5"], "image_rate is 0.5, allowed: 0, or 1 to 200"),
        (["--domain", "500"], "domain is 500, allowed: 0 to 101"),
    ],
)
def test_wrong_arguments_cause_a_message_of_one_line_and_no_start(
    tmp_path, monkeypatch, capsys, words, message
):
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["demo.py", *words, "--out", str(out)])
    assert run(arguments()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith(f"demo: {message}")
    assert errors.count("\n") == 1
    assert not out.exists()


def test_the_program_ends_with_the_code_of_the_run(tmp_path):
    with demo("--seed", "-1", "--out", str(tmp_path / "out")) as process:
        output, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert output == ""
    assert errors == "demo: seed is -1, allowed: 0 to 2147483647\n"


@pytest.mark.parametrize("name", ["nothing", "fifo"])
def test_a_bag_that_is_no_folder_starts_no_page(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    monkeypatch.setattr(sys, "argv", ["play.py", "--bag", name])
    with pytest.raises(PlateError, match=f"bag is '{name}', allowed: the folder of a recorded run"):
        play.check_arguments(play.arguments())


TOLD_WHEN_LOADED = """
import os, sys, time
def tell(event, arguments):
    if event == "import":
        with open(os.environ["LOADED"], "a") as file:
            file.write(f"{time.monotonic()} {os.getpid()} {arguments[0]}\\n")
sys.addaudithook(tell)
os.register_at_fork(after_in_child=lambda: tell("import", ["fork"]))
"""


def test_a_domain_with_a_running_graph_is_not_used(tmp_path, monkeypatch, capsys, domain):
    rclpy = pytest.importorskip("rclpy")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    driver = rclpy.create_node("driver", context=context)
    words = ["--domain", str(domain), "--out", str(tmp_path / "out"), "--no-view"]
    monkeypatch.setattr(sys, "argv", ["demo.py", *words])
    monkeypatch.setattr(os, "environ", dict(os.environ))
    try:
        assert run(arguments()) == 1
    finally:
        driver.destroy_node()
        rclpy.shutdown(context=context)
    problem = f"domain is {domain}, but a driver runs there already, allowed: a domain without"
    assert problem in capsys.readouterr().err


def test_a_run_leaves_results_and_pictures(tmp_path):
    mark = uuid.uuid4().hex
    (tmp_path / "demo.gif").write_text("of an earlier run")
    (tmp_path / "sitecustomize.py").write_text(TOLD_WHEN_LOADED)
    env = {
        "PYTHONPATH": f"{tmp_path}:{os.environ['PYTHONPATH']}",
        "LOADED": str(tmp_path / "loaded"),
    }
    scenario = tmp_path / "way.yaml"
    scenario.write_text(yaml.safe_dump(short_task(0.03, 60)), encoding="utf-8")
    words = ["--scenario", str(scenario), "--method", "B", "--lockstep", "--out", str(tmp_path)]
    records = find_spec("rosbags") is not None  # where ROS is installed, ros2 bag records
    with demo(*words, *(["--record"] if records else []), mark=mark, env=env) as process:
        printed = [(time.monotonic(), line) for line in process.stdout]
        errors = process.stderr.read()
    output = "".join(line for _, line in printed)
    assert process.returncode == 0, output + errors
    assert errors == ""
    assert "To watch: http://127.0.0.1:" in output
    assert marked(mark) == []
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["scenario"], result["method"], result["transport"]) == (
        str(scenario),
        "sinusoids",
        "sim",
    )
    assert result["success"] is True
    assert result["dropped"] == 0
    assert result["nodes"] == ["simulator", "detector", "planner", "solver", "driver"]
    assert result["exit_codes"] == dict.fromkeys([*result["nodes"], "page"], 0)
    assert result["setpoints_within_limits"] is True
    # Topics keep five messages for who is slow to read: on a busy computer the demo misses some.
    assert min(result["motor_setpoints"], result["cycles"]) > 10
    assert result["rms_error_m"] < 0.002
    assert result["time_s"] == pytest.approx(0.03 / 0.01, abs=1)
    with Image.open(tmp_path / "strip.png") as strip:
        assert min(strip.size) > 600
    with Image.open(tmp_path / "demo.gif") as animation:
        assert 10 < animation.n_frames <= 100
    assert (tmp_path / "demo.gif").stat().st_size < 6e6
    if records:
        check_bag(tmp_path / "bag", result)
    moves = next(at for at, line in printed if "The plate moves" in line)
    check_that_no_node_has_loaded_code_since(moves, tmp_path / "loaded", process.pid)


def check_that_no_node_has_loaded_code_since(moves, loaded, demo):
    """An answer would be late by that."""
    loaded = [line.split() for line in loaded.read_text().splitlines()]
    assert len({pid for _, pid, _ in loaded}) > 6  # the nodes are known: forks get the signal too
    late = [(pid, name) for at, pid, name in loaded if float(at) > moves]
    assert [name for pid, name in late if pid != str(demo)] == []


def check_bag(folder, result):
    from rosbags.rosbag2 import Reader

    with Reader(folder) as bag:
        reported = {c.topic: (c.msgtype, c.msgcount) for c in bag.connections}
    assert reported["/motor_setpoints"] == (
        "trajectory_msgs/msg/JointTrajectory",
        pytest.approx(result["motor_setpoints"], abs=3),
    )
    assert reported["/image_raw"][1] > 10
    assert (
        reported["/task_status"][1] >= 2
    )  # latched: also messages published before the subscription


def test_an_interrupt_leaves_nothing_running(tmp_path):
    mark = uuid.uuid4().hex
    words = ["--scenario", "sort_4", "--out", str(tmp_path), "--no-pictures", "--no-view"]
    with demo(*words, mark=mark, start_new_session=True) as process:
        for line in process.stdout:
            if "parts sorted" in line and "|   0.0 s" not in line:
                break
        assert names_of(marked(mark)) >= NODES
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)  # impatience
        output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, output + errors
    assert output.endswith("demo: SIGINT, all nodes are stopped\n")
    assert marked(mark) == []
    result = json.loads((tmp_path / "result.json").read_text())  # the results so far are kept
    assert (result["success"], result["message"]) == (False, "ended by SIGINT")
    assert result["cycles"] > 0


def test_an_interrupt_while_the_nodes_stop_keeps_the_results(tmp_path, monkeypatch):
    module, concluded = import_module("graph.demo"), []

    @contextmanager
    def running(*_):
        yield SimpleNamespace(nodes=[], observer=None, page=str, begin=lambda: None)
        raise Interrupted(signal.SIGINT)

    monkeypatch.setattr(module, "running", running)
    monkeypatch.setattr(module, "recording", lambda plan, observer: nullcontext())
    monkeypatch.setattr(module, "watch_task", lambda plan, observer, began: None)
    monkeypatch.setattr(
        module,
        "evaluate_run",
        lambda plan, graph, wall_s, problem, grips: concluded.append(problem) or 0,
    )
    monkeypatch.setattr(sys, "argv", ["demo", "--scenario", "sort_4", "--out", str(tmp_path)])
    assert run(arguments()) == 130
    assert concluded == [None]


def test_an_interrupted_task_counts_until_the_last_report():
    """The planner reports every second the duration in whole milliseconds: 0.1173 s is 0.117."""
    starts = [10.0, 10.1173, 10.2346, 10.3519]
    parts = (Parts(header=Header(stamp=to_time(round(1e9 * t)))) for t in starts)
    record = Record(truth=[serialize_message(part) for part in parts])
    record.diagnostics["planner"] = [Received(0.0, 10_117_300_000, "", values={"time_s": "0.117"})]
    film = decode_record(record, load_rig())
    assert film.cycles == 3
    assert film.end == pytest.approx(0.352, abs=1e-3)
    record.status = TaskStatus(state=TaskStatus.DONE)
    assert decode_record(record, load_rig()).cycles == 1


@pytest.mark.parametrize(
    ("rig", "title"),
    [("desk", "rig desk"), ("my/rig.yaml", "rig.yaml"), ("/a/my_plate.yml", "my_plate.yml")],
)
def test_the_title_contains_rig_once(rig, title):
    assert rig_title(rig) == title


def test_every_run_has_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    LAST.mkdir(parents=True)  # as earlier versions made it
    (LAST / "result.json").write_text("{}")
    first = make_run_folder("sort_4")
    clear_folder(first)
    assert LAST.resolve() == first.resolve()
    (earlier,) = tmp_path.glob("out/demo-*_earlier")
    assert (earlier / "result.json").exists()
    with ThreadPoolExecutor(8) as pool:  # at the same time
        others = list(pool.map(make_run_folder, ["sort_4"] * 8))
    assert len({first, *others}) == 9
    second = others[-1]
    clear_folder(second)
    assert LAST.resolve() == second.resolve()
    clear_folder(tmp_path / "elsewhere")
    assert LAST.resolve() == second.resolve()


def test_a_missing_camera_is_reported_at_once(tmp_path, monkeypatch, capsys):
    _, port = os.openpty()  # a serial port on which no device answers
    words = ["--transport", "serial", "--port", os.ttyname(port), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["demo.py", *words])
    _, terminal = os.openpty()
    with os.fdopen(terminal, encoding="utf-8") as person:
        monkeypatch.setattr(sys, "stdin", person)
        assert run(arguments()) == 1
    domain = os.environ["ROS_DOMAIN_ID"]
    problem = f"no camera: no node publishes /image_raw in ROS domain {domain}"
    assert problem in capsys.readouterr().err


def test_a_full_disk_is_reported_in_one_line(tmp_path, monkeypatch, capsys):
    def full(plan):
        Path("/dev/full").write_text("x", encoding="utf-8")

    monkeypatch.setattr("graph.demo.run", full)
    monkeypatch.setattr(sys, "argv", ["demo.py", "--out", str(tmp_path)])
    assert run(arguments()) == 1
    assert capsys.readouterr().err.endswith("demo: [Errno 28] No space left on device\n")


def test_a_node_that_crashes_at_start_is_named_with_its_reason(tmp_path, monkeypatch):
    for node in load_graph():
        program = tmp_path / "lib" / node.package / node.executable
        program.parent.mkdir(parents=True, exist_ok=True)
        does = "echo 'error: no such thing'; exit 2" if node.name == "solver" else "exec sleep 60"
        program.write_text(f"#!/bin/sh\n{does}\n")
        program.chmod(0o755)
    prefixes = os.pathsep.join([str(tmp_path), os.environ["AMENT_PREFIX_PATH"]])
    monkeypatch.setenv("AMENT_PREFIX_PATH", prefixes)
    with demo("--out", str(tmp_path / "out")) as process:
        output, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "demo: solver ended with exit code 2\n    error: no such thing\n" in errors
    assert "nodes answer" not in output


def test_a_failure_is_reported_before_the_nodes_end(monkeypatch, capsys):
    """One that is frozen is waited for then, for ten seconds."""
    why = "aborted after 5.0 s: the solver no longer publishes diagnostics"
    record = SimpleNamespace(ended=True, states=[why])
    reported = []
    observer = SimpleNamespace(
        record=record, until=lambda *_: reported.append(capsys.readouterr().out)
    )
    monkeypatch.setattr("graph.demo.progress", lambda *_: "progress")
    plan = SimpleNamespace(
        scenario=SimpleNamespace(time_limit_s=1.0, task=None),
        options=SimpleNamespace(lockstep=False),
    )
    watch_task(plan, observer, 0.0)
    assert why in reported[0]


def test_a_frozen_planner_is_named_within_two_seconds(monkeypatch, capsys):
    now, reports = [0.0], [1]
    record = SimpleNamespace(ended=False, states=["done"], tables=[], reports=lambda _: reports)

    def wait(*_):
        now[0] += 0.5
        if now[0] <= 3.0 or now[0] > 8.0:  # frozen in between
            reports.append(1)
        record.ended = now[0] > 10.0

    reason = "solver: no part_forces for 1.5 s; check that the planner runs"
    observer = SimpleNamespace(record=record, until=wait, blame=lambda: reason)
    record.last = lambda *_: "done"
    monkeypatch.setattr("graph.demo.progress", lambda *_: f"progress at {now[0]:g} s")
    monkeypatch.setattr("graph.demo.time", SimpleNamespace(monotonic=lambda: now[0]))
    plan = SimpleNamespace(
        scenario=SimpleNamespace(time_limit_s=60.0, task=None),
        options=SimpleNamespace(lockstep=False),
    )
    watch_task(plan, observer, 0.0)
    lines = capsys.readouterr().out.splitlines()
    first = next(k for k, line in enumerate(lines) if "no message from the planner" in line)
    assert lines[first] == f"  no message from the planner for 2 s: {reason}"
    assert "progress at" in lines[first - 1]
    times = [float(line.split()[-2]) for line in lines if "progress at" in line]
    assert times[-1] == 11.0
    assert not [t for t in times if 5.0 <= t <= 8.0]


def test_a_new_reason_of_a_wait_is_printed_soon_without_a_terminal(capsys, monkeypatch):
    """A line with other numbers waits for its period; a line with other words does not."""
    now = 100.0
    monkeypatch.setattr("graph.demo.time.monotonic", lambda: now)
    line = StatusLine(10.0)
    for step, text in ((0, "a 1 s"), (2, "a 3.5 s"), (0, "b: silent"), (0.5, "c"), (0.6, "c")):
        now += step
        line.show(text)
    assert capsys.readouterr().out.split("\n") == ["  a 1 s", "  b: silent", "  c", ""]
    now += 5.0
    line.show("c")
    assert capsys.readouterr().out == ""


def test_a_status_line_that_is_longer_than_the_terminal_is_wide_is_erased(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "40")
    line = StatusLine(10.0)
    line.show("x" * 100)  # three rows
    line.show("y" * 38)  # one row
    line.end("end")
    shown = capsys.readouterr().out
    assert shown == f"\r\033[J  {'x' * 100}\033[2A\r\033[J  {'y' * 38}\r\033[J  end\n"
