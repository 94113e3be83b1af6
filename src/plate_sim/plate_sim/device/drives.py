"""Simulation of four CiA 402 drives or ODrives on a CAN bus. The simulation contains only those
functions of the drives that the firmware uses. `SetpointCheck` checks the setpoints that the
firmware sends.

A frame consists of an identifier and data. The tests `test/test_cia402.py` and
`test/test_odrive.py` use other simulated drives.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from plate_core.rig import ODRIVE_COUNTS, Drive, Limits

from .plate import COAST_RATE

Frame = tuple[int, bytes]

SYNC = 0x80
TPDO = 0x180
RPDO = 0x200
ANSWER = 0x580
REQUEST = 0x600
HEARTBEAT = 0x700

MODE = 0x6060
# Statusword of CiA 402 in each power state
OFF = 0x250
READY = 0x231
SWITCHED_ON = 0x233
ENABLED = 0x237

NEXT = {
    (OFF, 6): READY, (READY, 7): SWITCHED_ON, (SWITCHED_ON, 15): ENABLED, (SWITCHED_ON, 6): READY,
    (ENABLED, 7): SWITCHED_ON, (ENABLED, 6): READY,
}  # fmt: skip
"""Next power state of a CiA 402 drive, by the present power state and the controlword."""

REMOTE = 0x800
"""Flag that marks the identifier of a remote frame. A remote frame is a CAN frame that requests
data."""

# Messages, states and errors of an ODrive
GET_VERSION = 0x00
ODRIVE_HEARTBEAT = 0x01
ESTOP = 0x02
GET_ERROR = 0x03
SET_STATE = 0x07
GET_ESTIMATES = 0x09
SET_POSITION = 0x0C
CLEAR_ERRORS = 0x18
IDLE, CLOSED_LOOP = 1, 8
WATCHDOG_TIMER_EXPIRED, ESTOP_REQUESTED = 1 << 24, 1 << 25

WATCHDOG_MS = 100
"""Value of the parameter watchdog_timeout of an ODrive [ms]."""

BEAT_MS = 20
"""Value of the parameter heartbeat_msg_rate_ms of an ODrive [ms]."""

BANDWIDTH = 2 * np.pi * 150
"""Bandwidth of a drive's position control loop [rad/s]. The loop is critically damped and has speed
feedforward."""

TICK_S = 1e-3
CYCLE_S = 2e-3
"""Interval between two SYNC messages [s]. During this interval, a drive interpolates between two
setpoints."""

NO_OBJECT = 0x06020000


@dataclass
class _Node:
    """State of one CiA 402 drive, and its part of the protocol."""

    drive: Drive
    zero: int  # position at home [counts]
    operational: bool = False
    status: int = OFF
    order: int = 0
    goal: int = 0
    target: int = 0
    objects: dict[tuple[int, int], int] = field(default_factory=dict)

    def booted(self) -> list[Frame]:
        """Reset the drive, and return the boot-up message that it sends."""
        known = {(0x1000, 0): 0x20192, (0x6502, 0): 0x80, (0x1018, 4): self.drive.serial}
        self.operational, self.status, self.objects = False, OFF, known
        return [(HEARTBEAT + self.drive.node, b"\0")]

    def answered(self, request: bytes) -> list[Frame]:
        """Return the drive's reply to an expedited SDO request."""
        command, index, sub, value = struct.unpack("<BHBI", request)
        if command != 0x40:
            self.objects[index, sub] = value
            if index == MODE:
                # the operation mode that the drive reports changes immediately
                self.objects[MODE + 1, 0] = value
            command, value = 0x60, 0
        elif (index, sub) in self.objects:
            command, value = 0x43, self.objects[index, sub]
        else:
            command, value = 0x80, NO_OBJECT
        return [(ANSWER + self.drive.node, struct.pack("<BHBI", command, index, sub, value))]

    def synchronised(self, counts: int) -> list[Frame]:
        """Process a SYNC message. The last RPDO takes effect. Return a TPDO with status and
        position."""
        if not self.operational:
            return []
        data = struct.pack("<Hi", self.status, counts)
        # If bit 1 (enable voltage) of the controlword is 0, the drive switches off.
        kept = self.status if self.order & 2 else OFF
        self.status = NEXT.get((self.status, self.order), kept)
        self.target = self.goal
        return [(TPDO + self.drive.node, data)]


