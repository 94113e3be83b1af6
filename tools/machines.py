"""The graph on two machines: camera and vision on one; planner, solver and driver on the other.

python tools/machines.py [--reach named|subnet|nobody] [--scenario sort_4] [--json FILE]

The machines are two network namespaces of this computer, connected by a pair of virtual network
cards. This requires root.

named discovery stays on each machine, except that each names the other (ROS_STATIC_PEERS) subnet
discovery includes the whole network nobody default settings. The other machine is an intruder,
which names this one or searches the whole network. The intruder must not find a node, and must get
no reply when it calls a stop.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from graph.hops import Hops
from graph.observer import Observer
from graph.processes import Processes, ros_environment, signals_raise
from graph.series import rows

from plate_bringup import RunOptions, load_graph
from plate_core import PlateError, choose_network, piped
from plate_core.tasks import load_scenario

EYES, HANDS = "10.77.0.1", "10.77.0.2"
SEEING = ("simulator", "detector")
"""Nodes on the machine with the camera."""

REACHES = ("named", "subnet", "nobody")
DOMAIN = 0
"""ROS domain. All domains are free, because the machines have a separate network."""

START_S = 180.0
TASK_S = 180.0
ALONE_S = 3.0
CARD_S = 10.0
DISCOVERY_S = 3.0
"""Time for discovery [s]. New participants announce themselves 20 times, every 0.1 s
(config/fastdds.xml)."""
POLL_S = 0.02
CARD = "card"
INTRUDER = """
import sys, time
import rclpy
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("intruder")
stop = node.create_client(Trigger, "emergency_stop")
stop.wait_for_service(float(sys.argv[1]))
names = set(node.get_node_names()) - {"intruder"}
future = stop.call_async(Trigger.Request())
rclpy.spin_until_future_complete(node, future, timeout_sec=1.0)
print(*sorted(names), *(["answered"] if future.done() else []))
"""
"""Program of an intruder: prints the nodes that it finds, and calls emergency_stop."""
OWN_SHM = "mount -t tmpfs none /dev/shm"


@contextmanager
def machine() -> Iterator[int]:
    """Context with a machine: an idle process with its own network namespace and /dev/shm. Yields
    its process id.

    DDS communicates over /dev/shm with all processes that share it, and names its files there by
    port. Two machines with the same /dev/shm would use each other's ports.

    Raises
    ------
    PlateError
        If the process has no permission to create a network namespace.
    """
    command = ["unshare", "--net", "--mount", "sh", "-c", f"{OWN_SHM} && echo made && exec cat"]
    pipe = subprocess.PIPE
    # The process ends when its standard input is closed. The input is also closed if this program
    # is killed.
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True) as process:
        assert process.stdout
        if not process.stdout.readline():
            raise PlateError("no network namespace could be created; this requires root")
        yield process.pid


@contextmanager
def machines() -> Iterator[tuple[int, int]]:
    """Context with two machines that a virtual cable connects. Yields their process ids.

    Raises
    ------
    PlateError
        If the process has no permission to create a network namespace.
    """
    with machine() as eyes, machine() as hands:
        ends = f"{CARD} netns {eyes} type veth peer {CARD} netns {hands}"
        run_command("ip", "link", "add", *ends.split())
        for pid, address in ((eyes, EYES), (hands, HANDS)):
            run_command(*namespace_command(pid), "ip", "addr", "add", f"{address}/24", "dev", CARD)
            for card in (CARD, "lo"):
                run_command(*namespace_command(pid), "ip", "link", "set", card, "up")
        for pid in (eyes, hands):
            await_card(pid)
        yield eyes, hands


def await_card(pid: int) -> None:
    """Wait until a machine's network card is up. DDS reads the addresses only when a node starts.

    Raises
    ------
    PlateError
        If the network card is not up within `CARD_S`.
    """
    end = time.monotonic() + CARD_S
    while " UP " not in run_command(*namespace_command(pid), "ip", "-brief", "link", "show", CARD):
        if time.monotonic() > end:
            raise PlateError(f"the cable is not up after {CARD_S:g} s")
        time.sleep(POLL_S)


def run_command(*command: str) -> str:
    """Run a command, and return its output. Raise PlateError if the command fails."""
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        reason = getattr(error, "stderr", "") or str(error)
        needs = "; this requires root" if os.geteuid() else ""
        raise PlateError(f"{' '.join(command)}: {reason.strip()}{needs}") from None


def namespace_command(pid: int) -> list[str]:
    """Return the prefix of a command (`nsenter ...`) that runs the command in the network and mount
    namespaces of a process. Each such process represents a machine."""
    return ["nsenter", f"--target={pid}", "--net", "--mount", "--wd"]


def reach_environment(reach: str, other: str) -> dict[str, str]:
    """Return the environment variables for a reach of discovery (`named`, `subnet` or `nobody`).
    `other` is the other machine's address."""
    peers = other if reach == "named" else ""
    where = "SUBNET" if reach == "subnet" else "LOCALHOST"
    reach_it = {"ROS_AUTOMATIC_DISCOVERY_RANGE": where, "ROS_STATIC_PEERS": peers}
    choose_network(reach_it)
    return reach_it


