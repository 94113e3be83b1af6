"""One run of tools/demo.py: checks the arguments, runs the graph, evaluates and draws the result.

`check_arguments` turns the arguments into a `Plan`, `run` starts the graph and the task, and
`evaluate_run` writes result.json, strip.png and demo.gif, also of a run that was interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import select
import shutil
import sys
import termios
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from record.bag import Recorder
from record.judge import evaluate, placed_word, summary
from trajectory_msgs.msg import JointTrajectory

from plate_bringup import GraphError, RunOptions, load_graph
from plate_bringup.production import check_robot
from plate_core import PlateError, Rig, did_you_mean, load_rig, memory_problem, ros_domain
from plate_core.rig import rig_warnings, unmeasured
from plate_core.tasks import (
    FeedTask,
    FollowTask,
    Scenario,
    Task,
    load_scenario,
    start_positions,
)
from plate_driver.transports import check_transport, installed, open_port
from plate_planner import Planner
from plate_sim.world import Disturbances
from plate_solver import METHODS
from plate_vision.image_sources import check_device, is_played

from .domains import own_domain
from .firmware import build
from .observer import Observer, Record
from .processes import Interrupted, ros_environment, signals_raise, signals_wait
from .robot import Grip, Robot, feed_result
from .session import Session, session

HINT_AFTER_S = 1.8
"""Time without diagnostics of the planner after which the reason is shown [s]. The planner
publishes diagnostics once per second."""

TIMEOUT_S = 30.0
"""Maximum time without diagnostics of the planner [s]."""

EXTRA_S = 30.0
"""Wall time beyond the scenario's time limit until the demo fails [s]. The planner should have
ended the task before."""

LOCKSTEP_SLOWER = 3
"""Maximum ratio of wall time to simulated time in lockstep, on a slow computer."""

PROGRESS_S, WAITING_S = 2.0, 10.0
"""`PROGRESS_S`: time between two status lines of a task if the output is not a terminal [s].
`WAITING_S`: the same time before the task begins [s]."""

FEEDER_S = 10.0
"""Maximum wait for the feeder's diagnostics [s]."""

SEARCH_S = 1.0
"""Time to look for another graph in a chosen domain [s]. Nodes discover each other in 0.2 s."""

LINE_BYTES = 4096
"""Maximum length of a terminal's input line [bytes] (N_TTY_BUF_SIZE of Linux)."""

MAX_PICKS = 10_000
"""Maximum number of parts that a demo lets a robot take."""

DRIVES = {"cia402": "linear_motors", "odrive": "odrives"}
"""Values of --transport that run the firmware on this computer with simulated drives, and the
default rig of each."""

LAST = Path("out/demo")
"""Symbolic link to the folder of the last demo."""

BAG = "bag"
OUTPUT = ("result.json", "strip.png", "demo.gif")


@dataclass(frozen=True)
class Plan:
    """Checked request for one run.

    Attributes
    ----------
    args : Namespace
        Arguments of the command line.
    options : RunOptions
    scenario : Scenario
    rig : Rig
    out : path
        Folder of the results.
    domain : int, optional
        ROS domain. None: a free domain is used.
    """

    args: argparse.Namespace
    options: RunOptions
    scenario: Scenario
    rig: Rig
    out: Path
    domain: int | None


def demo(args: argparse.Namespace) -> int:
    """Check the arguments, run the demo, and return the exit code of tools/demo.py."""
    try:
        plan = check_arguments(args)
        clear_folder(plan.out)
    except PlateError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    if problem := memory_problem():
        print(f"demo: warning: {problem}", file=sys.stderr, flush=True)
    try:
        with signals_raise():
            return run(plan)
    except Interrupted as interrupt:
        print(f"\ndemo: {interrupt}, all nodes are stopped", flush=True)
        return 128 + interrupt.number
    except (PlateError, OSError) as error:  # an OSError is raised, for example, if the disk is full
        print(f"\ndemo: {error}", file=sys.stderr, flush=True)
        return 1


