"""Episodes of agents in separate processes, with limits of time and memory.

The function `play` requests an episode from a supervisor. A supervisor is a process that runs
`plate_gym.supervisor`. An idle supervisor is used again for the next episode, or ends after
`IDLE_S`. An agent that fails cannot block or end the process that calls `play`, and cannot fill the
memory of this process. When an episode ends, all processes of the agent are ended. This module is
not a security sandbox, because an agent can still do anything that its user is allowed to do. For
example, it can send signals to the process that calls `play`.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import secrets
import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from plate_bringup.loop import ALIKE
from plate_core import PlateError

__all__ = ["ALIVE", "LIMITS", "REPLY_BYTES", "Limits", "parsed", "play", "stop"]

REPLY_BYTES = 100_000
"""Maximum size of a supervisor's reply [bytes]. A reply with the row of an episode has about 500
bytes."""

ALIVE = b".\n"
"""Line that a supervisor sends when it begins, and about every second during an episode."""

START_S, REPLY_TIMEOUT_S = 300.0, 60.0
"""`START_S` is the time in which a supervisor must start [s]. The time is long, because loading the
libraries takes half a minute on a busy computer. `REPLY_TIMEOUT_S` is the maximum time between two
lines that a supervisor sends [s]."""

IDLE_S = 60.0
"""Time after which an idle supervisor is ended [s]."""

ENDING_S = 15.0
"""Time in which a supervisor must end all its processes and itself [s]."""

EPISODE_FACTOR = 240
"""Maximum time of an episode divided by the maximum time of a decision."""

REPLY: dict[str, type] = {"row": dict, "failure": str, "error": str, "steps": int}
"""Keys of a reply and the types of their values. A reply has one of the first three keys."""

MARK = "PLATE_GYM_SUPERVISOR"
"""Environment variable that all processes of a supervisor have. The value of the variable is a
random text. If an agent kills the supervisor and its guard, this text identifies the remaining
processes."""


@dataclass(frozen=True)
class Limits:
    """Limits of an agent. If a limit is exceeded in an episode, the episode counts as failed.

    Attributes
    ----------
    decision_s : float
        Maximum time of a decision, including the simulation of the step [s]. The import and the
        creation of the agent must not take longer either.
    memory_gb : float
        Maximum memory of the agent's processes, including the simulation [GB].

    Raises
    ------
    PlateError
        If a value is outside the allowed range.
    """

    decision_s: float = 60.0
    memory_gb: float = 4.0

    def __post_init__(self) -> None:
        for name, low, high in (("decision_s", 0.1, 1e6), ("memory_gb", 0.5, 1e6)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise PlateError(f"{name} is {value:g}, allowed: {low:g} to {high:g}")

    @property
    def episode_s(self) -> float:
        """Maximum time of an episode [s]."""
        return EPISODE_FACTOR * self.decision_s


LIMITS = Limits()
"""Default limits."""


class Supervisor:
    """Supervisor in a separate process. The process has a separate session, so that it does not
    receive signals of a terminal. If the process that created the supervisor ends, the standard
    input of the supervisor closes. The supervisor then ends too."""

    def __init__(self) -> None:
        self._mark = secrets.token_hex(16)
        self._begun, self.usable = False, True
        self.timer = threading.Timer(IDLE_S, _close_idle, [self])
        # The option -P prevents files in the current folder from replacing libraries.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "plate_gym.supervisor"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True,
            env=os.environ | ALIKE | {MARK: self._mark},
        )  # fmt: skip

    def call(self, request: dict[str, Any], limits: Limits) -> dict[str, Any]:
        """Send a request to the supervisor, and return its reply. If the supervisor has ended, the
        reply contains the key `error`. After an error or any exception, `usable` is False."""
        assert self._process.stdin is not None
        self.usable = False
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            reply = parsed(self._reply(START_S + limits.episode_s))
        except (OSError, ValueError) as problem:
            return {"error": f"its supervisor failed: {problem}"}
        self.usable = True
        return reply

    def _reply(self, total_s: float) -> bytes:
        assert self._process.stdout is not None
        received, end = b"", time.monotonic() + total_s
        while len(received) < REPLY_BYTES:
            wait_s = REPLY_TIMEOUT_S if self._begun else START_S
            if not select.select([self._process.stdout], [], [], wait_s)[0]:
                raise OSError(f"no message within {wait_s:g} s")
            data = self._process.stdout.read(REPLY_BYTES)
            if not data:
                raise OSError("it has ended")
            self._begun = True
            *lines, received = (received + data).split(b"\n")
            for line in lines:
                if line + b"\n" != ALIVE:
                    return line
            # an agent that has stopped or killed the supervisor can send the line `ALIVE` itself
            if time.monotonic() > end:
                raise OSError(f"no reply within {total_s:g} s")
            if self._process.poll() is not None:
                raise OSError("it has ended")
        raise OSError("its reply is too long")

    def end(self) -> None:
        """End the supervisor and its processes. If another thread waits in `call`, its call then
        returns."""
        process = self._process
        assert process.stdin is not None
        process.stdin.close()
        try:
            process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.returncode != 0:
            _kill_marked(self._mark)

    def close(self) -> None:
        """End the supervisor, and close its pipes."""
        self.end()
        assert self._process.stdout is not None
        self._process.stdout.close()


def _kill_marked(mark: str) -> None:
    """End the processes whose environment contains the text `mark`, and wait until they have
    ended."""
    entry = f"{MARK}={mark}".encode()
    found, end = True, time.monotonic() + ENDING_S
    while found and time.monotonic() < end:
        found = False
        for folder in Path("/proc").iterdir():
            if folder.name.isdigit():
                try:
                    if entry not in (folder / "environ").read_bytes():
                        continue
                    process = os.pidfd_open(int(folder.name))
                except OSError:  # the process has ended or belongs to another user
                    continue
                found = True
                with contextlib.suppress(ProcessLookupError):
                    signal.pidfd_send_signal(process, signal.SIGKILL)
                select.select([process], [], [], ENDING_S)
                os.close(process)


def parsed(text: bytes) -> dict[str, Any]:
    """Return the reply of a supervisor, or of the process of an agent, from its JSON text. If the
    reply has no number of steps, the number is 0.

    Raises
    ------
    ValueError
        If the text is not a valid reply. An agent can write any text.
    """
    try:
        reply = json.loads(text)
    except RecursionError:
        reply = None
    if (
        not isinstance(reply, dict)
        or not all(type(value) is REPLY.get(key) for key, value in reply.items())
        or len(reply.keys() - {"steps"}) != 1
    ):
        raise ValueError("its reply is invalid")
    return {"steps": 0} | reply


_idle: list[Supervisor] = []
_all: list[Supervisor] = []


def play(request: dict[str, Any], limits: Limits) -> dict[str, Any]:
    """Run an episode in a separate process. Several threads may call this function at the same
    time.

    Parameters
    ----------
    request : dict
        Values for the keys `agent`, `world`, `task` and `seed`, as in `episode.episode`.
    limits : Limits

    Returns
    -------
    dict
        Reply with one of the keys `row`, `failure` and `error`. `row` is the row of the episode.
        `failure` names the limit that was exceeded, and the key `steps` then contains the number of
        completed steps. `error` describes another failure. An agent can falsify the reply.
    """
    try:
        supervisor = _idle.pop()
        supervisor.timer.cancel()
    except IndexError:
        supervisor = Supervisor()
        _all.append(supervisor)
    place = {"path": sys.path, "folder": os.getcwd(), "limits": asdict(limits)}
    try:
        return supervisor.call(request | place, limits)
    finally:  # also if another thread raises an exception in this one, as a cluster does
        if supervisor.usable:
            _idle.append(supervisor)
            supervisor.timer = threading.Timer(IDLE_S, _close_idle, [supervisor])
            supervisor.timer.daemon = True
            supervisor.timer.start()
        else:
            supervisor.close()
            _all.remove(supervisor)


def _close_idle(supervisor: Supervisor) -> None:
    """Close a supervisor, unless it is in use."""
    try:
        _idle.remove(supervisor)
    except ValueError:
        return
    supervisor.close()
    _all.remove(supervisor)


@atexit.register
def stop() -> None:
    """End all supervisors. Calls of `play` that still run then return an error."""
    idle = [_idle.pop() for _ in range(len(_idle))]
    for supervisor in list(_all):
        if supervisor in idle:
            supervisor.close()
            _all.remove(supervisor)
        else:
            supervisor.end()