class SimulatedDrives:
    """Four CiA 402 drives with their motors. One tick is 1 ms.

    While the motors have no current, the flexures return them to home.

    Parameters
    ----------
    drives : sequence of Drive
        Drives of motor_1 to motor_4.
    """

    def __init__(self, drives: Sequence[Drive]) -> None:
        zeros = [0 if drive.absolute else 100_000 * drive.node for drive in drives]
        self._make_nodes(drives, zeros)
        self._scale = np.array([drive.counts_per_m * drive.sign for drive in drives])
        self.zeros = np.array(zeros)
        """Positions of the drives at home [counts]."""
        self._state = np.zeros((3, len(drives)))
        # Setpoints of the motors at the start and at the end of the present bus cycle [m].
        self._from = self._to = np.zeros(len(drives))
        self._time_since_sync_s = 0.0
        self._now_ms = 0

    def _make_nodes(self, drives: Sequence[Drive], zeros: Sequence[int]) -> None:
        self._nodes = [_Node(drive, zero) for drive, zero in zip(drives, zeros, strict=True)]

    @property
    def motors(self) -> np.ndarray:
        """Travel [m], speed [m/s] and acceleration [m/s2] of the four motors (3, 4)."""
        return self._state

    @property
    def enabled(self) -> np.ndarray:
        """Whether each motor has current (4,)."""
        return np.array([node.status == ENABLED for node in self._nodes])

    def receive(self, frames: Sequence[Frame]) -> list[Frame]:
        """Process the frames of the master, and return the replies of the drives."""
        answers: list[Frame] = []
        for identifier, data in frames:
            if identifier == SYNC:
                answers += self._process_sync()
                continue
            for node in self._nodes:
                if identifier == RPDO + node.drive.node:
                    node.order, node.goal = struct.unpack("<Hi", data)
                elif identifier == REQUEST + node.drive.node:
                    answers += node.answered(data)
                elif identifier == 0 and data[1] in (0, node.drive.node):
                    if data[0] in (0x81, 0x82):
                        answers += node.booted()
                    else:
                        node.operational = data[0] == 1
        return answers

    def _encoder_counts(self) -> list[int]:
        return (np.rint(self._state[0] * self._scale).astype(int) + self.zeros).tolist()

    def _process_sync(self) -> list[Frame]:
        answers = []
        for node, position in zip(self._nodes, self._encoder_counts(), strict=True):
            answers += node.synchronised(position)
        self._from = self._to
        self._to = (np.array([node.target for node in self._nodes]) - self.zeros) / self._scale
        self._time_since_sync_s = 0.0
        return answers

    def passed(self) -> list[Frame]:
        """Simulate one tick of the drives, and return the heartbeat messages that they send."""
        self._now_ms += 1
        driven = self._motor_state_after_tick()
        if not self.enabled.all():
            rest = np.zeros(len(driven[0]))
            driven = np.where(self.enabled, driven, self._follow_setpoint(rest, rest, COAST_RATE))
        self._state = driven
        return self._heartbeats()

    def _motor_state_after_tick(self) -> np.ndarray:
        before = self._time_since_sync_s
        self._time_since_sync_s = min(self._time_since_sync_s + TICK_S, CYCLE_S)
        speed = (self._to - self._from) / CYCLE_S
        slope = speed * (self._time_since_sync_s - before) / TICK_S
        return self._follow_setpoint(self._from + speed * self._time_since_sync_s, slope, BANDWIDTH)

    def _heartbeats(self) -> list[Frame]:
        beats = []
        for node in self._nodes:
            period = node.objects.get((0x1017, 0), 0)
            if period and self._now_ms % period == 0:
                state = b"\5" if node.operational else b"\x7f"
                beats.append((HEARTBEAT + node.drive.node, state))
        return beats

    def _follow_setpoint(self, setpoint: np.ndarray, slope: np.ndarray, rate: float) -> np.ndarray:
        """Return travel, speed and acceleration of the motors (3, 4) one tick later. Each motor
        follows a setpoint that moves at constant speed, with critical damping. The motor's position
        x obeys e'' + 2 rate e' + rate^2 e = 0 with e = x - setpoint. The setpoint moves with the
        speed `slope` [m/s]. The value of the setpoint at the end of the tick is `setpoint` [m].
        """
        behind = self._state[0] - (setpoint - slope * TICK_S)
        push = self._state[1] - slope + rate * behind
        fade = np.exp(-rate * TICK_S)
        behind = (behind + push * TICK_S) * fade
        speed = push * fade - rate * behind
        return np.stack([setpoint + behind, slope + speed, -rate * (2 * speed + rate * behind)])


@dataclass
class _ODrive:
    """State of one ODrive, and its part of the protocol."""

    drive: Drive
    state: int = IDLE
    errors: int = 0
    fed_ms: int = 0
    goal: float = 0.0  # requested position [turns]
    speed: float = 0.0  # requested speed [turns/s]

    def execute(self, message: int, data: bytes, now_ms: int, rotations: float) -> list[Frame]:
        """Execute a message to the drive, and return the drive's reply."""
        self.fed_ms = now_ms
        if message == SET_POSITION:
            self.goal, speed, _ = struct.unpack("<fhh", data)
            self.speed = 1e-3 * speed
        elif message == SET_STATE and not (data[0] == CLOSED_LOOP and self.errors):
            self.state = data[0]
        elif message == CLEAR_ERRORS:
            self.errors = 0
        elif message == ESTOP:
            self.state, self.errors = IDLE, ESTOP_REQUESTED
        known = {
            REMOTE | GET_VERSION: bytes([2, 4, 4, 58, 0, 6, 10, 0]),
            REMOTE | GET_ERROR: struct.pack("<II", self.errors, self.errors),
            REMOTE | GET_ESTIMATES: struct.pack("<ff", rotations, 0.0),
        }
        if message not in known:
            return []
        return [(self.drive.node << 5 | message & 31, known[message])]


