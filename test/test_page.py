"""The live page's server and the real graph, by a client that speaks as a browser does."""

import asyncio
import contextlib
import http.client
import json
import math
import os
import random
import signal
import socket
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
tornado = pytest.importorskip("tornado.websocket")

from page_client import TIMEOUT_S, Browser  # noqa: E402

from plate_view import COMMANDS  # noqa: E402

LOCKSTEP = True
"""On a busy computer a node in real time may receive no input for 1.5 s, which ends its task."""

MAX_ERROR_M = 0.02
"""So far from its path a part may be: on a busy computer answers come late."""


def distance(part, x, y):
    return math.hypot(part["x"] - x, part["y"] - y)


def kill_node(mark, name):
    """Kill the node of this name that was started with this in its environment."""
    killed = 0
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or is not ours
            ours = mark.encode() in (folder / "environ").read_bytes()
            if ours and (folder / "comm").read_text() == f"{name}\n":
                os.kill(int(folder.name), signal.SIGKILL)
                killed += 1
    assert killed == 1


async def opened_again(url):
    """Open the page as a browser does that has lost it: again and again."""
    port = int(url.rstrip("/").rpartition(":")[2])
    for _ in range(round(TIMEOUT_S / 0.1)):
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", port)).close()
            return await Browser.open(url)
        await asyncio.sleep(0.1)
    raise AssertionError(f"no page at {url}")


