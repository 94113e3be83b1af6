"""Latency from the call of emergency_stop to the Stop on the serial line, during floods."""

from __future__ import annotations

import multiprocessing
import queue
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from graph.domains import own_domain
from graph.gate import NODES
from graph.hops import Listener
from graph.processes import ONE_PROCESS, Processes
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from harness import Result, Table
from plate_bringup import RunOptions, load_graph
from plate_client import PlateClient
from plate_core.driver_status import DriverState
from plate_core.ros import DATA, LATCHED, cycle_to_msg, to_time
from plate_core.serial_protocol import Reader, Stop, parse
from plate_core.tasks import load_scenario
from plate_interfaces.msg import DriverStatus
from stages.device import PERIOD_S, run_device, shaking_table

MAX_MS = 50.0
"""Maximum allowed latency from the call to the line [ms]."""

STOPS, QUICK_STOPS = 30, 3
START_S = 60.0


def serve_stops(link: str, ready: Event, done: Event, stops: Any) -> None:
    """Run the device. For each new Stop frame, put two times [s] into `stops`: the time of the poll
    that received the frame, and the time of the previous poll.

    The frame has arrived between these two times. The interval between the two times grows if this
    process gets no CPU time.
    """
    reader, last, last_poll = Reader(), -1, time.monotonic()
    for data in run_device(link, ready, done):
        now = time.monotonic()
        reader, packets = reader.fed(data)
        for packet in map(parse, packets):
            if isinstance(packet.message, Stop) and packet.sequence != last:
                last = packet.sequence
                stops.put((now, last_poll))
        last_poll = now


FLOOD = """
import sys, time
import rclpy
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from plate_core.ros import DATA
count, pause = int(sys.argv[1]), float(sys.argv[2])
point = JointTrajectoryPoint(positions=[0.0] * 3, velocities=[0.0] * 3, accelerations=[0.0] * 3)
data = serialize_message(JointTrajectory(joint_names=["x", "y", "theta"], points=[point] * count))
rclpy.init()
node = rclpy.create_node("flood")
publisher = node.create_publisher(JointTrajectory, "plate_cycle", DATA)
while True:
    publisher.publish(data)
    time.sleep(pause)
"""

BUSY = "while True: sum(range(100000))"

CONDITIONS: dict[str, dict[str, Any]] = {
    "a cycle every 200 ms": {},
    "the whole graph sorts ten parts": {"graph": True},
    "the same graph in one process": {"graph": True, "one_process": True},
    "flood of cycles with 20,000 points": {"points": 20_000, "pause_s": 0.02},
    "flood of cycles with 1,000,000 points": {"points": 1_000_000, "pause_s": 0.2},
    "the clock stands still": {"simulated_time": True},
    "a cycle every 5 ms, full queues": {"period_s": 0.005},
    "two programs load all cores": {"busy": 2},
    "all of these loads together": {"points": 1_000_000, "pause_s": 0.2, "period_s": 0.005,
                                    "busy": 2, "simulated_time": True},
}  # fmt: skip


