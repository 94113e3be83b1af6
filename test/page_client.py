"""A client of the live page that speaks as a browser does."""

import asyncio
import json
import time

import tornado.httpclient
from tornado.websocket import websocket_connect

TIMEOUT_S = 30.0


class Browser:
    """Speaks with the page, and keeps the newest message of each kind."""

    def __init__(self, connection):
        self._connection, self._number = connection, 0
        self.newest, self.calls = {}, []

    @classmethod
    async def open(cls, url, origin=None, token=""):
        address = url.replace("http", "ws") + "socket" + (f"?token={token}" if token else "")
        headers = {"Origin": origin or url.rstrip("/")}
        request = tornado.httpclient.HTTPRequest(address, headers=headers)
        return cls(await websocket_connect(request))

    async def read(self, timeout_s=TIMEOUT_S):
        text = await asyncio.wait_for(self._connection.read_message(), timeout_s)
        assert text is not None, "the page has closed the connection"
        if isinstance(text, bytes):
            self.newest["image"] = text
            return {"kind": "image"}
        message = json.loads(text)
        self.newest[message["kind"]] = message
        if message["kind"] == "call":
            self.calls.append(message)
        return message

    async def until(self, condition):
        end = time.monotonic() + TIMEOUT_S  # a wait_for in another may lose its timeout
        while not condition(self.newest):
            await self.read(end - time.monotonic())

    async def ended(self):
        """Return the task's state at its end. A slow task is no fault, and the planner ends a task
        without progress."""
        await self.until(lambda newest: newest["task"]["state"] in ("running", "done"))
        while self.newest["task"]["state"] == "running":
            await self.read()
        return self.newest["task"]

    async def send(self, text):
        await self._connection.write_message(text)

    async def ask(self, name, /, **values):
        self._number += 1
        await self.send(json.dumps({"do": name, "number": self._number, **values}))
        end = time.monotonic() + TIMEOUT_S
        while True:
            message = await self.read(end - time.monotonic())
            if message["kind"] == "answer" and message["number"] == self._number:
                return message

    def part(self, name):
        return next(p for p in self.newest["parts"]["parts"] if p["id"] == name)

    async def close(self):
        self._connection.close()
        while await asyncio.wait_for(self._connection.read_message(), TIMEOUT_S) is not None:
            pass
