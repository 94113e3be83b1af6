"""The page's server without a graph."""

import asyncio
import contextlib
import json
import socket
import threading
import time

import pytest

tornado = pytest.importorskip("tornado.websocket")

from plate_view import server as module  # noqa: E402
from plate_view.access import Access  # noqa: E402

TIMEOUT_S = 20.0


@pytest.fixture
def taken():
    return []


@pytest.fixture
def server(taken):
    def take(browser, command):
        taken.append(command.name)
        browser.answer(command.number, True, "")

    found = module.PageServer(Access(), 8300, {}, take, lambda: None)
    yield found
    found.close()


async def opened(server, token=""):
    address = server.url.replace("http", "ws") + f"socket?token={token}"
    origin = server.url.rstrip("/")
    request = tornado.httpclient.HTTPRequest(address, headers={"Origin": origin})
    return await tornado.websocket_connect(request)


async def hang_up(*connections):
    for each in connections:
        each.close()
        while await asyncio.wait_for(each.read_message(), TIMEOUT_S) is not None:
            pass


async def answer(connection, number):
    while True:
        text = await asyncio.wait_for(connection.read_message(), TIMEOUT_S)
        message = json.loads(text)
        if message.get("number") == number:
            return message


def test_commands_during_a_standstill_are_refused_except_stops(server, taken):
    server._standstill.max_s = 0.2
    stalled, go_on = threading.Event(), threading.Event()

    def stall():
        stalled.set()
        go_on.wait(TIMEOUT_S)

    async def talk():
        connection = await opened(server)
        server._loop.call_soon_threadsafe(stall)
        assert stalled.wait(TIMEOUT_S)
        for number, name in enumerate(("learn_plate", "emergency_stop", "cancel")):
            await connection.write_message(json.dumps({"do": name, "number": number}))
        time.sleep(0.3)
        go_on.set()
        assert not (await answer(connection, 0))["ok"]
        assert "stalled" in (await answer(connection, 2))["text"]
        assert taken == ["emergency_stop"]
        while not (  # and then all goes on
            await connection.write_message(json.dumps({"do": "cancel", "number": 3}))
            or await answer(connection, 3)
        )["ok"]:
            await asyncio.sleep(0.05)
        await hang_up(connection)

    asyncio.run(talk())


def test_a_browser_that_sends_too_much_is_read_slowly_and_holds_up_no_stop(
    server, taken, monkeypatch
):
    monkeypatch.setattr(module, "DEFAULT_COST", 1e6)
    monkeypatch.setattr(module, "BURST", 2e6)
    paused, sleep = [], asyncio.sleep

    def recorded(seconds):
        paused.append(seconds)
        return sleep(seconds)

    monkeypatch.setattr(asyncio, "sleep", recorded)

    async def talk():
        flood, other = await opened(server), await opened(server)
        for number in range(5):
            await flood.write_message(json.dumps({"do": "cancel", "number": number}))
        assert "too many commands, allowed: " in (await answer(flood, 4))["text"]
        await other.write_message(json.dumps({"do": "stop", "number": 1}))
        assert (await answer(other, 1))["ok"]
        await hang_up(flood, other)

    asyncio.run(talk())
    assert taken == ["cancel", "cancel", "stop"]
    assert paused.count(1 / module.COMMANDS_PER_S) == 3


def test_idle_connections_do_not_block_others(server, taken, monkeypatch):
    monkeypatch.setattr(module, "MAX_REQUESTS", 5)
    silent = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(8)]
    for each in silent[5:]:
        each.settimeout(TIMEOUT_S)
        with contextlib.suppress(ConnectionResetError):
            assert each.recv(1) == b""  # closed
    for each in silent:
        each.close()

    async def talk():
        end = time.monotonic() + TIMEOUT_S
        while True:
            try:
                connection = await opened(server)
                break
            except (
                OSError,
                tornado.httpclient.HTTPError,
            ):  # the closed ones are not forgotten yet
                assert time.monotonic() < end
                await asyncio.sleep(0.05)
        await connection.write_message(json.dumps({"do": "stop", "number": 1}))
        assert (await answer(connection, 1))["ok"]
        await hang_up(connection)

    asyncio.run(talk())
    assert taken == ["stop"]


def test_an_operator_can_connect_with_any_number_of_viewers(monkeypatch):
    monkeypatch.setattr(module, "MAX_BROWSERS", 3)
    monkeypatch.setattr(module, "MAX_VIEWERS", 2)
    access = Access(operator_token="operator1234", viewer_token="viewer123456")
    server = module.PageServer(access, 8300, {}, print, lambda: None)

    async def talk():
        there = [await opened(server, access.viewer_token) for _ in range(2)]
        with pytest.raises(tornado.httpclient.HTTPError, match="503"):
            await opened(server, access.viewer_token)
        there.append(await opened(server, access.operator_token))
        with pytest.raises(tornado.httpclient.HTTPError, match="503"):
            await opened(server, access.operator_token)
        await hang_up(*there)

    asyncio.run(talk())
    server.close()


def test_images_and_fields_go_only_to_browsers_that_watch_them(server):
    kinds = ("image", "field", "camera", "parts", "last")

    async def received(connection):
        found = []
        while not found or found[-1] != "last":
            text = await asyncio.wait_for(connection.read_message(), TIMEOUT_S)
            found += [kind for kind in kinds if json.loads(text).get("sent") == kind]
        return found

    async def until(condition):
        end = time.monotonic() + TIMEOUT_S
        while not condition():
            assert time.monotonic() < end, "it did not come"
            await asyncio.sleep(0.01)

    def wanted():
        return [kind for kind in kinds[:3] if server.is_displayed(kind)]

    async def talk():
        one, other = await opened(server), await opened(server)
        await until(lambda: len(server.browsers) == 2)
        assert wanted() == []
        for watched in ({"image": True}, {"field": True, "camera": True}, {}):
            command = {"do": "watch", "number": 1, **dict.fromkeys(kinds[:3], False), **watched}
            await one.write_message(json.dumps(command))
            await until(lambda: wanted() == list(watched))  # noqa: B023
            for kind in kinds:
                server.publish(kind, {"sent": kind}, keep=False)
            assert sorted(await received(one)) == sorted([*watched, "parts", "last"])
            assert sorted(await received(other)) == ["last", "parts"]
        await hang_up(one, other)

    asyncio.run(talk())