class Bench(Listener):
    """ROS node that enables the motors, publishes cycles and calls the stop."""

    def __init__(self, period_s: float | None) -> None:
        super().__init__("stop_latency")
        self.state: int | None = None
        self.node.create_subscription(DriverStatus, "driver_status", self._on_status, LATCHED)
        self.stop = self.node.create_client(Trigger, "emergency_stop")
        self.enable = self.node.create_client(SetBool, "enable")
        self.plate = PlateClient(self.node, self.until)
        # publish additional cycles; if `period_s` is None, only the solver publishes cycles
        if period_s is not None:
            cycles = self.node.create_publisher(JointTrajectory, "plate_cycle", DATA)
            table = shaking_table(64, 5e-4)

            def send() -> None:
                cycles.publish(cycle_to_msg(table.cycle, to_time(time.time_ns())))

            self.node.create_timer(period_s, send)

    def _on_status(self, msg: DriverStatus) -> None:
        self.state = msg.state

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition is true, for at most `seconds`. Return whether the condition is
        true."""
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            time.sleep(0.005)
        return condition()

    def is_enabled(self) -> bool:
        """Enable the motors, and wait until the driver is ready. Return whether it is."""
        future = self.enable.call_async(SetBool.Request(data=True))
        answered = self.until(future.done, 20.0) and future.result().success
        return answered and self.until(lambda: self.state == DriverState.READY, 10.0)

    def begin_task(self) -> None:
        """Start a task when the planner accepts it."""
        self.until(lambda: self.plate.found("sort_parts"), START_S)
        self.plate.start(load_scenario("sort_10"), START_S)


def measure_latencies(
    count: int, domain: int, points: int = 0, pause_s: float = 0.1, period_s: float = PERIOD_S,
    busy: int = 0, graph: bool = False, **options: Any,
) -> list[tuple[float, float]]:  # fmt: skip
    """Return the upper and the lower bound of each latency, from the call of emergency_stop to the
    Stop frame on the line [ms]."""
    context = multiprocessing.get_context("spawn")
    ready, done, stops = context.Event(), context.Event(), context.Queue()
    found: list[tuple[float, float]] = []
    nodes = [node for node in load_graph() if node.name in (NODES if graph else NODES[-1:])]
    others = {f"busy_{k}": [sys.executable, "-c", BUSY] for k in range(busy)}
    if points:
        others["flood"] = [sys.executable, "-c", FLOOD, str(points), str(pause_s)]
    # The planner must receive the cycle starts from the device. Therefore rename the simulator's
    # topic.
    unheard = dict.fromkeys((ONE_PROCESS, "simulator"), ("simulator:cycle_started", "unheard"))
    with tempfile.TemporaryDirectory() as folder:
        link = str(Path(folder) / "port")
        process = context.Process(target=serve_stops, args=(link, ready, done, stops), daemon=True)
        process.start()
        ready.wait(START_S)
        run = RunOptions(transport="serial", port=link, hardware=True, **options)
        try:
            with (
                Processes(nodes, run, Path(folder), domain, remaps=unheard) as processes,
                Bench(None if graph else period_s) as bench,
            ):
                bench.until(lambda: bench.state == DriverState.DISABLED, START_S)
                for client in (bench.stop, bench.enable):
                    client.wait_for_service(START_S)
                processes.add(others)
                bench.until(lambda: not points or "flood" in bench.node.get_node_names(), START_S)
                for number in range(count):
                    found += measure_stops(bench, stops, number, graph)
        finally:
            done.set()
            process.join(10)
    return found


def measure_stops(bench: Bench, stops: Any, number: int, task: bool) -> list[tuple[float, float]]:
    """Enable the motors, start a task if requested, play cycles for a while, and stop the motors.
    Return the bounds of the latency as in `measure_latencies` [ms]."""
    if not bench.is_enabled():
        return []
    if task:
        bench.begin_task()
        time.sleep(1.0)
    time.sleep(0.3 + 0.037 * (number % 10))
    while not stops.empty():
        stops.get()
    began = time.monotonic()
    future = bench.stop.call_async(Trigger.Request())
    try:
        arrival, last_poll = stops.get(timeout=10.0)
    except queue.Empty:
        return [(float("inf"), float("inf"))]
    bench.until(future.done, 5.0)
    bench.until(lambda: bench.state == DriverState.STOPPED, 10.0)
    return [(1e3 * (arrival - began), max(0.0, 1e3 * (last_poll - began)))]


def measure(quick: bool) -> Result:
    """Measure all conditions. A quick measurement has only a few stops in each condition."""
    rows: list[dict[str, Any]] = []
    with ExitStack() as stack:
        domain = stack.enter_context(own_domain())
        rclpy.init(domain_id=domain)
        stack.callback(rclpy.try_shutdown)
        for name, condition in CONDITIONS.items():
            times = measure_latencies(QUICK_STOPS if quick else STOPS, domain, **condition)
            rows.append({
                "condition": name, "stops": len(times),
                "median_ms": float(np.median([high for high, _ in times])) if times else None,
                "worst_ms": max((high for high, _ in times), default=None),
                "least_ms": max((low for _, low in times), default=None),
            })  # fmt: skip
    return Result([Table.of("stops", rows, most=MAX_MS)])