def check_arguments(args: argparse.Namespace) -> Plan:
    """Check all arguments before anything is started.

    Raises
    ------
    PlateError
        If an argument is invalid. The message contains the argument, its value and the allowed
        values.
    """
    scenario = load_scenario(args.scenario)
    drives = args.transport in DRIVES
    rig_file = args.rig or scenario.rig or DRIVES.get(args.transport, "")
    rig = load_rig(rig_file)
    transport = "serial" if drives else args.transport
    check_run(args)
    check_choice("transport", transport, {*installed(), *DRIVES})
    check_transport(transport, args.port or "of the simulated device")
    check_combination(args, transport)
    check_range("picks", args.picks, 1, MAX_PICKS)
    check_range("robot cycle", args.robot_cycle, 0.3, 60, " s")
    if isinstance(scenario.task, FeedTask):
        check_feed_arguments(args, scenario.task)
    # Check the task: `Planner` raises an error if the task does not fit on the plate.
    for warning in Planner(rig, scenario).warnings():
        print(f"demo: warning: {warning}", flush=True)
    # Check the parts: `start_positions` raises an error if the parts do not fit on the plate.
    start_positions(scenario, rig, np.random.default_rng(args.seed))
    check_camera(args.camera, args.port)
    if args.port:
        check_terminal()
    if args.port or args.camera:
        print_unmeasured("demo", rig, args.port)
    if is_played(args.camera):
        print(
            f"demo: {args.camera} is played once and does not react to the plate: parts are "
            "detected, and cycles are computed and sent to the motors, but the task cannot be done",
            flush=True,
        )
    out = args.out or make_run_folder(scenario.name)
    firmware = build(rig_file, args.transport, out / "firmware").absolute() if drives else ""
    options = RunOptions(
        scenario=absolute_path(args.scenario),
        method=METHODS[args.method],
        seed=args.seed,
        transport=transport,
        port=args.port,
        camera=str(Path(args.camera).absolute()) if is_played(args.camera) else args.camera,
        link=str((out / "device").absolute()),
        firmware=str(firmware),
        lockstep=args.lockstep,
        image_rate=args.image_rate,
        rig_file=absolute_path(rig_file),
        autostart=False,
        one_process=args.one_process,
        # If all nodes run in one process, the page would slow the nodes down. Therefore the page is
        # not started.
        view=not (args.no_view or args.one_process),
        robot_port=0,
    )
    domain = args.domain
    # With a real device but without the project's camera node, another node publishes the images.
    # This node is in the ROS domain of the present shell, so use the same domain.
    if domain is None and args.port and not args.camera:
        domain = ros_domain(os.environ)
    return Plan(args, options, scenario, rig, out, domain)


def check_combination(args: argparse.Namespace, transport: str) -> None:
    """Raise PlateError if arguments of the transport, the camera or the lockstep contradict each
    other. `transport` is the transport of the driver node."""
    drives = args.transport in DRIVES
    if args.port and (drives or transport == "sim"):
        hint = " (a board is transport serial)" if drives else ""
        raise PlateError(
            f"port is {args.port!r}, but transport {args.transport} requires no port{hint}"
        )
    if args.lockstep and transport == "serial":
        raise PlateError(f"transport is {args.transport}, but --lockstep requires transport sim")
    if args.camera and transport == "sim":
        raise PlateError(
            f"camera is {args.camera!r}, but with transport sim the simulator publishes the images"
        )
    if args.image_rate and args.camera:
        raise PlateError(f"image rate is {args.image_rate:g}, but --camera requires --image-rate 0")
    if args.image_rate and args.lockstep:
        raise PlateError(
            f"image rate is {args.image_rate:g}, but --lockstep requires --image-rate 0"
        )
    # Check the image rate: `Disturbances` raises an error if the rate is out of range.
    Disturbances(image_rate=args.image_rate)


def check_feed_arguments(args: argparse.Namespace, task: FeedTask) -> None:
    """Raise PlateError if an argument is not allowed with a feed task."""
    if args.lockstep:
        raise PlateError("--lockstep is given, but a task of kind feed requires real time")
    if args.port or args.camera:
        raise PlateError(
            "--port or --camera is given, but a task of kind feed requires the simulator"
        )
    check_robot(task, args.robot_cycle)