class SimulatedODrives(SimulatedDrives):
    """Four ODrives with their motors. Torque feedforward is not simulated."""

    def _make_nodes(self, drives: Sequence[Drive], zeros: Sequence[int]) -> None:
        del zeros
        self._odrives = {drive.node: _ODrive(drive) for drive in drives}

    @property
    def enabled(self) -> np.ndarray:
        """Whether each motor has current (4,)."""
        return np.array([node.state == CLOSED_LOOP for node in self._odrives.values()])

    def receive(self, frames: Sequence[Frame]) -> list[Frame]:
        """Process the frames of the master, and return the replies of the drives."""
        answers: list[Frame] = []
        rotations = dict(
            zip(self._odrives, np.array(self._encoder_counts()) / ODRIVE_COUNTS, strict=True)
        )
        for identifier, data in frames:
            number = identifier >> 5 & 63
            if number in self._odrives:
                message = identifier & (REMOTE | 31)
                answers += self._odrives[number].execute(
                    message, data, self._now_ms, rotations[number]
                )
        return answers

    def _motor_state_after_tick(self) -> np.ndarray:
        # The position x of a motor obeys x'' = w^2 (goal - x) + 2 w (speed - x'). `goal` and
        # `speed` are constant until the next setpoint arrives.
        requests = np.array([(node.goal, node.speed) for node in self._odrives.values()]).T
        goals, speeds = ODRIVE_COUNTS * requests
        setpoints = (goals - self.zeros + 2 / BANDWIDTH * speeds) / self._scale
        return self._follow_setpoint(setpoints, np.zeros(len(setpoints)), BANDWIDTH)

    def _heartbeats(self) -> list[Frame]:
        beats = []
        for number, node in self._odrives.items():
            if node.state == CLOSED_LOOP and self._now_ms - node.fed_ms > WATCHDOG_MS:
                node.state, node.errors = IDLE, node.errors | WATCHDOG_TIMER_EXPIRED
            if self._now_ms % BEAT_MS == 0:
                data = struct.pack("<IBBBB", node.errors, node.state, 0, 0, 0)
                beats.append((number << 5 | ODRIVE_HEARTBEAT, data))
        return beats


class SetpointCheck:
    """Compares the setpoints that the firmware sends to the drives with the limits of the rig.
    Speed and acceleration are computed from differences of consecutive setpoints.

    Parameters
    ----------
    drives : sequence of Drive
    zeros : (4,)
        Positions of the drives at home [counts].
    limits : Limits
        Limits of the rig.
    """

    def __init__(self, drives: Sequence[Drive], zeros: np.ndarray, limits: Limits) -> None:
        self._odrives = drives[0].kind == "odrive"
        self._places = {
            drive.node << 5 | SET_POSITION if self._odrives else RPDO + drive.node: m
            for m, drive in enumerate(drives)
        }
        self._last = max(self._places) if self._odrives else SYNC
        self._scale = np.array([drive.counts_per_m * drive.sign for drive in drives])
        self._zeros, self._targets = zeros, np.zeros(len(drives), int)
        self._limits = np.array([limits.stroke_m, limits.speed, limits.accel])
        # last three setpoints [m]; empty while the motors have no current
        self._setpoints: list[np.ndarray] = []
        self.fractions = np.zeros(3)
        """Maximum stroke, speed and acceleration of the setpoints so far, as fractions of the
        limits."""

    def receive(self, frames: Sequence[Frame], enabled: bool) -> None:
        """Check the setpoints in the frames that the firmware sent in a tick. `enabled` states
        whether all motors have current."""
        for identifier, data in frames:
            if identifier in self._places:
                if self._odrives:
                    target = round(ODRIVE_COUNTS * struct.unpack("<f", data[:4])[0])
                else:
                    target = struct.unpack("<Hi", data)[1]
                self._targets[self._places[identifier]] = target
            if identifier == self._last:
                places = [*self._setpoints[-2:], (self._targets - self._zeros) / self._scale]
                self._setpoints = places if enabled else []
                steps = np.diff(places, axis=0) / CYCLE_S
                if enabled:
                    found = (places, steps, np.diff(steps, axis=0) / CYCLE_S)
                    maxima = [np.max(np.abs(values), initial=0.0) for values in found]
                    self.fractions = np.maximum(self.fractions, maxima / self._limits)
