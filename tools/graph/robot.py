"""A robot that takes parts from a running feeder: it talks to it over TCP as a robot controller
does, and moves the simulator's robot."""

from __future__ import annotations

import math
import re
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plate_bringup import GraphError
from plate_bringup.production import ASKS, COMES, LEAVES
from plate_interfaces.srv import MoveRobot

from .observer import Observer, Record

CONNECT_S, ANSWER_S = 10.0, 60.0
"""Longest wait for the server, and for an answer [s]."""

CALL_S = 2.0
"""Longest wait for the simulator [s]."""

NEAR_MM, NEAR_DEG = 0.5, 2.0
"""A part that lies further from where it was said may be missed by a gripper."""

VALUE = re.compile(r"(\w+)=(\S+)")


@dataclass(frozen=True)
class Grip:
    """One try to take a part.

    Attributes
    ----------
    id : str
        Of the part, as the feeder has told.
    waited_s : float
        How long the robot waited for the answer, ready to come [s].
    taken : bool
    error_m, error_rad : float
        How far the true part was from where it was told [m, rad].
    message : str
        What the simulator says.
    cycle_s : float
        Time since the last grip, or the beginning [s].
    """

    id: str
    waited_s: float
    taken: bool
    error_m: float
    error_rad: float
    message: str
    cycle_s: float


