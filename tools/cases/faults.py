"""Kill, freeze and cut off each node of the graph during a task, and record the reactions.

For each fault the parts are placed again and a new task starts. `kill` sends SIGKILL and starts the
node again after 4 s. `freeze` sends SIGSTOP, and SIGCONT after 3 s. `cut` blocks the node's main
input for 4 s. A row of the result lists the messages in task_status, driver_status and the
diagnostics, with their delays after the fault. The row also states when the plate came to rest,
whether the plate moved again without a request, and which calls were needed to continue. With
--transport serial, a simulated motor controller plays the plate's motion.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from graph.gate import GATE
from graph.observer import ALL, Observer, Received
from graph.session import Session, session
from record.judge import check_limits
from trajectory_msgs.msg import JointTrajectory

from cases import Outcome, select_nodes
from plate_bringup import GraphError, RunOptions, load_graph
from plate_core import load_rig
from plate_core.ros import nanoseconds
from plate_core.status import Level
from plate_interfaces.msg import Parts, TaskStatus

MOVE_S = 30.0
"""Maximum wait until the plate moves [s]."""

BACK_S = 30.0
"""Maximum wait until a restarted node publishes diagnostics [s]."""

STILL_S = 0.6
"""Time without motion after which the plate counts as at rest [s]. In this time, the plate would
execute three cycles."""

STILL_SPEED = 2e-3
"""Speed below which a motor counts as at rest [m/s]. A motor without current is slowed down only by
friction."""

MAX_S = 2.0
"""Maximum time from a fault to the end of the task [s]."""

FRESH_S = 1.5
"""Maximum age of the diagnostics of a node that runs again [s]. Nodes publish diagnostics once per
second."""

TRIES = 3
"""Number of attempts to start a task. On a busy computer a task can end at once."""


class Plate:
    """Records the time until which the plate has moved [s, system clock].

    With a serial line, this time is determined from the motion that the device has executed
    (`motor_motion`). Without a serial line, this time is determined from the parts' velocities
    (`ground_truth`). If the fault is in the simulator, this time is determined from the driver's
    tables.
    """

    def __init__(self, observer: Observer, transport: str) -> None:
        self.moved_until = 0.0
        self.tables_only = False
        listen = observer.node.create_subscription
        if transport == "serial":
            listen(JointTrajectory, "motor_motion", self._on_motion, ALL)
        else:
            listen(Parts, "ground_truth", self._on_truth, ALL)
            listen(JointTrajectory, "motor_setpoints", self._on_table, ALL)

    def _moves_until(self, end_s: float) -> None:
        self.moved_until = max(self.moved_until, end_s)

    def _on_table(self, msg: JointTrajectory) -> None:
        if self.tables_only and any(any(point.positions) for point in msg.points):
            length = 1e-9 * nanoseconds(msg.points[-1].time_from_start)
            self._moves_until(time.time() + length)

    def _on_motion(self, msg: JointTrajectory) -> None:
        if any(abs(v) > STILL_SPEED for point in msg.points for v in point.velocities):
            end = nanoseconds(msg.header.stamp) + nanoseconds(msg.points[-1].time_from_start)
            self._moves_until(1e-9 * end)

    def _on_truth(self, msg: Parts) -> None:
        if not self.tables_only and any(part.vx or part.vy for part in msg.parts):
            self._moves_until(1e-9 * nanoseconds(msg.header.stamp))

    @property
    def moving(self) -> bool:
        """Whether the plate moved within the last `STILL_S`."""
        return time.time() - self.moved_until < STILL_S


def messages_between(messages: Iterable[Received], since: float, until: float) -> list[Received]:
    """Return the messages between two times [s, monotonic]."""
    return [message for message in messages if since < message.at < until]


def last_message_before(messages: Iterable[Received], when: float) -> Received:
    """Return the last message up to a time [s, monotonic], or an empty message."""
    return [Received(0.0, 0, ""), *(message for message in messages if message.at <= when)][-1]


WORK_S, UNASKED_S = 3.0, 3.0
"""Time for which the plate moves before a fault, and time after it in which the plate must not move
without a request [s]."""

WATCH_S, FREEZE_S = 4.0, 3.0
"""Duration of a kill or a cut, and of a freeze [s]."""


@dataclass
class Row:
    """Result of one fault. Times are measured from the fault [s]. A time is None if the event did
    not happen."""

    fault: str
    node: str
    task: str = ""
    task_s: float | None = None
    driver: str = ""
    driver_s: float | None = None
    diagnostics: list[tuple[str, str, float, str]] = field(default_factory=list)
    rest_s: float | None = None
    moved_unasked: bool = False
    refused: str = ""
    to_go_on: list[str] = field(default_factory=list)
    goes_on: bool = False
    load: float = 0.0

    @property
    def well(self) -> bool:
        """Whether the task ended in time, the plate came to rest, the plate did not move without a
        request, and the graph could continue."""
        in_time = self.node == "planner" or (self.task_s is not None and self.task_s <= MAX_S)
        return in_time and self.rest_s is not None and not self.moved_unasked and self.goes_on


class Faults:
    """Injects faults into a running graph.

    Parameters
    ----------
    graph : Session
        Running graph, started with `watched=False`, so that a node may end.
    """

    def __init__(self, graph: Session) -> None:
        self.processes, self.observer = graph.processes, graph.observer
        self.scenario = graph.scenario
        self.plate = Plate(self.observer, graph.options.transport)

    def wait(self, seconds: float) -> None:
        """Receive messages for a time [s]."""
        self.observer.until(lambda: False, seconds)

    def work(self) -> None:
        """Start a task, and wait until the plate has moved for `WORK_S`.

        Raises
        ------
        GraphError
            If no task keeps running.
        """
        observer = self.observer
        self.plate.tables_only = False
        for _ in range(TRIES):
            if not observer.record.ready:
                observer.enable()
            observer.restart(self.scenario)
            self.plate.moved_until = 0.0
            observer.until(lambda: self.plate.moving or observer.record.ended, MOVE_S)
            observer.until(lambda: observer.record.ended, WORK_S)
            if not observer.record.ended:
                return
            print(f"states before the fault: {observer.record.states}", flush=True)
        raise GraphError(f"no task runs: {observer.record.states}")

    @contextmanager
    def fault(self, kind: str, node: str) -> Any:
        """Context in which a node is killed or frozen, or its input is cut. The node is restored
        afterwards."""
        if kind == "cut":
            self.observer.set_parameter(GATE, "cut", node)
            yield
            self.observer.set_parameter(GATE, "cut", "")
            return
        processes = self.processes
        processes.signal(node, signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
        yield
        if kind == "kill":
            processes.wait(node, 5.0)
            processes.restart(node)
        else:
            processes.signal(node, signal.SIGCONT)

    def put(self, kind: str, node: str) -> Row:
        """Inject one fault into a running task, and return the reactions."""
        self.work()
        row, plate, diagnostics = Row(kind, node), self.plate, self.observer.record.diagnostics
        plate.tables_only = node == "simulator" and kind != "cut"
        put_at, at_utc = time.monotonic(), time.time()
        with self.fault(kind, node):
            self.wait(FREEZE_S if kind == "freeze" else WATCH_S)
            row.load = round(os.getloadavg()[0], 1)
            if not plate.moving:
                row.rest_s = round(max(0.0, plate.moved_until - at_utc), 1)
            back = time.monotonic()
        self.add_messages(row, put_at, back)
        # Wait until the node publishes diagnostics again. Until the operator sends a request, the
        # plate must not move.
        self.observer.until(
            lambda: (
                last_message_before(diagnostics.get(node, ()), math.inf).at
                > max(back, time.monotonic() - FRESH_S)
            ),
            BACK_S,
        )
        self.wait(UNASKED_S)
        plate.tables_only = False
        if row.task_s is None:  # the end of the task was not published before the node was back
            # The planner publishes its diagnostics once per second. After a stall, it can publish
            # some before it ends the task.
            self.observer.until(
                lambda: any(
                    message.at > back and message.level is Level.ERROR
                    for message in diagnostics.get("planner", ())
                ),
                BACK_S,
            )
            self.add_messages(row, put_at, time.monotonic())
        row.moved_unasked = (
            row.rest_s is not None and plate.moved_until > at_utc + row.rest_s + 0.25
        )
        self.go_on(row)
        return row

    def add_messages(self, row: Row, since: float, until: float) -> None:
        """Add the messages between two times to a row: the end of the task, the driver's first new
        status, and the first most severe diagnostics of each node."""
        record = self.observer.record
        for message in messages_between(record.tasks, since, until):
            if message.state != TaskStatus.RUNNING:
                row.task, row.task_s = message.text, round(message.at - since, 1)
                break
        row.driver, row.driver_s = last_message_before(record.drivers, since).text, None
        for message in messages_between(record.drivers, since, until):
            if message.text != row.driver:
                row.driver, row.driver_s = message.text, round(message.at - since, 1)
                break
        row.diagnostics = []
        for name, messages in record.diagnostics.items():
            recent = messages_between(messages, since, until)
            worst = max(recent, key=lambda one: one.level.rank, default=Received(0.0, 0, ""))
            if worst.level not in (Level.OK, last_message_before(messages, since).level):
                seconds = round(worst.at - since, 1)
                row.diagnostics.append((name, worst.level.name, seconds, worst.text))
        row.diagnostics.sort(key=lambda item: item[2])

    def moves(self) -> bool:
        """Wait until the plate moves or the task has ended. Return whether the plate moved."""
        plate, record, begun = self.plate, self.observer.record, time.time()
        self.observer.until(lambda: plate.moved_until > begun or record.ended, MOVE_S)
        return plate.moved_until > begun

    def go_on(self, row: Row) -> None:
        """Make the service calls that a user must make until the plate moves again."""
        observer = self.observer
        try:
            observer.start(self.scenario, 0.0)
        except GraphError as refusal:
            row.refused = str(refusal)
            if not observer.record.ready:
                row.to_go_on.append("enable")
                observer.enable()
            observer.start(self.scenario)
        row.to_go_on.append("goal")
        row.goes_on = self.moves()
        # the task has ended because a part left the plate, so begin again with new parts
        if not row.goes_on and observer.record.ended:
            row.to_go_on.append("parts")
            observer.restart(self.scenario)
            row.goes_on = self.moves()
        observer.trigger("stop")


def run(logs: Path, nodes: Iterable[str] = (), transport: str = "sim") -> Iterator[Outcome]:
    """Inject all faults into a running graph one after the other. For cuts, a gate forwards
    the nodes' inputs."""
    options = RunOptions(transport=transport, link=str(logs / "device"))
    names = select_nodes(nodes, [node.name for node in options.nodes(load_graph())])
    rows: list[dict[str, Any]] = []
    result: dict[str, Any] = {
        "transport": transport,
        "port": options.link,
        "rows": rows,
        "tables": 0,
        "faults": [],
    }
    for kinds in (("kill", "freeze"), ("cut",)):
        # The session does not watch the processes, because the test kills them.
        with session(options, logs, watched=False, gated="cut" in kinds) as graph:
            faults = Faults(graph)
            if transport == "serial":
                graph.observer.enable()
            for kind, name in product(kinds, names):
                if name == "device" and kind != "kill":
                    # The gate cannot cut the device's input, because it is a serial line. A freeze
                    # of the device is not tested, because a real controller has a watchdog.
                    continue
                try:
                    row = faults.put(kind, name)
                # no task could be started, or the task could not continue
                except GraphError as error:
                    row = Row(kind, name, f"not measured: {error}")
                rows.append(asdict(row) | {"well": row.well})
                yield Outcome(result, json.dumps(rows[-1]))
            check = check_limits(graph.observer.record, load_rig(options.rig_file))
        result["tables"] += check.tables
        result["faults"] += check.faults
    lines = [" | ".join(row.values()) for row in table_cells(result)]
    lines.append(f"{result['tables']} motor tables, limit violations: {result['faults']}")
    well = all(row["well"] for row in rows) and not result["faults"]
    yield Outcome(result, well=well, text="\n".join(lines))


HEADS = ("fault", "node", "task_status", "driver_status", "diagnostics", "plate rests", "to go on")


def table_cells(result: dict[str, Any]) -> list[dict[str, str]]:
    """Return the rows as texts by column (`HEADS`), for a table."""

    def delay_text(text: str, seconds: float | None) -> str:
        text = re.sub(r"^aborted after [\d.]+ s: ", "", text)
        text = text.split(" (")[0].split(", allowed: ")[0].replace(result["port"], "PORT")
        return f"{seconds:.1f} s: {text}" if seconds is not None else text

    rows = []
    for row in result["rows"]:
        changes = "; ".join(
            f"{name} {level} {seconds:.1f} s" for name, level, seconds, _ in row["diagnostics"]
        )
        rest = "no" if row["rest_s"] is None else f"{row['rest_s']:.1f} s"
        task = delay_text(row["task"], row["task_s"])
        driver = delay_text(row["driver"], row["driver_s"])
        some = row["fault"], row["node"], task, driver, changes, rest, ", ".join(row["to_go_on"])
        rows.append(dict(zip(HEADS, some, strict=True)))
    return rows
