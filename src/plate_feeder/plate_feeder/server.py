"""TCP server for robots. The server runs on a separate thread, so that it cannot delay the ROS
nodes.

The commands of a client are executed one after the other, and their replies are sent in the same
order. The number of clients, the number of waiting commands and the length of lines are limited. If
a client exceeds a limit, the server sends a reply with an error code. The server disconnects a
client that does not complete a line in time or does not read its replies. An idle client may stay
connected for an hour.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable

from plate_core import PlateError

from .codes import Code
from .feeder import MAX_S
from .lines import MAX_LINE, WAITING, Command, LineError, answer_line, help_text, read_line

MAX_CLIENTS = 8

MAX_WAITING = 4
"""Maximum number of commands of one client that wait until the client's previous command is
complete. Further commands are refused."""

MAX_ANSWERS = 100
"""Maximum number of lines of one client that wait for a reply, including lines that are refused. If
more lines wait, the client is disconnected."""

IDLE_S = 3600.0
"""Idle time after which a client is disconnected [s]."""

LINE_S = 5.0
"""Maximum time from the first byte of a line to the end of the line [s]."""

SENT_S = 5.0
"""Maximum time in which a client must read a reply [s]. If the client is slower, it is
disconnected."""

LAST_S = 0.5
"""If a client has closed its side of the connection, its last commands may run for this time
[s]."""

ANSWER_S = 5.0
"""Maximum time until the reply to a command that is executed at once [s]."""

PAUSE_S = 0.01
"""Pause between two commands of a client [s]. The pause prevents continuous commands from occupying
the thread of the ROS node."""

KEEPALIVE = {socket.TCP_KEEPIDLE: 30, socket.TCP_KEEPINTVL: 10, socket.TCP_KEEPCNT: 3}
"""Options of TCP keepalive. With these values, the server disconnects a robot within a minute after
the robot was switched off or unplugged."""

CHUNK = 4096
"""Maximum number of bytes that are read from a connection at once."""

WEB = b" http/"
"""Text in the first line that a web browser sends. Browsers are disconnected, because web pages
must not send commands to the feeder."""

Answer = Callable[[Code, str], None]
OnCommand = Callable[[int, Command, Answer], None]


class RobotServer:
    """TCP server for robots. The thread of the ROS executor creates and closes the server.

    Parameters
    ----------
    host : str
        Address of the server.
    port : int
        TCP port. 0 means any free port.
    on_command : callable
        Function that is called on the server's thread for each command. The arguments of the
        function are the number of the client, the command, and a second function that sends the
        reply. The second function must be called once, on any thread.
    on_disconnect : callable
        Function that is called on the server's thread with the number of a disconnected client.

    Attributes
    ----------
    port : int
    clients : int
        Number of connected clients.

    Raises
    ------
    PlateError
        If the port is in use, or the address does not belong to this machine.
    """

    def __init__(
        self, host: str, port: int, on_command: OnCommand, on_disconnect: Callable[[int], None]
    ) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._socket = socket.create_server((host, port), family=family, backlog=MAX_CLIENTS)
        except OSError as error:
            raise PlateError(
                f"host and port are {host}:{port}, allowed: a free port of an address of this "
                f"machine ({error.strerror or error})"
            ) from None
        self.port: int = self._socket.getsockname()[1]
        self._on_command, self._on_disconnect = on_command, on_disconnect
        self._count, self._tasks = 0, set[asyncio.Task[None]]()
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._run_event_loop, name="robots", daemon=True)
        self._thread.start()

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._tasks)

    def close(self) -> None:
        """Stop the server. Replies that already exist are still sent."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(2 * LAST_S + 1)

    def _run_event_loop(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._start_server())

    async def _start_server(self) -> None:
        server = await asyncio.start_server(self._serve_client, sock=self._socket, limit=CHUNK)
        await self._stop.wait()
        server.close()
        if self._tasks:
            await asyncio.wait(tuple(self._tasks), timeout=LAST_S)
        for task in tuple(self._tasks):
            task.cancel()
        if self._tasks:
            await asyncio.wait(tuple(self._tasks), timeout=LAST_S)

    async def _serve_client(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Serve a client until it disconnects."""
        task = asyncio.current_task()
        assert task is not None
        self._count += 1
        client = _Client(self._count, reader, writer, self._on_command, self._stop)
        if len(self._tasks) >= MAX_CLIENTS:
            await client.refuse(f"{MAX_CLIENTS} clients are connected, which is the maximum")
            return
        self._tasks.add(task)
        try:
            await client.serve()
        except asyncio.CancelledError:
            if not self._stop.is_set():
                raise
        finally:
            self._tasks.discard(task)
            writer.transport.abort()
            self._on_disconnect(client.number)


class _Client:
    """Connection to one robot, with a queue of the commands that the robot has sent."""

    def __init__(
        self,
        number: int,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        on_command: OnCommand,
        stop: asyncio.Event,
    ) -> None:
        self.number = number
        self._reader = reader
        self._writer = writer
        self._on_command = on_command
        self._stop = stop
        self._queue: asyncio.Queue[Command | tuple[Code, str]] = asyncio.Queue()
        self._waiting, self._busy = 0, False
        writer.transport.set_write_buffer_limits(high=CHUNK)
        connection: socket.socket = writer.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEPALIVE.items():
            connection.setsockopt(socket.IPPROTO_TCP, option, value)

    async def refuse(self, text: str) -> None:
        """Send a refusal to the robot, and disconnect."""
        with contextlib.suppress(OSError, TimeoutError):
            await self._send(Code.TOO_MANY, text)
            self._writer.close()
            await asyncio.wait_for(self._writer.wait_closed(), SENT_S)
        self._writer.transport.abort()

    async def serve(self) -> None:
        """Read and execute commands until the client disconnects or the server ends."""
        reading, doing, stop = (
            asyncio.ensure_future(each)
            for each in (self._read_lines(), self._execute_commands(), self._stop.wait())
        )
        try:
            await asyncio.wait((reading, doing, stop), return_when=asyncio.FIRST_COMPLETED)
            if not doing.done():  # wait until the last commands of the client are processed
                reading.cancel()
                drained = asyncio.ensure_future(self._queue.join())
                await asyncio.wait((drained, doing), timeout=LAST_S,
                                   return_when=asyncio.FIRST_COMPLETED)  # fmt: skip
                drained.cancel()
        finally:
            for each in (reading, doing, stop):
                each.cancel()
            await asyncio.gather(reading, doing, stop, return_exceptions=True)
        with contextlib.suppress(OSError, TimeoutError):
            self._writer.close()
            await asyncio.wait_for(self._writer.wait_closed(), LAST_S)

    async def _read_lines(self) -> None:
        """Read lines and append them to the queue. Stop when the client closes its side of the
        connection or must be disconnected."""
        loop, buffer, began = asyncio.get_running_loop(), b"", 0.0
        while True:
            limit = IDLE_S if not buffer else began + LINE_S - loop.time()
            try:
                chunk = await asyncio.wait_for(self._reader.read(CHUNK), max(limit, 0.0))
            except TimeoutError:
                if buffer:
                    self._queue.put_nowait(
                        (Code.BAD_LINE, f"the line was not complete within {LINE_S:g} s")
                    )
                elif self._busy:
                    continue
                return
            except OSError:
                return
            if not chunk:
                return
            *lines, rest = (buffer + chunk).replace(b"\r", b"\n").split(b"\n")
            for line in filter(None, lines):
                if WEB in line.lower() or not self._queue_line(line):
                    return
            if len(rest) > MAX_LINE:
                self._queue_line(rest)
                return
            if lines or not buffer:
                began = loop.time()
            buffer = rest

    def _queue_line(self, line: bytes) -> bool:
        """Append a line to the queue. Return False if the queue is too long."""
        item: Command | tuple[Code, str]
        try:
            item = read_line(line)
            if self._waiting >= MAX_WAITING:
                item = Code.TOO_MANY, f"{MAX_WAITING} commands wait, which is the maximum"
            else:
                self._waiting += 1
        except LineError as error:
            item = error.code, str(error)
        self._queue.put_nowait(item)
        return self._queue.qsize() <= MAX_ANSWERS

    async def _execute_commands(self) -> None:
        """Execute the queued commands one after the other. Stop when the client no longer reads the
        replies."""
        with contextlib.suppress(OSError, TimeoutError):
            while True:
                item = await self._queue.get()
                if isinstance(item, Command):
                    self._waiting -= 1
                    self._busy = True
                    item = await self._execute_command(item)
                    self._busy = False
                    await self._send(*item)
                    await asyncio.sleep(PAUSE_S)
                else:
                    await self._send(*item)
                self._queue.task_done()

    async def _execute_command(self, command: Command) -> tuple[Code, str]:
        if command.name == "help":
            return Code.DONE, help_text()
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[tuple[Code, str]] = loop.create_future()

        def answer(code: Code, text: str) -> None:
            with contextlib.suppress(RuntimeError):  # the event loop was closed
                loop.call_soon_threadsafe(set_answer, code, text)

        def set_answer(code: Code, text: str) -> None:
            if not answered.done():
                answered.set_result((code, text))

        self._on_command(self.number, command, answer)
        limit = ANSWER_S + (MAX_S if command.name in WAITING else 0)
        try:
            return await asyncio.wait_for(answered, limit)
        except TimeoutError:
            return Code.FAULT, f"no reply within {limit:g} s"

    async def _send(self, code: Code, text: str) -> None:
        self._writer.write(answer_line(code, text))
        await asyncio.wait_for(self._writer.drain(), SENT_S)
