"""The server of the page: HTTP and a websocket. The server runs on a separate thread, so that it
cannot delay the graph.

Each browser has an outgoing queue. Some data are sent repeatedly, for example the parts. Of these
data, the queue contains only the newest message of each kind. Of all other messages, the queue
contains the last `MAX_QUEUE`. A slow browser therefore misses frames. A browser that accepts no
data is disconnected.
"""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tornado.httpserver
import tornado.ioloop
import tornado.iostream
import tornado.web
import tornado.websocket

from plate_core import PlateError
from plate_core.standstill import Standstill

from .access import Access, Role
from .commands import URGENT, Command, CommandError, number_of, read_command

STATIC = Path(__file__).with_name("static")

MAX_MESSAGE = 64_000
"""Maximum size of a message from a browser [bytes]."""

MAX_QUEUE = 200
"""Maximum number of messages in the queue of a browser. This maximum applies to messages that must
not be skipped. If the queue is full, the oldest message is dropped."""

HUNG_S = 10.0
"""Maximum time without progress in sending [s]. After that, the browser is disconnected."""

MAX_BROWSERS = 32
"""Maximum number of browsers."""

MAX_VIEWERS = 24
"""Maximum number of viewers. This number is smaller than `MAX_BROWSERS`, so that an operator can
always connect."""

MAX_REQUESTS = 100
"""Maximum number of open HTTP connections. Further connections are closed at once."""

COMMANDS_PER_S = 100.0
"""Mean rate of commands that one browser may send [1/s]. A drag sends 60 commands per second."""

BURST = 200.0
"""Maximum number of commands that one browser may send in a burst."""

MAX_OPEN = 50
"""Maximum number of commands of one browser that wait for a reply. Further commands are refused,
except stops."""

MAX_TOTAL = 200
"""Maximum number of commands of all browsers that wait for a reply."""

COST = {"move": 1.0, "watch": 1.0, "replay": 1.0}
"""Costs of commands that are frequent while a person drags. Each command reduces the allowance of
its browser by its cost. All other commands cost `DEFAULT_COST`."""

DEFAULT_COST = 10.0
"""Cost of a command that is not in `COST`. Usually, another node must process such a command."""

STILL_S = 2.0
"""Minimum duration of a stall of the server [s]. After a stall, the server briefly refuses all
commands except stops."""

KEPT = ("log", "call")
"""Kinds of messages that must not be skipped. Replies must not be skipped either. Replies are sent
first."""