def check_camera(camera: str, port: str) -> None:
    """Raise PlateError if the camera or the port does not exist. Empty names are not checked."""
    if camera:
        check_device(camera)
    if port:
        open_port(port).close()


def print_unmeasured(program: str, rig: Rig, port: str) -> None:
    """Before anything moves, print the properties of the rig that are not measured or are
    inconsistent."""
    facts = [*unmeasured(rig), *(warning.text for warning in rig_warnings(rig))]
    if facts:
        print(f"{program}: before anything moves, check these facts of your rig:")
        print("\n".join(f"  - {text}" for text in facts))
    if port:
        print(
            "  - home: the board searches for it when the motors are enabled for the first time; "
            "the plate then moves"
        )
    sys.stdout.flush()


def check_terminal() -> None:
    """Raise PlateError if the standard input is not a terminal, because nobody could answer the
    question."""
    if not sys.stdin.isatty():
        raise PlateError(
            "nobody can enable the motors, because stdin is no terminal. Start the demo in a "
            "terminal, or use make play and enable them on the page"
        )


def await_consent(observer: Observer) -> None:
    """Wait until the operator of a real plate presses Enter. Before that, nothing moves.

    Only an empty line counts, and only if it is entered after the question.

    Raises
    ------
    PlateError
        If the terminal is closed, or its input ended with Ctrl-D.
    """
    terminal = sys.stdin.fileno()
    termios.tcflush(terminal, termios.TCIFLUSH)
    line = b"unasked"
    while line.strip():
        print(
            "Check the rig. Press Enter to enable the motors, or Ctrl-C to stop: nothing moves.",
            flush=True,
        )
        while not select.select([terminal], [], [], 0)[0]:
            observer.until(lambda: False, StatusLine.PERIOD_S)
        try:
            line = os.read(terminal, LINE_BYTES)
        except OSError:  # the terminal was closed
            line = b""
        if not line:
            raise PlateError("the terminal's input ended before Enter: the motors stay off")


def check_run(args: argparse.Namespace) -> None:
    """Check the arguments that `make demo` and `make play` share. Raise the same errors as
    `check_arguments`."""
    check_choice("method", args.method, METHODS)
    check_range("seed", args.seed, 0, 2**31 - 1)
    if args.domain is not None:
        check_range("domain", args.domain, 0, 101)