def test_the_graph_outlives_its_page_which_comes_again():
    """First in this file, while the graph of the other tests does not run yet."""
    play = Path(__file__).resolve().parents[1] / "tools" / "play.py"
    mark = f"PLATE_TEST_RUN={uuid.uuid4().hex}"
    name, value = mark.split("=")

    async def look(url):
        browser = await opened_again(url)
        await browser.until(lambda newest: newest.get("driver", {}).get("state") == "ready")
        await browser.close()

    with subprocess.Popen(
        [sys.executable, str(play)],
        env=os.environ | {name: value},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        try:
            url = next(line.split()[1] for line in run.stdout if line.startswith("Open http://"))
            asyncio.run(look(url))
            kill_node(mark, "page")
            assert next(run.stderr) == "play: page was ended by SIGKILL\n"
            assert any(line.startswith("It is restarted") for line in run.stderr)
            asyncio.run(look(url))
            kill_node(mark, "planner")
            _, output = run.communicate(timeout=TIMEOUT_S)
        finally:
            run.kill()
    assert "planner was ended by SIGKILL" in output
    assert run.returncode == 1


def test_an_observer_that_discovers_the_solver_late_knows_that_it_has_answered(graph, monkeypatch):
    """In lockstep, plate_cycle is published once before the first goal."""
    observer = graph.observer
    none = property(lambda record: 0, lambda record, count: None)
    monkeypatch.setattr(type(observer.record), "answers", none)
    observer.await_answers(20.0)
    assert observer.record.last("solver", "answers", "0") != "0"


def test_a_part_comes_to_where_its_target_is_dragged(url):
    async def drag():
        browser = await Browser.open(url)
        await browser.until(lambda newest: "parts" in newest and "driver" in newest)
        start = browser.part("black_1")
        x, y = -start["x"] / 2, -start["y"] / 2
        for fraction in (0.2, 0.5, 1.0):
            here = {"id": "black_1", "x": start["x"] + fraction * (x - start["x"]),
                    "y": start["y"] + fraction * (y - start["y"]), "angle": None}  # fmt: skip
            answer = await browser.ask("move", targets=[here], dragging=fraction < 1)
            assert answer["ok"], answer
        await browser.until(lambda newest: distance(browser.part("black_1"), x, y) < 0.002)
        await browser.until(lambda newest: newest.get("targets", {}).get("targets"))
        assert browser.newest["targets"]["targets"][0]["id"] == "black_1"
        answer = await browser.ask("move", targets=[{"id": "nobody", "x": 0, "y": 0}])
        assert answer["ok"]  # it is sent on a topic; the planner logs that there is no task
        other = await Browser.open(url)
        points = [[start["x"], start["y"]], [0, 0]]
        wrong = await browser.ask("follow", id="black_1", points=points, speed=0, closed=False)
        assert "allowed" in wrong["text"]
        assert browser.newest["task"]["state"] == "running"  # nothing has ended for it
        answer = await browser.ask("start", scenario="sort_10")
        assert answer["ok"], answer  # the task move makes way
        await browser.until(lambda newest: newest["task"]["task"] == "sort")
        answer = await other.ask("move", targets=[here])
        assert not answer["ok"]
        assert "a task runs (sort)" in answer["text"]
        await other.close()
        assert (await browser.ask("cancel"))["text"] == "canceled"
        await browser.close()

    asyncio.run(drag())


def test_a_part_follows_a_path_that_is_drawn(url):
    async def draw():
        browser = await Browser.open(url)
        await browser.until(lambda newest: "parts" in newest)
        start = browser.part("grey_1")
        end = [start["x"] * 0.6, start["y"] * 0.5]
        points = [[start["x"], start["y"]], end]
        answer = await browser.ask("follow", id="grey_1", points=points, speed=0.02, closed=False)
        assert answer["ok"], answer
        await browser.until(lambda newest: newest.get("paths", {}).get("paths"))
        (path,) = browser.newest["paths"]["paths"]
        assert math.dist(path["points"][-1], end) < 1e-5  # rounded
        other = await browser.ask("start", scenario="sort_10")
        assert not other["ok"]
        assert "follow is running" in other["text"]
        assert browser.newest["paths"]["paths"] == [path]
        task = await browser.ended()
        assert task["state"] == "done", task
        await browser.until(lambda newest: distance(browser.part("grey_1"), *end) < MAX_ERROR_M)
        answer = await browser.ask("follow", id="nobody", points=points, speed=0.04, closed=False)
        assert not answer["ok"]
        await browser.close()

    asyncio.run(draw())


def test_stop_and_enable_and_what_was_called(url):
    async def stop():
        browser = await Browser.open(url)
        await browser.until(lambda newest: newest.get("driver", {}).get("state") == "ready")
        answer = await browser.ask("emergency_stop")
        assert answer["ok"], answer
        await browser.until(lambda newest: newest["driver"]["state"] == "stopped")
        assert (await browser.ask("emergency_stop"))["ok"]  # twice
        answer = await browser.ask("enable", on=True)
        assert answer["ok"], answer
        await browser.until(lambda newest: newest["driver"]["state"] == "ready")
        await browser.until(lambda newest: len(browser.calls) >= 3)
        assert browser.calls[0]["text"] == "plate emergency_stop"
        await browser.close()

    asyncio.run(stop())


def test_parameters_are_shown_and_set(url):
    async def change():
        browser = await Browser.open(url)
        assert (await browser.ask("parameters", node="solver"))["ok"]
        await browser.until(lambda newest: newest.get("parameters", {}).get("node") == "solver")
        shown = {each["name"]: each for each in browser.newest["parameters"]["parameters"]}
        assert {"rotations", "sinusoids"} <= set(shown["method"]["choices"])
        for value in ("rotations", "sinusoids"):
            assert (await browser.ask("set", node="solver", name="method", value=value))["ok"]
        wrong = await browser.ask("set", node="solver", name="method", value="C")
        assert not wrong["ok"]
        assert "allowed: one of" in wrong["text"]
        wrong = await browser.ask("set", node="solver", name="methd", value="sinusoids")
        assert "solver has no parameter 'methd' (did you mean method?), it has: " in wrong["text"]
        for name in ("../x", "1", "\u00b2", "nobody"):
            assert not (await browser.ask("parameters", node=name))["ok"]
            assert not (await browser.ask("set", node=name, name="x", value=1))["ok"]
        assert (await browser.ask("parameters", node="page"))["ok"]
        await browser.until(lambda newest: newest["parameters"]["node"] == "page")
        shown = {each["name"] for each in browser.newest["parameters"]["parameters"]}
        assert "address" in shown
        assert not any("token" in name for name in shown)
        await browser.close()

    asyncio.run(change())


def test_images_and_fields_come_to_those_who_watch(url):
    async def watch():
        browser = await Browser.open(url)
        await browser.send(json.dumps({"do": "watch", "image": True, "field": True}))
        await browser.until(lambda newest: "image" in newest)
        assert browser.newest["image"][8:10] == b"\xff\xd8"  # JPEG
        await browser.until(lambda newest: newest.get("cycle", {}).get("field"))
        await browser.close()

    asyncio.run(watch())


UPGRADE = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}  # fmt: skip