NEW_PORTS = 20
"""Number of further ports that the server tries if the given port is in use."""

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Socket(tornado.websocket.WebSocketHandler):
    """The connection to one browser."""

    def initialize(self, page: PageServer) -> None:
        """Initialise the state of a browser's connection."""
        self.page = page
        self.role: Role | None = None
        self.watches = {"image": False, "field": False, "camera": False}
        self._newest: dict[str, str | bytes] = {}
        self._queue: deque[str] = deque(maxlen=MAX_QUEUE)
        self._answers: deque[str] = deque(maxlen=MAX_QUEUE)
        self.open_commands = 0
        self._some = asyncio.Event()
        self._allowance, self._counted = BURST, 0.0

    def check_origin(self, origin: str) -> bool:
        """Accept only web pages of this server's origin."""
        return self.page.access.allows_origin(origin, self.request.host)

    def prepare(self) -> None:
        """Refuse a connection without a valid host, origin and token, and connections beyond the
        maximum number."""
        access = self.page.access
        self.role = access.role(self.get_query_argument("token", ""))
        origin = self.request.headers.get("Origin", "")
        if not access.allows_host(self.request.host) or not self.check_origin(origin):
            raise tornado.web.HTTPError(403)
        if self.role is None:
            raise tornado.web.HTTPError(401)
        roles = [browser.role for browser in self.page.browsers]
        viewer = self.role is Role.VIEWER
        if len(roles) >= MAX_BROWSERS or (viewer and roles.count(self.role) >= MAX_VIEWERS):
            raise tornado.web.HTTPError(503)

    def open(self) -> None:
        """Send the latest messages to a browser that has just connected."""
        assert self.role is not None
        self.set_nodelay(True)
        self.page.browsers.add(self)
        self._task = asyncio.ensure_future(self._send_pending_messages())
        self.put("hello", json.dumps({**self.page.hello, "role": self.role.value}))
        for kind, message in self.page.latest.items():
            self.put(kind, message)
        self.page.changed()

    def on_close(self) -> None:
        """Remove a browser. Commands of this browser that are being executed continue."""
        self.page.browsers.discard(self)
        if hasattr(self, "_task"):
            self._task.cancel()
        self.page.changed()

    async def on_message(self, text: str | bytes) -> None:
        """Process a command. Then process the commands of other browsers. If a browser exceeds its
        allowance of commands, the server reads its messages slowly."""
        within = self._process_command(text)
        await asyncio.sleep(0 if within else 1 / COMMANDS_PER_S)

    def _process_command(self, text: str | bytes) -> bool:
        """Process a command. Return whether the browser has stayed within its allowance of
        commands."""
        now = asyncio.get_event_loop().time()
        self._allowance = min(BURST, self._allowance + COMMANDS_PER_S * (now - self._counted))
        self._counted = now
        assert self.role is not None
        try:
            if len(text) > MAX_MESSAGE:
                raise CommandError(f"message has {len(text)} bytes, allowed: at most {MAX_MESSAGE}")
            command = read_command(text, self.role)
        except CommandError as error:
            within = self._charge_allowance()
            if within:
                self.answer(_read_command_number(text), False, str(error))
            return within
        within = self._charge_allowance(COST.get(command.name, DEFAULT_COST))
        if why := "" if command.name in URGENT else self._refusal(within):
            self.answer(command.number, False, why)
        elif command.name == "watch":
            self.watches = {key: bool(value) for key, value in command.values.items()}
            self.page.changed()
        else:
            self.open_commands += 1
            self.page.open_commands += 1
            self.page.take(self, command)
        return within

    def _refusal(self, within: bool) -> str:
        """Return the reason for refusing a command that is not a stop. Return "" if the command is
        accepted."""
        if not within:
            return f"too many commands, allowed: {COMMANDS_PER_S:g} per second"
        if self.page.is_late():
            return "the page was stalled; send the command again"
        if self.open_commands >= MAX_OPEN or self.page.open_commands >= MAX_TOTAL:
            allowed = f"{MAX_OPEN} of this page, {MAX_TOTAL} of all pages"
            return f"too many commands wait for replies, allowed: {allowed}"
        return ""

    def _charge_allowance(self, price: float = 1.0) -> bool:
        if self._allowance < price:
            return False
        self._allowance -= price
        return True

    def answer(self, number: int, ok: bool, text: str) -> None:
        """Reply to a command."""
        answer = {"kind": "answer", "number": number, "ok": ok, "text": text}
        self._answers.append(json.dumps(answer))
        self._some.set()

    def put(self, kind: str, message: str | bytes) -> None:
        """Queue a message for this browser."""
        if kind in KEPT:
            assert isinstance(message, str)
            self._queue.append(message)
        else:
            self._newest[kind] = message
        self._some.set()

    async def _send_pending_messages(self) -> None:
        try:
            while True:
                await self._some.wait()
                self._some.clear()
                while self._answers or self._queue or self._newest:
                    if "hello" in self._newest:
                        message: str | bytes = self._newest.pop("hello")
                    elif self._answers:
                        message = self._answers.popleft()
                    elif self._queue:
                        message = self._queue.popleft()
                    else:
                        message = self._newest.pop(next(iter(self._newest)))
                    sent = self.write_message(message, binary=isinstance(message, bytes))
                    await asyncio.wait_for(sent, HUNG_S)
        except (tornado.websocket.WebSocketClosedError, TimeoutError):
            self.on_close()
            connection = self.ws_connection
            if connection is not None and connection.stream is not None:
                connection.stream.close()


def _read_command_number(text: str | bytes) -> int:
    try:
        return number_of(json.loads(text))
    except (ValueError, RecursionError):
        return -1


class File(tornado.web.StaticFileHandler):
    """HTTP request handler for the files of the page."""

    def initialize(self, access: Access, path: str, default_filename: str) -> None:  # type: ignore[override]
        """Store the access rules for the requests."""
        self._access = access
        super().initialize(path, default_filename)

    def prepare(self) -> None:
        """Refuse requests to other host names, and requests of the page without a valid token."""
        if not self._access.allows_host(self.request.host):
            raise tornado.web.HTTPError(403)
        page = self.request.path in ("/", "/index.html")
        if page and self._access.role(self.get_query_argument("token", "")) is None:
            self.set_status(401)
            self.finish(
                "This page requires a token: add ?token=... to its address, with the value of the "
                "parameter operator_token or viewer_token.\n"
            )

    def set_extra_headers(self, path: str) -> None:
        """Set headers that prevent loading from other origins."""
        for name, value in HEADERS.items():
            self.set_header(name, value)