def check_choice(name: str, value: str, known: Iterable[str]) -> None:
    """Raise PlateError if the argument is not one of the allowed words."""
    known = sorted(known)
    if value not in known:
        hint = did_you_mean(value, known)
        raise PlateError(f"{name} is {value!r}{hint}, allowed: {', '.join(known)}")


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raise PlateError if the argument is outside the range from `low` to `high`."""
    if not low <= value <= high:
        raise PlateError(f"{name} is {value}{unit}, allowed: {low} to {high}")


def absolute_path(name: str) -> str:
    """Return the absolute path of a YAML file. Names without .yaml are returned unchanged."""
    return str(Path(name).absolute()) if Path(name).suffix in (".yaml", ".yml") else name


def make_run_folder(scenario: str) -> Path:
    """Create a new folder for this run, with the time and the scenario in its name.

    Raises
    ------
    PlateError
        If the folder cannot be created.
    """
    stem = f"{LAST}-{time.strftime('%Y-%m-%d-%H%M%S')}_{scenario}"
    path, number = Path(stem), 1
    while True:
        try:
            path.mkdir(parents=True)
            return path
        except FileExistsError:
            number += 1
            path = Path(f"{stem}_{number}")
        except OSError as problem:
            raise folder_error(path, problem) from None


def run(plan: Plan) -> int:
    """Run the graph and the task, and return the exit code. A run that ends early is also
    evaluated."""
    began = time.monotonic()
    names = [node.name for node in plan.options.nodes(load_graph())]
    print(
        f"{plan.scenario.description} Method: {plan.options.method}. "
        f"Gamma = {plan.rig.gamma:.1f}.\n"
        f"Results: {plan.out}\n"
        f"Starting {', '.join(names)}.",
        flush=True,
    )
    problem: Interrupted | PlateError | None = None
    late: Interrupted | None = None
    ended = False
    grips: list[Grip] = []
    line = StatusLine(WAITING_S)
    try:
        with running(plan.options, plan.out / "logs", plan.domain, line) as graph:
            page = graph.page()
            print(
                f"All {len(graph.nodes)} nodes answer after {time.monotonic() - began:.0f} s. "
                f"To watch: {page + ' or ' if page else ''}source env.sh; export "
                f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}",
                flush=True,
            )
            try:
                with recording(plan, graph.observer):
                    if isinstance(plan.scenario.task, FeedTask):
                        graph.free()
                        graph.observer.await_ready()
                        line.end()
                        run_feeding_robot(plan, graph.observer, grips)
                    else:
                        if plan.options.port:
                            await_consent(graph.observer)
                        graph.begin()
                        line.end()
                        watch_task(plan, graph.observer, began)
            except (Interrupted, PlateError) as stopped:
                problem = stopped
            ended = True
    except Interrupted as while_nodes_stop:
        if not ended:
            raise
        late = while_nodes_stop
    code = evaluate_run(plan, graph, time.monotonic() - began, problem, grips)
    stop = problem if isinstance(problem, Interrupted) else late
    if stop is not None:
        print(f"demo: {stop}, all nodes are stopped", flush=True)
        return 128 + stop.number
    if problem is not None:
        print(f"\ndemo: {problem}", file=sys.stderr, flush=True)
        return 1
    return code


def evaluate_run(
    plan: Plan,
    graph: Session,
    wall_s: float,
    problem: Interrupted | PlateError | None,
    grips: list[Grip],
) -> int:
    """Evaluate, write and draw the results. If a problem ended the run, use the results up to this
    problem. Return the exit code."""
    record, codes = graph.observer.record, graph.processes.exit_codes
    with signals_wait():
        try:
            result = evaluate(plan.rig, plan.options, record, graph.nodes, codes)
        except PlateError as error:  # the error states why no task was started
            if problem is None:
                raise
            print(f"\n{error}", flush=True)
            return 1
        result["wall_s"] = round(wall_s, 1)
        if isinstance(plan.scenario.task, FeedTask):
            labels = [pick.label for pick in plan.scenario.task.picks]
            result |= feed_result(grips, record, plan.args.picks, labels)
        if problem is not None:
            text = str(problem).split("\n")[0]
            result |= {"success": False, "message": f"ended by {text}"}
        print(("\n" if problem else "") + summary(result), flush=True)
        write(plan.out / "result.json", result)
    if not plan.args.no_pictures:
        if problem is not None:
            print("  drawing the results so far; Ctrl-C skips the pictures", flush=True)
        draw(plan, record)
    if result["success"] and result["setpoints_within_limits"] and not any(codes.values()):
        return 0
    for name in (name for name, code in codes.items() if code and problem is None):
        print(f"{name}:\n{graph.processes.tail(name)}", flush=True)
    return 1


@contextmanager
def running(
    options: RunOptions, logs: Path, chosen: int | None, line: StatusLine, pictures: bool = True
) -> Iterator[Session]:
    """Context with the running graph, in a free ROS domain or the chosen one. During the start, the
    status line shows the event for which the program waits. The environment of this process is set
    to the domain.

    Raises
    ------
    GraphError
        If nodes with the same names already run in the chosen domain. The two graphs would receive
        each other's messages.
    """
    with own_domain(chosen) as domain:
        os.environ.update(ros_environment(domain))
        if chosen is not None:
            names = [node.name for node in options.nodes(load_graph())]
            with Observer(domain, pictures=False) as observer:
                if observer.until(lambda: bool(observer.seen(names)), SEARCH_S):
                    raise GraphError(
                        f"domain is {domain}, but a {observer.seen(names)[0]} runs there already, "
                        "allowed: a domain without a graph (default: a free one)"
                    )
        with session(options, logs, domain, pictures, line.show) as graph:
            line.end()
            yield graph


@contextmanager
def recording(plan: Plan, observer: Observer) -> Iterator[None]:
    """Context in which all messages are recorded to a bag, if the arguments request it."""
    if not plan.args.record:
        yield
        return
    with Recorder(observer.node, plan.out / BAG) as recorder:
        observer.pulses.append(recorder.discover)
        try:
            yield
        finally:
            observer.pulses.remove(recorder.discover)
            print(f"\n  {plan.out / BAG}", flush=True)


def watch_task(plan: Plan, observer: Observer, began: float) -> None:
    """Show the task's progress until it ends, and the time at which the plate began to move.

    Raises
    ------
    GraphError
        If the planner stops publishing diagnostics, or does not end the task in time.
    """
    line, record, task = StatusLine(PROGRESS_S), observer.record, plan.scenario.task
    allowed = plan.scenario.time_limit_s * (LOCKSTEP_SLOWER if plan.options.lockstep else 1)
    end = time.monotonic() + allowed + EXTRA_S
    report_count, reported_at = 0, time.monotonic()  # of the planner
    moving, seen_tables, shows_hint = False, 0, False
    while not record.ended:
        observer.until(lambda: record.ended, line.PERIOD_S)
        if not moving:
            moving = any(map(is_moving_table, record.tables[seen_tables:]))
            seen_tables = len(record.tables)
            if moving:
                line.end(f"The plate moves {time.monotonic() - began:.1f} s after the start.")
        now = time.monotonic()
        if len(record.reports("planner")) > report_count:
            report_count, reported_at = len(record.reports("planner")), now
        silence_s = now - reported_at
        if silence_s > HINT_AFTER_S:
            text = f"no message from the planner for {silence_s:.0f} s: {observer.blame()}"
            (line.show if shows_hint else line.end)(text)
            shows_hint = True
        else:
            line.show(progress(task, record))
            shows_hint = False
        if silence_s > TIMEOUT_S:
            raise GraphError(f"no message from the planner for {TIMEOUT_S:g} s")
        if now > end:
            raise GraphError(f"the task has not ended within {allowed + EXTRA_S:g} s")
    over = record.states[-1]
    # print the result of the task now, because stopping a frozen node takes long
    if not over.startswith("done"):
        line.end(f"Task {over}")
    observer.until(lambda: record.last("planner", "task_state") == over, 2.0)
    line.end(progress(task, record))


def is_moving_table(table: bytes) -> bool:
    """Whether a motor table moves the plate."""
    points = deserialize_message(table, JointTrajectory).points
    return any(point.positions != points[0].positions for point in points)


def run_feeding_robot(plan: Plan, observer: Observer, grips: list[Grip]) -> None:
    """Let a simulated robot pick parts from the feeder, over TCP, and append each pick to `grips`.

    Raises
    ------
    GraphError
        If the feeder does not answer, or refuses a command.
    """
    line, record = StatusLine(PROGRESS_S), observer.record
    if not observer.until(lambda: bool(record.last("feeder", "port")), FEEDER_S):
        raise GraphError(f"no message from the feeder for {FEEDER_S:g} s")
    port, picks = int(record.last("feeder", "port")), plan.args.picks
    print(f"A robot takes {picks} parts, over TCP at 127.0.0.1:{port}.", flush=True)
    with Robot(observer, port, plan.args.robot_cycle, grips) as robot:
        for grip in robot.work(picks):
            text = (
                f"{sum(taken_grip.taken for taken_grip in grips)} of {picks} parts taken, the last "
                f"{1e3 * grip.error_m:.2f} mm from the reported place"
            )
            line.show(text)
    observer.trigger("stop")
    line.end(text)


def clear_folder(out: Path) -> None:
    """Create the folder, and remove the results of an earlier run in it. If the folder has a name
    like those from `make_run_folder`, set the link `LAST` to the folder.

    Raises
    ------
    PlateError
        If the folder or the link cannot be created.
    """
    try:
        (out / "logs").mkdir(parents=True, exist_ok=True)
        for path in [*(out / name for name in OUTPUT), *(out / "logs").glob("*.log")]:
            path.unlink(missing_ok=True)
        if (out / BAG).exists():
            shutil.rmtree(out / BAG)
        if out.parent == LAST.parent and out.name.startswith(LAST.name + "-"):
            set_link(LAST, out)
    except OSError as problem:
        raise folder_error(out, problem) from None


def folder_error(folder: Path, problem: OSError) -> PlateError:
    """Return an error which states that a folder of results cannot be used."""
    why = problem.strerror or problem
    return PlateError(f"out is {folder}: {why}, allowed: a folder that can be created")


def set_link(link: Path, folder: Path) -> None:
    """Set a symbolic link to a folder in the same parent folder. If a folder has the name of the
    link, this folder is renamed."""
    if link.is_dir() and not link.is_symlink():
        link.rename(make_run_folder("earlier"))
    fresh = link.with_name(f".{link.name}-{os.getpid()}")
    fresh.symlink_to(folder.name)
    # replace the link in one atomic step, because two demos can end at the same time
    fresh.replace(link)


def write(path: Path, result: dict[str, Any]) -> None:
    """Write the result as JSON, and print the path."""
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(f"  {path}", flush=True)


def draw(plan: Plan, record: Record) -> None:
    """Draw the picture strip and the animation, and print their paths. If the user interrupts the
    program, the drawing ends."""
    from record.film import decode_record
    from record.pictures import Scene, draw_film, draw_strip

    scene = Scene(plan.rig, plan.scenario, decode_record(record, plan.rig))
    rig = f", {rig_title(plan.options.rig_file)}" if plan.options.rig_file else ""
    title = f"{plan.scenario.name}, method {plan.options.method}{rig}"
    strip, animation = plan.out / "strip.png", plan.out / "demo.gif"
    # install the signal handlers again, because signals are ignored after the first interrupt
    with signals_raise():
        draw_strip(scene, strip, title)
        print(f"  {strip}", flush=True)
        draw_film(scene, animation, title)
        print(f"  {animation}", flush=True)


def rig_title(rig: str) -> str:
    """Return a title for a rig: `rig desk` for a name, `my_rig.yaml` for a file."""
    return Path(rig).name if Path(rig).suffix else f"rig {rig}"


class StatusLine:
    """Line of output that is overwritten on a terminal. If the output is not a terminal, a new line
    is printed at most every `period_s` [s]. A text with other words is printed after at most
    `NEWS_S`, so that the reason of a wait is known soon. Numbers do not count as words."""

    PERIOD_S = 0.25
    NEWS_S = 1.0

    def __init__(self, period_s: float) -> None:
        self._period_s, self._terminal = period_s, sys.stdout.isatty()
        self._shown_at, self._words, self._length = 0.0, "", 0

    def show(self, text: str) -> None:
        """Show a text."""
        now = time.monotonic()
        if self._terminal:
            print(f"{self._erase()}  {text}", end="", flush=True)
            self._length = len(text) + 2
            return
        words = re.sub(r"[\d.]+", "", text)
        period_s = self._period_s if words == self._words else min(self.NEWS_S, self._period_s)
        if now - self._shown_at >= period_s:
            self._shown_at, self._words = now, words
            print(f"  {text}", flush=True)

    def end(self, text: str = "") -> None:
        """End the line with a last text, or erase the line if the text is empty."""
        if text:
            print(f"{self._erase() if self._terminal else ''}  {text}", flush=True)
        elif self._length:
            print(self._erase(), end="", flush=True)
        self._length = 0

    def _erase(self) -> str:
        """Return the characters that erase the last text. A text that is longer than the terminal
        is wide occupies several rows."""
        rows = max(0, self._length - 1) // max(1, shutil.get_terminal_size().columns)
        return (f"\033[{rows}A" if rows else "") + "\r\033[J"


def progress(task: Task, record: Record) -> str:
    """Return a text about the progress of a running task, made from the diagnostics."""

    def value(key: str) -> str:
        return record.last("planner", key)

    if not value("time_s"):
        return "waiting for the first image"
    if isinstance(task, FollowTask):
        done = f"error {1e3 * float(value('rms_error_m')):.2f} mm rms"
    else:
        done = f"{value('parts_sorted')}/{value('parts_total')} parts {placed_word(task)}"
    return (
        f"{done} | {float(value('time_s')):5.1f} s | {1e3 * float(value('to_go_m')):4.0f} mm to go"
        f" | solve {float(record.last('solver', 'solve_ms_median', '0')):3.0f} ms"
    )