def status(port, path, **headers):
    """The page's reply to a request with these headers."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, TIMEOUT_S)) as caller:
        caller.request("GET", path, headers=headers)
        return caller.getresponse().status


def test_requests_of_other_origins_are_refused(url):
    port = int(url.rstrip("/").rsplit(":", 1)[1])
    assert status(port, "/") == 200
    assert status(port, "/", Host=f"evil.example:{port}") == 403
    ours = {"Origin": f"http://127.0.0.1:{port}", **UPGRADE}
    assert status(port, "/socket", **ours) == 101
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{port + 1}", ""):
        assert status(port, "/socket", **{**ours, "Origin": origin}) == 403, origin
    assert status(port, "/socket", **UPGRADE) == 403
    foreign = {"Host": "evil.example", "Origin": "http://evil.example"}
    assert status(port, "/socket", **{**ours, **foreign}) == 403
    for path in ("/../node.py", "/%2e%2e/node.py", "/../../plate_core/config/rig.yaml", "/%00"):
        assert status(port, path) in (400, 403, 404), path


def test_a_stalled_browser_and_random_bytes_do_not_disturb_other_browsers(url):
    port = int(url.rstrip("/").rsplit(":", 1)[1])
    rng = random.Random(1)
    hung = socket.create_connection(("127.0.0.1", port))
    lines = {"Host": f"127.0.0.1:{port}", "Origin": f"http://127.0.0.1:{port}", **UPGRADE}
    request = ["GET /socket HTTP/1.1", *(f"{key}: {value}" for key, value in lines.items()), "", ""]
    hung.sendall("\r\n".join(request).encode())
    with socket.create_connection(("127.0.0.1", port)) as rude:
        rude.sendall(rng.randbytes(4000))

    async def disturb():
        browser = await Browser.open(url)
        for _ in range(150):
            name = rng.choice([*COMMANDS, "rm", ""])
            if name in ("emergency_stop", "cut_power", "stop", "cancel", "learn_plate"):
                name += " -f"  # these would be done
            junk = {rng.choice(["x", "id", "targets", "number"]): rng.choice([None, -1, "", [{}]])}
            await browser.send(json.dumps({"do": name, **junk, "force": True}))
            await browser.send(rng.randbytes(rng.randrange(50)).hex())
        await browser.until(lambda newest: newest.get("answer", {}).get("ok") is False)
        other = await Browser.open(url)
        assert (await other.ask("parameters", node="planner"))["ok"]
        await other.until(lambda newest: "parts" in newest)
        await other.close()
        await browser.close()

    asyncio.run(disturb())
    hung.close()


def test_a_flood_of_commands_ends_no_node_and_every_stop_is_answered(graph):
    from cases.page_flood import Verdict, flood_page

    verdict = Verdict(minutes=0.03, sockets=3)
    flood_page(graph, verdict, seed=0)
    assert verdict.sent > 0
    assert verdict.stops > 0
    assert not verdict.ends
    assert not verdict.problems