def run_intruder(machine: int) -> list[str]:
    """Return the names of the nodes that an intruder on a machine finds. The result also contains
    "answered" if a node replied to a stop. The intruder tries the reaches `named` and `subnet`."""
    command = [*namespace_command(machine), sys.executable, "-c", INTRUDER, str(ALONE_S)]
    tries = []
    for reach in ("named", "subnet"):
        environment = os.environ | reach_environment(reach, HANDS)
        # without this profile, DDS uses its default, which searches on all networks
        del environment["FASTRTPS_DEFAULT_PROFILES_FILE"]
        tries.append(subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True))
    found = [each.communicate()[0].split() for each in tries]
    if any(each.returncode for each in tries):
        raise PlateError("an intruder has ended with an error")
    return [name for each in found for name in each]


def run(reach: str, scenario: str, eyes: int, logs: Path) -> dict[str, Any]:
    """Run a task, and return its measurements. This process runs on the machine with the driver,
    and `eyes` is the process id of the other machine."""
    options = RunOptions(scenario=scenario, rig_file=load_scenario(scenario).rig)
    graph = options.nodes(load_graph())
    seeing = [node for node in graph if node.name in SEEING and reach != "nobody"]
    others = [node for node in graph if node.name not in SEEING]
    prefix = {node.name: namespace_command(eyes) for node in seeing}
    away = Processes(seeing, options, logs, DOMAIN, prefix, reach_environment(reach, HANDS))
    here = Processes(others, options, logs, DOMAIN, None, reach_environment(reach, EYES))
    with away, here, Observer(DOMAIN, pictures=False) as observer:
        record = observer.record
        found = [node.name for node in others]
        observer.await_nodes(found, START_S)
        if reach == "nobody":
            begun = transferred_bytes()
            observer.until(lambda: False, ALONE_S)
            still = transferred_bytes() - begun
            return {"found": run_intruder(eyes), "crossed_kB": round(1e-3 * still)}
        observer.await_nodes([node.name for node in graph], START_S)
        observer.await_answers(START_S)
        with Hops(images=False) as hops:
            observer.until(lambda: False, DISCOVERY_S)
            observer.start(load_scenario(scenario))
            begun, start = transferred_bytes(), time.time()
            observer.until(lambda: record.ended, TASK_S)
            end = time.time()
            latency = 1e3 * np.diff(rows(hops, start, end)[:, [0, -1]], axis=1)
        return {
            "done": record.done, "ended": record.states[-1], "images": len(latency),
            "latency_ms": round(float(np.median(latency)), 1),
            "latency_p99_ms": round(float(np.percentile(latency, 99)), 1),
            "crossed_kB_per_s": round(1e-3 * (transferred_bytes() - begun) / (end - start), 1),
            "held_cycles": int(record.last("simulator", "held cycles", "0")),
            "late_cycles": int(record.last("simulator", "late cycles", "0")),
        }  # fmt: skip


def transferred_bytes() -> int:
    """Return the number of bytes transferred over the cable in both directions."""
    lines = Path("/proc/self/net/dev").read_text(encoding="ascii").splitlines()
    fields = next(line for line in lines if line.strip().startswith(CARD)).split(":")[1].split()
    return int(fields[0]) + int(fields[8])


def run_driver_side(args: argparse.Namespace) -> int:
    """Run the part of the program on the machine with the driver. Return the exit code."""
    with tempfile.TemporaryDirectory() as logs:
        result = {"reach": args.reach, **run(args.reach, args.scenario, args.inside, Path(logs))}
    print(result, flush=True)
    if args.json:
        args.json.write_text(json.dumps(result, indent=1), encoding="utf-8")
    well = result["done"] if args.reach != "nobody" else not result["found"]
    return 0 if well else 1


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--reach", default="named", choices=REACHES)
    parser.add_argument("--scenario", default="sort_4")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--inside", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.inside:
        return run_driver_side(args)
    try:
        with signals_raise(), machines() as (eyes, hands):
            command = [*namespace_command(hands), sys.executable, *sys.argv, "--inside", str(eyes)]
            reach = ros_environment(DOMAIN) | reach_environment(args.reach, EYES)
            return subprocess.run(command, env=os.environ | reach, check=False).returncode
    except PlateError as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(main())
