"""The page over HTTP and a websocket, on a thread of its own. Nothing of it may hold up the graph.

Every browser has a letter box of its own: of what comes again and again the newest waits there, of
the rest the last `LONGEST_QUEUE`. A slow browser misses frames; one that hangs is left alone.
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

LONGEST_MESSAGE = 64_000
"""Of a browser [bytes]."""

LONGEST_QUEUE = 200
"""Messages of which none may be left out, waiting for a browser."""

HUNG_S = 10.0
"""A browser that takes nothing for so long is let go [s]."""

MOST_BROWSERS, MOST_VIEWERS = 32, 24
"""Of all, and of those that only look on: an operator finds a place however many these are."""

MOST_REQUESTS = 100
"""Connections on which a request comes or is answered; more are closed at once."""

COMMANDS_PER_S, BURST = 100.0, 200.0
"""Of one browser: on average, and at once. Dragging sends 60."""

MOST_OPEN, MOST_OF_ALL = 50, 200
"""Commands that have no answer yet, of one browser and of all: more are refused, but for stops."""

PRICE = {"move": 1.0, "watch": 1.0, "replay": 1.0}
"""What comes often while a person drags; all others count for `DEAR`."""

DEAR = 10.0
"""Commands for which another node has to work."""

STILL_S = 2.0
"""After the server has stood still for so long [s], only stops are taken for a moment."""

KEPT = ("log", "call")
"""Kinds of messages of which each one counts. So do answers, which come before all others."""

NEW_PORTS = 20
"""If a port is taken so many after it are tried."""

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Socket(tornado.websocket.WebSocketHandler):
    """One browser."""

    def initialize(self, page: PageServer) -> None:
        """Know the server."""
        self.page = page
        self.role: Role | None = None
        self.watches = {"image": False, "field": False, "camera": False}
        self._newest: dict[str, str | bytes] = {}
        self._queue: deque[str] = deque(maxlen=LONGEST_QUEUE)
        self._answers: deque[str] = deque(maxlen=LONGEST_QUEUE)
        self.open_commands = 0
        self._some = asyncio.Event()
        self._allowance, self._counted = BURST, 0.0

    def check_origin(self, origin: str) -> bool:
        """Let no page of another origin in."""
        return self.page.access.allows_origin(origin, self.request.host)

    def prepare(self) -> None:
        """Let nobody in without the right address and token, or when there are too many."""
        access = self.page.access
        self.role = access.role(self.get_query_argument("token", ""))
        origin = self.request.headers.get("Origin", "")
        if not access.allows_host(self.request.host) or not self.check_origin(origin):
            raise tornado.web.HTTPError(403)
        if self.role is None:
            raise tornado.web.HTTPError(401)
        roles = [each.role for each in self.page.browsers]
        viewer = self.role is Role.VIEWER
        if len(roles) >= MOST_BROWSERS or (viewer and roles.count(self.role) >= MOST_VIEWERS):
            raise tornado.web.HTTPError(503)

    def open(self) -> None:
        """Tell a new browser what is known."""
        assert self.role is not None
        self.set_nodelay(True)
        self.page.browsers.add(self)
        self._task = asyncio.ensure_future(self._deliver())
        self.put("hello", json.dumps({**self.page.hello, "role": self.role.value}))
        for kind, message in self.page.latest.items():
            self.put(kind, message)
        self.page.changed()

    def on_close(self) -> None:
        """Forget a browser; what it has asked for goes on."""
        self.page.browsers.discard(self)
        if hasattr(self, "_task"):
            self._task.cancel()
        self.page.changed()

    async def on_message(self, text: str | bytes) -> None:
        """Take a command; then it is another browser's turn, however many this one has sent. One
        that sends too many is read slowly."""
        within = self._take(text)
        await asyncio.sleep(0 if within else 1 / COMMANDS_PER_S)

    def _take(self, text: str | bytes) -> bool:
        """Return whether this browser keeps within its allowance."""
        now = asyncio.get_event_loop().time()
        self._allowance = min(BURST, self._allowance + COMMANDS_PER_S * (now - self._counted))
        self._counted = now
        assert self.role is not None
        try:
            if len(text) > LONGEST_MESSAGE:
                raise CommandError(f"message has {len(text)} bytes, allowed: {LONGEST_MESSAGE}")
            command = read_command(text, self.role)
        except CommandError as error:
            within = self._spend()
            if within:
                self.answer(_number(text), False, str(error))
            return within
        within = self._spend(PRICE.get(command.name, DEAR))
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
        """Say why a command that does not stop is not taken now; "" if it is."""
        if not within:
            return f"more than {COMMANDS_PER_S:g} commands a second"
        if self.page.is_late():
            return "the page stood still meanwhile: ask again"
        if self.open_commands >= MOST_OPEN or self.page.open_commands >= MOST_OF_ALL:
            return f"{MOST_OPEN} commands, or {MOST_OF_ALL} of all browsers, wait for an answer"
        return ""

    def _spend(self, price: float = 1.0) -> bool:
        if self._allowance < price:
            return False
        self._allowance -= price
        return True

    def answer(self, number: int, ok: bool, text: str) -> None:
        """Answer a command."""
        answer = {"kind": "answer", "number": number, "ok": ok, "text": text}
        self._answers.append(json.dumps(answer))
        self._some.set()

    def put(self, kind: str, message: str | bytes) -> None:
        """Have a message delivered as soon as this browser takes it."""
        if kind in KEPT:
            assert isinstance(message, str)
            self._queue.append(message)
        else:
            self._newest[kind] = message
        self._some.set()

    async def _deliver(self) -> None:
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


def _number(text: str | bytes) -> int:
    try:
        return number_of(json.loads(text))
    except (ValueError, RecursionError):
        return -1


class File(tornado.web.StaticFileHandler):
    """A file of the page."""

    def initialize(self, access: Access, path: str, default_filename: str) -> None:  # type: ignore[override]
        """Know who may have it."""
        self._access = access
        super().initialize(path, default_filename)

    def prepare(self) -> None:
        """Let nobody in by a name that is not ours; say so where a token is missing."""
        if not self._access.allows_host(self.request.host):
            raise tornado.web.HTTPError(403)
        page = self.request.path in ("/", "/index.html")
        if page and self._access.role(self.get_query_argument("token", "")) is None:
            self.set_status(401)
            self.finish(
                "This page needs a token: its address ends with ?token=..., as set by the "
                "parameter operator_token or viewer_token.\n"
            )

    def set_extra_headers(self, path: str) -> None:
        """Let the page load nothing from elsewhere."""
        for name, value in HEADERS.items():
            self.set_header(name, value)


class Door(tornado.httpserver.HTTPServer):
    """Takes connections; of those that say nothing not for long, and not without end."""

    def handle_stream(self, stream: tornado.iostream.IOStream, address: tuple[str, int]) -> None:
        """Take a connection, if there are not too many."""
        if len(self._connections) < MOST_REQUESTS:
            super().handle_stream(stream, address)
        else:
            stream.close()


class PageServer:
    """Serves the page; made and closed from the graph's thread.

    Parameters
    ----------
    access : Access
    port : int
        If it is taken the next free one is.
    hello : mapping
        What every browser gets first.
    take : callable
        Called with a browser and its command, on the server's thread.
    changed : callable
        Called on the server's thread when browsers come, go, or watch something else.

    Raises
    ------
    PlateError
        If no port is free, or the address is not this machine's.
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
        self._sockets, self.port = _bound(access.address, port)
        self._loop = asyncio.new_event_loop()
        self._standstill = Standstill(STILL_S, self._loop.time())
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address for a browser of this machine."""
        host = self.access.address
        host = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/"

    def wants(self, what: str) -> bool:
        """Whether any browser watches this."""
        return any(browser.watches[what] for browser in tuple(self.browsers))

    def is_late(self) -> bool:
        """Whether what comes now was sent while the server stood still (on its own thread)."""
        return self._standstill.is_late(self._loop.time())

    def _keep_time(self) -> None:
        self.is_late()

    def publish(self, kind: str, message: Mapping[str, Any] | bytes, keep: bool = True) -> None:
        """Send to all browsers, from any thread; `keep` it for those that come later."""
        text = message if isinstance(message, bytes) else json.dumps(message, allow_nan=False)
        self._loop.call_soon_threadsafe(self._publish, kind, text, keep)

    def answer(self, browser: Socket, number: int, ok: bool, text: str) -> None:
        """Answer a command that was taken, from any thread."""
        self._loop.call_soon_threadsafe(self._answer, browser, number, ok, text)

    def close(self) -> None:
        """Serve no more."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)
        for each in self._sockets:
            each.close()

    def _answer(self, browser: Socket, number: int, ok: bool, text: str) -> None:
        browser.open_commands -= 1
        self.open_commands -= 1
        browser.answer(number, ok, text)

    def _publish(self, kind: str, text: str | bytes, keep: bool) -> None:
        if keep:
            self.latest[kind] = text
        for browser in self.browsers:
            if browser.watches.get(kind, True):
                browser.put(kind, text)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())
        self._loop.run_forever()
        for browser in tuple(self.browsers):
            browser.close()
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._loop.close()

    async def _serve(self) -> None:
        application = tornado.web.Application(
            [
                (r"/socket", Socket, {"page": self}),
                (r"/([A-Za-z0-9_./-]*)", File, {
                    "access": self.access, "path": str(STATIC), "default_filename": "index.html",
                }),
            ],
            websocket_max_message_size=LONGEST_MESSAGE,
            websocket_ping_interval=5.0,
            websocket_ping_timeout=5.0,
            log_function=lambda handler: None,
        )  # fmt: skip
        server = Door(
            application, max_buffer_size=10 * LONGEST_MESSAGE, idle_connection_timeout=HUNG_S,
            body_timeout=HUNG_S,
        )  # fmt: skip
        server.add_sockets(self._sockets)
        tornado.ioloop.PeriodicCallback(self._keep_time, 100).start()


def _bound(address: str, port: int) -> tuple[list[Any], int]:
    """Return sockets on the first free port."""
    for each in range(port, port + NEW_PORTS):
        try:
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            door = socket.create_server((address, each), family=family)
            door.setblocking(False)
            return [door], each
        except OSError as error:
            problem = error
    raise PlateError(
        f"the page has no port: {address}:{port} to {port + NEW_PORTS - 1}: {problem.strerror}"
    )
