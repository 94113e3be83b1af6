"""Flood the live page with commands from several sockets. The page must not crash, and it must stop
the plate in time.

The real graph runs with the simulator. Each socket sends valid and invalid commands of every kind
as fast as the page reads them. Sometimes a socket reconnects, or does not read for a while. One
more socket calls emergency_stop and stop in turn, and measures the time until the reply arrives.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import multiprocessing
import os
import random
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tornado.httpclient
import tornado.websocket
from graph.session import Session, session

from cases import Outcome
from plate_bringup import RunOptions
from plate_core import config_path
from plate_view import COMMANDS, URGENT

STOP_S, LATE_S = 0.25, 0.1
"""Time between two stops, and maximum time until a stop is answered [s]."""

MAX_S = 5.0
"""Maximum wait for the reply to a stop [s]."""

SOCKETS, NICE = 6, 10

BATCH = 50
"""Number of commands that a socket sends before it may read replies or reconnect."""

NODES = ("simulator", "detector", "planner", "solver", "driver", "page", "nobody")


@dataclass
class Verdict:
    """Result of the case.

    Attributes
    ----------
    minutes : float
        Duration of the flood.
    sockets, sent : int
        Number of flooding sockets, and of commands that they sent.
    ends : list of str
        Messages about processes of the graph that ended.
    stops : int
        Number of stops that were answered.
    median_ms, slowest_ms : float
        Median and maximum time until a stop was answered.
    late, problems : Counter of str
        `late`: number of stops that took longer than `LATE_S`, by name. `problems`: number of
        failed stops, by message.
    """

    minutes: float
    sockets: int
    sent: int = 0
    ends: list[str] = field(default_factory=list)
    stops: int = 0
    median_ms: float = 0.0
    slowest_ms: float = 0.0
    late: Counter[str] = field(default_factory=Counter)
    problems: Counter[str] = field(default_factory=Counter)


def random_command(rng: random.Random) -> dict[str, Any]:
    """Return a random command except the stops. Most of these commands are valid."""
    name = rng.choice(
        [command for command in COMMANDS if command not in URGENT] + ["parameters", "set"] * 4
    )
    node, part = rng.choice(NODES), f"{rng.choice(['black', 'grey'])}_{rng.randrange(6)}"
    x, y = rng.uniform(-0.12, 0.12), rng.uniform(-0.12, 0.12)
    values: dict[str, dict[str, Any]] = {
        "enable": {"on": rng.random() < 0.8},
        "start": {"scenario": rng.choice(["sort_10", "sort_4", "nothing"])},
        "move": {"targets": [{"id": part, "x": x, "y": y}], "dragging": rng.random() < 0.9},
        "follow": {"id": part, "points": [[0, 0], [x, y]], "speed": 0.03, "closed": False},
        "set": {"node": node, "name": rng.choice(["method", "seed", "rate", "methd"]), "value": 3},
        "parameters": {"node": node},
        "place": {"x": x, "y": y, "angle": 0.0},
        "remove": {"id": part},
        "reset": {"seed": rng.choice([None, 1])},
        "teach": {"name": "bolt"},
        "watch": {"image": rng.random() < 0.5, "field": rng.random() < 0.5},
        "replay": {"playing": True},
    }
    return {"do": name, **(values.get(name, {}) if rng.random() < 0.95 else {"x": 1})}


async def connect(url: str) -> tornado.websocket.WebSocketClientConnection:
    """Open a websocket, with the headers of a browser on this computer."""
    address, headers = url.replace("http", "ws") + "socket", {"Origin": url.rstrip("/")}
    return await tornado.websocket.websocket_connect(
        tornado.httpclient.HTTPRequest(address, headers=headers)
    )


async def close_socket(socket: tornado.websocket.WebSocketClientConnection) -> None:
    """Close a websocket, and read until the page has also closed it, for at most `MAX_S`."""

    async def rest() -> None:
        while await socket.read_message() is not None:
            pass

    socket.close()
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(rest(), MAX_S)


async def send_random_commands(url: str, rng: random.Random, sent: Any) -> None:
    """Send random commands without end, and add their number to `sent`."""
    number = 0
    while True:
        with contextlib.suppress(OSError, tornado.websocket.WebSocketClosedError):
            socket = await connect(url)
            for _ in range(rng.randrange(1, 200)):
                for _ in range(BATCH):
                    number += 1
                    await socket.write_message(
                        json.dumps({"number": number, **random_command(rng)})
                    )
                sent.value += BATCH
                if rng.random() < 0.9:  # in the other cases, unread replies accumulate
                    with contextlib.suppress(TimeoutError):
                        while await asyncio.wait_for(socket.read_message(), 0.001) is not None:
                            pass
            socket.close()


def flood_from_process(url: str, sockets: int, seed: int, sent: Any) -> None:
    """Run `send_random_commands` on several sockets. The process has a low priority, so that the
    graph gets the CPU as if the browsers ran on other computers."""
    os.nice(NICE)

    async def all_of_them() -> None:
        floods = [send_random_commands(url, random.Random(seed + k), sent) for k in range(sockets)]
        await asyncio.gather(*floods)

    asyncio.run(all_of_them())


async def stop(url: str, end: float, verdict: Verdict) -> list[float]:
    """Call emergency_stop and stop in turn until the time `end`. Return the time until each reply
    [ms]."""
    took: list[float] = []
    socket, number = await connect(url), 0
    while time.monotonic() < end:
        number += 1
        name, began = ("emergency_stop", "stop")[number % 2], time.monotonic()
        try:
            await socket.write_message(json.dumps({"do": name, "number": number}))
            answer = await asyncio.wait_for(await_reply(socket, number), MAX_S)
            if not answer["ok"]:
                verdict.problems[f"{name}: {answer['text']}"] += 1
            took.append(1e3 * (time.monotonic() - began))
            verdict.late[name] += took[-1] > 1e3 * LATE_S
        except (TimeoutError, tornado.websocket.WebSocketClosedError) as error:
            verdict.problems[f"{name}: {type(error).__name__}"] += 1
            await close_socket(socket)
            with contextlib.suppress(OSError):
                socket = await connect(url)
        await asyncio.sleep(STOP_S)
    await close_socket(socket)
    return took


async def await_reply(socket: Any, number: int) -> dict[str, Any]:
    """Read until the reply to the command with this number arrives, and return it."""
    while True:
        text = await socket.read_message()
        if text is None:
            raise tornado.websocket.WebSocketClosedError
        if isinstance(text, str) and json.loads(text).get("number") == number:
            return dict(json.loads(text))


def flood_page(graph: Session, verdict: Verdict, seed: int) -> None:
    """Flood the page of a graph, and fill in the verdict."""
    url, context = graph.page(), multiprocessing.get_context("spawn")
    # A lock is not necessary, because only one process writes. The process could also be terminated
    # while it holds the lock.
    sent = context.Value("q", 0, lock=False)
    given = url, verdict.sockets, seed, sent
    flooding = context.Process(target=flood_from_process, args=given, daemon=True)
    flooding.start()
    while not sent.value and flooding.is_alive():
        time.sleep(STOP_S)
    try:
        took = np.array(asyncio.run(stop(url, time.monotonic() + 60 * verdict.minutes, verdict)))
    finally:
        flooding.terminate()
        flooding.join()
    verdict.sent, verdict.stops = sent.value, len(took)
    verdict.median_ms, verdict.slowest_ms = map(float, np.round([np.median(took), took.max()], 1))
    verdict.ends = [end for name in graph.processes.names if (end := graph.processes.end_of(name))]


def run(logs: Path, minutes: float = 3.0, seed: int = 0) -> Iterator[Outcome]:
    """Flood the page for a number of minutes, and call stops at the same time."""
    verdict = Verdict(minutes, SOCKETS)
    # The graph uses a copy of the rig file, because commands such as `save_home` write into it.
    rig = shutil.copy(config_path("rig.yaml"), logs)
    options = RunOptions(scenario="play", rig_file=str(rig), view=True)
    # run in the folder `logs`, because `teach` writes its file into the detector's working folder
    in_logs = contextlib.chdir(logs)
    with in_logs, session(options, logs, pictures=False) as graph:
        flood_page(graph, verdict, seed)
    failed = verdict.ends or any(verdict.late.values()) or verdict.problems or not verdict.stops
    yield Outcome(vars(verdict), well=not failed)