@dataclass
class Robot:
    """A robot at a running feeder; a context manager.

    Parameters
    ----------
    observer : Observer
    host, port
        Of the feeder's TCP server.
    cycle_s : float
        Time from one grip to the next, if it never waits [s].
    """

    observer: Observer
    host: str
    port: int
    cycle_s: float = 2.0
    grips: list[Grip] = field(default_factory=list)
    _last: float = 0.0  # when it gripped last [s]

    def __enter__(self) -> Robot:
        self._socket = socket.create_connection((self.host, self.port), timeout=CONNECT_S)
        self._socket.setblocking(False)
        self._text = b""
        self._client = self.observer.node.create_client(MoveRobot, "simulator/move_robot")
        if not self.observer.until(self._client.service_is_ready, CONNECT_S):
            raise GraphError("service simulator/move_robot is not there")
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()
        self.observer.node.destroy_client(self._client)

    def ask(self, line: str, timeout_s: float = ANSWER_S) -> tuple[int, str]:
        """Send a command; return code and text of its answer.

        Raises
        ------
        GraphError
            If there is none in time, or the connection ends.
        """
        self.send(line)
        return self.answer(timeout_s)

    def send(self, line: str) -> None:
        """Send a command."""
        self._socket.sendall(line.encode() + b"\n")

    def answer(self, timeout_s: float = ANSWER_S) -> tuple[int, str]:
        """Wait for an answer; see `ask`."""
        if not self.observer.until(self._answered, timeout_s):
            raise GraphError(f"the feeder has not answered within {timeout_s:g} s")
        line, _, self._text = self._text.partition(b"\n")
        code, _, text = line.decode().strip().partition(" ")
        return int(code), text

    def _answered(self) -> bool:
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return b"\n" in self._text
        if not data:
            raise GraphError("the feeder has ended the connection")
        self._text += data
        return b"\n" in self._text

    def work(self, picks: int, each: Callable[[Grip], None] = lambda grip: None) -> None:
        """Take so many parts; `each` is called after every try.

        Raises
        ------
        GraphError
            If the feeder refuses a command: its answer.
        """
        self._last = self._now()
        self._wait(ASKS * self.cycle_s)
        while sum(grip.taken for grip in self.grips) < picks:
            self.send("get_part")
            until = self._now() + (COMES - ASKS) * self.cycle_s
            code, text = self.answer()
            waited = max(0.0, self._now() - until)
            if code != 200:
                raise GraphError(f"get_part: {code} {text}")
            self._wait(until - self._now())
            grip = self._grip(text, waited)
            self.grips.append(grip)
            each(grip)
            self._wait((ASKS - LEAVES) * self.cycle_s)

    def _grip(self, text: str, waited: float) -> Grip:
        """Take the part that was told."""
        told = dict(VALUE.findall(text))
        x, y = 1e-3 * float(told["x"]), 1e-3 * float(told["y"])
        angle = math.radians(float(told["angle"]))
        grips_at = self._now() + (1 - COMES) * self.cycle_s
        self._move(MoveRobot.Request.OVER, x, y, angle)
        self._wait(grips_at - self._now())
        done = self._move(MoveRobot.Request.GRIP, x, y, angle)
        at = self._now()
        leaves_at = at + LEAVES * self.cycle_s
        self._wait(leaves_at - self._now())
        self._move(MoveRobot.Request.AWAY)
        code, answer = self.ask(f"part_taken {told['id']} {'ok' if done.success else 'failed'}")
        if code != 200:
            raise GraphError(f"part_taken {told['id']}: {code} {answer}")
        cycle_s, self._last = at - self._last, at
        return Grip(
            told["id"], waited, done.success, done.error_m, done.error_rad, str(done.message),
            cycle_s,
        )  # fmt: skip

    def _move(self, to: int, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> Any:
        future = self._client.call_async(MoveRobot.Request(to=to, x=x, y=y, angle=angle))
        if not self.observer.until(future.done, CALL_S):
            raise GraphError(f"simulator/move_robot has not answered within {CALL_S:g} s")
        return future.result()

    def _now(self) -> float:
        return 1e-9 * self.observer.node.get_clock().now().nanoseconds

    def _wait(self, seconds: float) -> None:
        if seconds > 0:
            self.observer.until(lambda: False, seconds)


def feed_result(
    grips: list[Grip], record: Record, picks: int, wanted: Iterable[str]
) -> dict[str, Any]:
    """Return what goes into result.json of a run in which a robot was to take so many parts, of
    classes that are wanted: of these none may go to the chute."""
    taken = [grip for grip in grips if grip.taken]
    away = 1e3 * np.array([grip.error_m for grip in taken])
    turned = np.degrees([grip.error_rad for grip in taken])
    time_s = sum(grip.cycle_s for grip in grips)
    astray = [f"{label} over the chute" for label in wanted]
    gone = {
        name: int(record.last("simulator", name, "0"))
        for name in ("parts dropped", "parts over the chute", *astray)
    }
    lost = gone["parts dropped"] + sum(gone[name] for name in astray)
    near = bool(taken) and bool(away.max() <= NEAR_MM and turned.max() <= NEAR_DEG)
    return {
        "success": len(taken) >= picks and near and lost == 0,
        "message": record.states[-1] if len(taken) < picks else "",
        "dropped": lost,
        "picks": len(taken),
        "picks_failed": len(grips) - len(taken),
        "time_s": round(time_s, 1),
        "parts_per_minute": round(60 * len(taken) / time_s, 1) if grips else 0.0,
        "robot_waits_share": round(sum(grip.waited_s for grip in grips) / time_s, 4)
        if grips
        else 0,
        "pick_error_mm": [round(float(f(away)), 3) for f in (np.median, np.max)] if taken else [],
        "pick_error_deg": [round(float(f(turned)), 2) for f in (np.median, np.max)]
        if taken
        else [],
        "discharged": gone["parts over the chute"] - sum(gone[name] for name in astray),
    }


def summary(result: dict[str, Any]) -> str:
    """Return such a result in a line or two for a reader."""
    verdict = "Success" if result["success"] else f"No success ({result['message'] or 'see below'})"
    text = f"{verdict}: {result['picks']} parts taken in {result['time_s']:.0f} s"
    if result["picks"]:
        (away, most), (turned, most_turned) = result["pick_error_mm"], result["pick_error_deg"]
        text += (
            f" ({result['parts_per_minute']:.0f} a minute), the robot waited "
            f"{100 * result['robot_waits_share']:.1f} % of the time. Parts lay {away:.2f} mm and "
            f"{turned:.1f} degrees from where they were said, {most:.2f} mm and {most_turned:.1f} "
            "degrees at most"
        )
    limits = "within limits" if result["setpoints_within_limits"] else "LIMITS BROKEN"
    return (
        f"{text}; {result['picks_failed']} picks failed, {result['discharged']} parts went to the "
        f"chute, {result['dropped'] or 'none'} lost; all {result['motor_setpoints']} motor tables "
        f"{limits}."
    )
