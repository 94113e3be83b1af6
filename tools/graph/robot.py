"""A robot controller that picks parts from a running feeder.

The controller sends commands to the feeder over TCP, as a real robot controller does. The
controller moves the simulator's robot by the service simulator/move_robot. The steps and their
times are the same as in `plate_bringup.production.Robot`.
"""

from __future__ import annotations

import math
import re
import socket
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plate_bringup import GraphError
from plate_bringup.production import Act
from plate_bringup.production import Robot as Arm
from plate_interfaces.srv import MoveRobot

from .observer import Observer, Record

CONNECT_S, ANSWER_S = 10.0, 60.0
"""Maximum wait for a connection to the feeder's server, and maximum wait for a reply [s]."""

CALL_S = 2.0
"""Maximum wait for the simulator's reply [s]."""

NEAR_MM, NEAR_DEG = 0.5, 2.0
"""Maximum error of a published part pose: position [mm] and angle [deg]. Above this error, a
gripper can miss the part."""

VALUE = re.compile(r"(\w+)=(\S+)")


@dataclass(frozen=True)
class Grip:
    """One attempt to pick a part.

    Attributes
    ----------
    waited_s : float
        Time for which the robot was ready and waited for the feeder's reply [s].
    taken : bool
        Whether the robot has the part.
    error_m, error_rad : float
        Difference between the part's true pose and the pose in the reply [m, rad].
    cycle_s : float
        Time since the last attempt, or since the start of the run for the first attempt [s].
    """

    waited_s: float
    taken: bool
    error_m: float
    error_rad: float
    cycle_s: float


@dataclass
class Robot:
    """Robot at a running feeder on this computer. Use this class as a context manager.

    Parameters
    ----------
    observer : Observer
    port : int
        Port of the feeder's TCP server.
    cycle_s : float
        Time between two picks if the robot never waits [s].
    grips : list of Grip
        Attempts so far.
    """

    observer: Observer
    port: int
    cycle_s: float = 2.0
    grips: list[Grip] = field(default_factory=list)

    def __enter__(self) -> Robot:
        self._socket = socket.create_connection(("127.0.0.1", self.port), timeout=CONNECT_S)
        self._socket.setblocking(False)
        self._text = b""
        self._client = self.observer.node.create_client(MoveRobot, "simulator/move_robot")
        if not self.observer.until(self._client.service_is_ready, CONNECT_S):
            raise GraphError("service simulator/move_robot does not exist")
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()
        self.observer.node.destroy_client(self._client)

    def ask(self, line: str, timeout_s: float = ANSWER_S) -> tuple[int, str]:
        """Send a command, and return the code and the text of the reply.

        Raises
        ------
        GraphError
            If there is no reply in time, or the connection ends.
        """
        self.send(line)
        return self.answer(timeout_s)

    def send(self, line: str) -> None:
        """Send a command."""
        self._socket.sendall(line.encode() + b"\n")

    def answer(self, timeout_s: float = ANSWER_S) -> tuple[int, str]:
        """Wait for a reply, and return its code and text. Raise the same errors as `ask`."""
        if not self.observer.until(self._receive_reply, timeout_s):
            raise GraphError(f"the feeder has not answered within {timeout_s:g} s")
        line, _, self._text = self._text.partition(b"\n")
        code, _, text = line.decode().strip().partition(" ")
        return int(code), text

    def _receive_reply(self) -> bool:
        try:
            data = self._socket.recv(4096)
        except BlockingIOError:
            return b"\n" in self._text
        if not data:
            raise GraphError("the feeder has closed the connection")
        self._text += data
        return b"\n" in self._text

    def work(self, picks: int) -> Iterator[Grip]:
        """Pick `picks` parts, with the steps of `plate_bringup.production.Robot`. Yield every
        attempt.

        Raises
        ------
        GraphError
            If the feeder refuses a command. The message contains the feeder's reply.
        """
        arm, name = Arm(self.cycle_s, self._now(), Act.REQUEST), ""
        while picks > 0 or arm.next is Act.LEAVE:
            self.observer.until(lambda: False, arm.due - self._now())
            before = arm
            arm, act = before.step(self._now())
            if act is Act.REQUEST:
                reply = dict(VALUE.findall(self._execute("get_part")))
                x, y, name = 1e-3 * float(reply["x"]), 1e-3 * float(reply["y"]), reply["id"]
                arm = arm.after_reply((x, y, math.radians(float(reply["angle"]))), self._now())
            elif act is Act.LEAVE:
                self._move(MoveRobot.Request.AWAY)
                self._execute(f"part_taken {name} {'ok' if self.grips[-1].taken else 'failed'}")
            elif act is Act.COME and before.pose is not None:
                self._move(MoveRobot.Request.OVER, *before.pose)
            elif act is Act.GRIP and before.pose is not None:
                done = self._move(MoveRobot.Request.GRIP, *before.pose)
                picks -= done.success
                waited_s, cycle_s = before.waited(before.due), before.due - before.since
                self.grips.append(
                    Grip(waited_s, done.success, done.error_m, done.error_rad, cycle_s)
                )
                yield self.grips[-1]

    def _execute(self, line: str) -> str:
        """Send a command that must succeed, and return the text of the reply."""
        code, text = self.ask(line)
        if code != 200:
            raise GraphError(f"{line}: {code} {text}")
        return text

    def _move(self, to: int, x: float = 0.0, y: float = 0.0, angle: float = 0.0) -> Any:
        future = self._client.call_async(MoveRobot.Request(to=to, x=x, y=y, angle=angle))
        if not self.observer.until(future.done, CALL_S):
            raise GraphError(f"simulator/move_robot has not answered within {CALL_S:g} s")
        return future.result()

    def _now(self) -> float:
        return 1e-9 * self.observer.node.get_clock().now().nanoseconds


def feed_result(
    grips: list[Grip], record: Record, picks: int, labels: Iterable[str]
) -> dict[str, Any]:
    """Return the entries of result.json for a run with a robot.

    Parameters
    ----------
    grips : list of Grip
    record : Record
    picks : int
        Number of parts that the robot should take.
    labels : iterable of str
        Classes of the parts to pick. If a part of these classes leaves over the chute, the part
        counts as lost.
    """
    taken = [grip for grip in grips if grip.taken]
    time_s = sum(grip.cycle_s for grip in grips)
    errors_mm = [1e3 * grip.error_m for grip in taken]
    turned = [abs(math.degrees(grip.error_rad)) for grip in taken]

    def last_count(what: str) -> int:
        return int(record.last("simulator", what, "0"))

    astray = sum(last_count(f"{label} over the chute") for label in labels)
    lost = last_count("parts dropped") + astray
    near = bool(taken) and max(errors_mm) <= NEAR_MM and max(turned) <= NEAR_DEG
    return {
        "success": len(taken) >= picks and near and lost == 0,
        "message": record.states[-1] if len(taken) < picks else "",
        "dropped": lost,
        "picks": len(taken),
        "picks_failed": len(grips) - len(taken),
        "time_s": round(time_s, 1),
        "parts_per_minute": round(60 * len(taken) / time_s, 1) if grips else 0.0,
        "robot_waits_share": round(sum(g.waited_s for g in grips) / time_s, 4) if grips else 0,
        "pick_error_mm": [round(float(f(errors_mm)), 3) for f in (np.median, max) if taken],
        "pick_error_deg": [round(float(f(turned)), 2) for f in (np.median, max) if taken],
        "discharged": last_count("parts over the chute") - astray,
    }