class Door(tornado.httpserver.HTTPServer):
    """HTTP server that limits the number of connections and the idle time of each connection."""

    def handle_stream(self, stream: tornado.iostream.IOStream, address: tuple[str, int]) -> None:
        """Accept a connection unless there are too many."""
        if len(self._connections) < MAX_REQUESTS:
            super().handle_stream(stream, address)
        else:
            stream.close()


class PageServer:
    """Server of the page. The thread of the ROS node must create and close the server, not the
    server's own thread.

    Parameters
    ----------
    access : Access
    port : int
        Port of the server. If the port is in use, the next free port is used.
    hello : mapping
        First message to every browser.
    take : callable
        Function that is called on the server's thread with a browser and its command.
    changed : callable
        Function that is called on the server's thread when browsers connect, disconnect or watch
        other data.

    Raises
    ------
    PlateError
        If no port is free, or if the address does not belong to this machine.
    """

    def __init__(
        self,
        access: Access,
        port: int,
        hello: Mapping[str, Any],
        take: Callable[[Socket, Command], None],
        changed: Callable[[], None],
    ) -> None:
        self.access, self.hello = access, {"kind": "hello", **hello}
        self.take, self.changed = take, changed
        self.browsers: set[Socket] = set()
        self.open_commands = 0
        self.latest: dict[str, str | bytes] = {}
        self._sockets, self.port = _bind_sockets(access.address, port)
        self._loop = asyncio.new_event_loop()
        self._standstill = Standstill(STILL_S, self._loop.time())
        self._thread = threading.Thread(target=self._run_event_loop, name="page", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address of the page for a browser on this machine."""
        host = self.access.address
        host = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/"

    def is_displayed(self, what: str) -> bool:
        """Whether at least one browser displays this kind of data."""
        return any(browser.watches[what] for browser in tuple(self.browsers))

    def is_late(self) -> bool:
        """Whether a message that arrives now may have been sent during a stall of the server. Call
        this method only on the server's thread."""
        return self._standstill.is_late(self._loop.time())

    def _record_time(self) -> None:
        self.is_late()

    def publish(self, kind: str, message: Mapping[str, Any] | bytes, keep: bool = True) -> None:
        """Send a message to all browsers. If `keep`, also send the message to browsers that connect
        later. Any thread may call this method."""
        text = message if isinstance(message, bytes) else json.dumps(message, allow_nan=False)
        self._loop.call_soon_threadsafe(self._send_to_browsers, kind, text, keep)

    def answer(self, browser: Socket, number: int, ok: bool, text: str) -> None:
        """Reply to an accepted command. Any thread may call this method."""
        self._loop.call_soon_threadsafe(self._send_answer, browser, number, ok, text)

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)
        for listener in self._sockets:
            listener.close()

    def _send_answer(self, browser: Socket, number: int, ok: bool, text: str) -> None:
        browser.open_commands -= 1
        self.open_commands -= 1
        browser.answer(number, ok, text)

    def _send_to_browsers(self, kind: str, text: str | bytes, keep: bool) -> None:
        if keep:
            self.latest[kind] = text
        for browser in self.browsers:
            if browser.watches.get(kind, True):
                browser.put(kind, text)

    def _run_event_loop(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._start_server())
        self._loop.run_forever()
        for browser in tuple(self.browsers):
            browser.close()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.close()

    async def _start_server(self) -> None:
        application = tornado.web.Application(
            [
                (r"/socket", Socket, {"page": self}),
                (r"/([A-Za-z0-9_./-]*)", File, {
                    "access": self.access, "path": str(STATIC), "default_filename": "index.html",
                }),
            ],
            websocket_max_message_size=MAX_MESSAGE,
            websocket_ping_interval=5.0,
            websocket_ping_timeout=5.0,
            log_function=lambda handler: None,
        )  # fmt: skip
        server = Door(
            application, max_buffer_size=10 * MAX_MESSAGE, idle_connection_timeout=HUNG_S,
            body_timeout=HUNG_S,
        )  # fmt: skip
        server.add_sockets(self._sockets)
        tornado.ioloop.PeriodicCallback(self._record_time, 100).start()


def _bind_sockets(address: str, port: int) -> tuple[list[Any], int]:
    """Return listening sockets on the first free port, and the number of this port."""
    for number in range(port, port + NEW_PORTS):
        try:
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            listener = socket.create_server((address, number), family=family)
            listener.setblocking(False)
            return [listener], number
        except OSError as error:
            problem = error
    raise PlateError(
        f"no port from {port} to {port + NEW_PORTS - 1} is available at {address} for the page "
        f"({problem.strerror})"
    )
