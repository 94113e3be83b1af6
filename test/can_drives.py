"""CiA 402 drives for the firmware in simulated time. The CANopen stack is `canopen`; this file has
the bus, the power state machine and the motion."""

import io
import math
import subprocess
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import can
import canopen
import numpy as np
from device_orders import say, tell
from rigid_plate import Plate

from plate_core.serial_protocol import Heartbeat

PDO_COMMUNICATION = {0: ("NumberOfEntries", 5, 2), 1: ("COB-ID", 7, None), 2: ("Type", 5, 255)}
MASTER = 127
REFUSED = 0x08000020  # data cannot be stored

STATUS = {
    "not ready": 0x200,
    "switch on disabled": 0x250,
    "ready": 0x231,
    "switched on": 0x233,
    "enabled": 0x237,
    "quick stop": 0x217,
    "fault reaction": 0x21F,
    "fault": 0x218,
}


def eds(node: int, without: tuple[int, ...] = (), **values: int) -> str:
    """Return the EDS of a drive. `values` are defaults of objects, with keys such as x1000_0."""
    objects: dict[int, dict[int, tuple[str, int, int | None]]] = {
        0x1000: {0: ("DeviceType", 7, 0x20192)},
        0x1001: {0: ("ErrorRegister", 5, 0)},
        0x1016: {0: ("Count", 5, 1), 1: ("ConsumerHeartbeat", 7, 0)},
        0x1017: {0: ("ProducerHeartbeat", 6, 0)},
        0x1018: {0: ("Count", 5, 4), 1: ("Vendor", 7, 1), 4: ("Serial", 7, 700 + node)},
        0x6007: {0: ("AbortConnection", 3, 1)},
        0x6040: {0: ("Controlword", 6, 0)},
        0x6041: {0: ("Statusword", 6, 0)},
        0x605A: {0: ("QuickStopOption", 3, 2)},
        0x6060: {0: ("Mode", 2, 0)},
        0x6061: {0: ("ModeDisplay", 2, 0)},
        0x6064: {0: ("Position", 4, 0)},
        0x607A: {0: ("Target", 4, 0)},
        0x60C2: {0: ("Count", 5, 2), 1: ("Period", 5, 1), 2: ("Exponent", 2, -2)},
        0x6502: {0: ("Modes", 7, 0x3ED)},
    }
    for number in range(2):
        for index, cob in ((0x1400, 0x200), (0x1800, 0x180)):
            record = dict(PDO_COMMUNICATION)
            record[1] = ("COB-ID", 7, cob + 0x100 * number + node)
            objects[index + number] = record
        for index, first in ((0x1600, 0x60400010), (0x1A00, 0x60410010)):
            mapped = {1: ("First", 7, first), 2: ("Second", 7, 0)}
            objects[index + number] = {0: ("Count", 5, 1), **mapped}
    lines = ["[DeviceInfo]", "BaudRate_1000=1"]
    for index, subs in sorted(objects.items()):
        if index in without:
            continue
        if len(subs) > 1:
            lines += [f"[{index:X}]", f"ParameterName=Object{index:X}", "ObjectType=0x9"]
            lines += [f"SubNumber={len(subs)}"]
        for sub, (name, kind, default) in subs.items():
            lines.append(f"[{index:X}sub{sub:X}]" if len(subs) > 1 else f"[{index:X}]")
            default = values.get(f"x{index:X}_{sub}", default)
            lines += [f"ParameterName={name}{index:X}{sub}", "ObjectType=0x7"]
            lines += [f"DataType=0x{kind:04X}", "AccessType=rw", f"DefaultValue={default}"]
            lines += ["PDOMapping=1"]
    return "\n".join([*lines, ""])


def crc15(bits: str) -> int:
    """Return the CRC of a frame's bits (ISO 11898-1)."""
    crc = 0
    for bit in bits:
        crc = crc << 1 ^ (0x4599 if (bit == "1") != bool(crc & 0x4000) else 0)
        crc &= 0x7FFF
    return crc


def frame_bits(identifier: int, data: bytes) -> int:
    """Return the number of bits of a frame on the bus. With 0x800 in its identifier the frame is a
    request for eight bytes.

    The number includes the three bits between two frames, and the stuffed bits (ISO 11898-1: from
    the start of the frame to the end of the CRC, five equal bits are followed by one of the other
    value).
    """
    remote = identifier >> 11
    size = 8 if remote else len(data)
    head = f"0{identifier & 0x7FF:011b}{remote}00{size:04b}"
    head += "".join(f"{byte:08b}" for byte in data)
    stuffed, run, last = 0, 0, ""
    for bit in head + f"{crc15(head):015b}":
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed, last, run = stuffed + 1, "1" if bit == "0" else "0", 1
    return len(head) + 15 + stuffed + 10 + 3


class Wire:
    """One end of a CAN bus within this process, as `can.Bus(interface="virtual")` is one: without
    its locks, and with one copy of the data for all ends."""

    channels: ClassVar[dict[str, list["Wire"]]] = {}

    def __init__(self, channel: str) -> None:
        self.messages: deque[can.Message] = deque()
        self.ends = self.channels.setdefault(channel, [])
        self.ends.append(self)

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        message.data = bytearray(message.data)  # the sender's buffer may change
        for end in self.ends:
            if end is not self:
                end.messages.append(message)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next message, or None if there is none now."""
        return self.messages.popleft() if self.messages else None

    def shutdown(self) -> None:
        self.ends.remove(self)


@dataclass
class Beat:
    """A message that a node sends periodically, in simulated time [ms]."""

    network: "SteppedNetwork"
    id: int
    data: bytes
    period: float
    due: float

    def update(self, data: bytes) -> None:
        self.data = data

    def stop(self) -> None:
        self.network.beats.remove(self)


class SteppedNetwork(canopen.Network):
    """A network without threads. `take` delivers the messages that have arrived."""

    def __init__(self, bus: Any) -> None:
        super().__init__(bus)
        self.now = 0.0
        self.beats: list[Beat] = []

    def send_periodic(self, can_id, data, period, remote=False):
        beat = Beat(self, can_id, bytes(data), 1e3 * period, self.now + 1e3 * period)
        self.beats.append(beat)
        return beat

    def take(self) -> None:
        while (message := self.bus.recv(0)) is not None:
            self.notify(message.arbitration_id, message.data, 1e-3 * self.now)

    def pass_ms(self) -> None:
        self.now += 1
        for beat in list(self.beats):
            if self.now >= beat.due:
                beat.due += beat.period
                self.send_message(beat.id, beat.data)


class Drive(canopen.LocalNode):
    """A drive with the behaviour that the standard requires, and a motor with a first-order lag."""

    def __init__(self, network: SteppedNetwork, node: int, lag_ms: float = 1.0, **of_eds) -> None:
        file = io.StringIO(eds(node, **of_eds))
        file.name = "drive.eds"
        super().__init__(node, canopen.import_od(file, node))
        self.state = "switch on disabled"
        self.position = 0.0
        self.start = 0.0
        self.goal = 0.0
        self.into = 0.0
        self.lag_ms = lag_ms
        self.jammed = False
        self.mute = False
        self.keeps = False  # keeps its current, whatever the controlword
        self.holds = ""  # a state that only "disable voltage" ends, if it is not fault
        self.word, self.heard, self.enables = 0, math.inf, 0
        self.deaf = True  # its supply is off
        self.stuck_mode, self.remote = False, True
        self.slip = 0.0  # counts that it has lost
        self.leap = 0.0  # counts that it loses each time it is enabled
        self.wrong_once: tuple[str, int] | None = None  # a state, and the error in it [counts]
        self.history: list[str] = []
        self.asked: list[tuple[str, str, int]] = []  # transitions by a controlword
        self.refuses: tuple[int, int] | None = None  # an object
        self.add_write_callback(self.on_write)
        network.create_node(self)
        network.subscribe(0, self.on_nmt)
        network.subscribe(0x80, self.on_sync)
        network.subscribe(0x700 + MASTER, self.on_master)

    def swap(self, **of_eds) -> "Drive":
        """Replace the drive by another one."""
        for identifier, call in (
            (0, self.on_nmt), (0x80, self.on_sync), (0x700 + MASTER, self.on_master),
        ):  # fmt: skip
            self.network.unsubscribe(identifier, call)
        other = Drive(self.network, self.id, **of_eds)
        other.position = self.position
        return other

    @property
    def enabled(self) -> bool:
        return self.state == "enabled"

    def value(self, index: int, sub: int = 0) -> int:
        obj = self._find_object(index, sub)
        return obj.decode_raw(self.get_data(index, sub))

    def boot(self) -> None:
        """Restart as after power-up or a reset."""
        self.deaf = False
        self.nmt.stop_heartbeat()
        self.data_store.clear()
        self.heard = math.inf
        if self.state not in ("fault", "switch on disabled"):
            self.enter("switch on disabled")
        self.nmt.state = "INITIALISING"
        self.nmt.state = "PRE-OPERATIONAL"

    def on_nmt(self, _, data, __) -> None:
        if self.deaf:
            self.nmt._state = 0
        elif data[1] in (0, self.id):
            if data[0] in (129, 130):
                self.boot()
            elif data[0] == 1:
                for pdo in (self.rpdo[1], self.tpdo[1]):
                    pdo.read()
                self.heard = self.network.now

    def get_data(self, index, subindex, check_readable=False):
        self.refuse(check_readable and (index, subindex))
        return super().get_data(index, subindex, check_readable)

    def set_data(self, index, subindex, data, check_writable=False):
        self.refuse(check_writable and (index, subindex))
        if index >> 8 == 0x18 and subindex == 1 and not data[3] & 0x40:
            raise canopen.SdoAbortedError(0x06090030)  # requests of this PDO get no reply
        super().set_data(index, subindex, data, check_writable)

    def refuse(self, by_sdo: Any) -> None:
        if by_sdo and by_sdo == self.refuses:
            raise canopen.SdoAbortedError(REFUSED)

    def on_write(self, index, data, **_) -> None:
        if index == 0x6040:
            self.controlled(int.from_bytes(data, "little"))
        elif index == 0x6060 and not self.stuck_mode:
            self.data_store.setdefault(0x6061, {})[0] = bytes(data)

    def on_master(self, *_) -> None:
        self.heard = self.network.now

    def on_sync(self, *_) -> None:
        if self.deaf or self.nmt.state != "OPERATIONAL":
            return
        rpdo, tpdo = self.rpdo[1], self.tpdo[1]
        assert rpdo.enabled
        assert tpdo.enabled
        assert rpdo.trans_type == tpdo.trans_type == 1
        status = STATUS[self.state] & (0xFFFF if self.remote else ~0x200)
        self.data_store.setdefault(0x6041, {})[0] = status.to_bytes(2, "little")
        wrong = 0
        if self.wrong_once and self.wrong_once[0] == self.state:
            wrong, self.wrong_once = self.wrong_once[1], None
        place = round(self.position + self.slip + wrong).to_bytes(4, "little", signed=True)
        self.data_store.setdefault(0x6064, {})[0] = place
        for each in tpdo.map:
            each.set_data(self.get_data(each.index, each.subindex))
        if not self.mute:
            tpdo.transmit()
        if rpdo.is_received:
            for each in rpdo.map:
                self.set_data(each.index, each.subindex, each.get_data())
            self.start, self.goal, self.into = self.goal, self.value(0x607A), 0.0
            if self.state != "enabled":
                self.start = self.goal

    def enter(self, state: str) -> None:
        self.state = state
        self.history.append(state)
        if state == "enabled":
            self.enables += 1
            self.slip += self.leap

    def controlled(self, word: int) -> None:
        before = self.state
        if not self.keeps and (before != self.holds or not word & 0x82):
            self.switch(word)
        if self.state != before:
            self.asked.append((before, self.state, word))
        self.word = word

    def switch(self, word: int) -> None:
        """Make the transition of CiA 402 that a controlword requests, one per controlword."""
        reset = word & ~self.word & 0x80
        low = word & 0xF
        if self.state in ("not ready", "fault reaction"):
            return
        if self.state == "fault":
            if reset:
                self.enter("switch on disabled")
        elif not word & 2:  # disable voltage
            if self.state != "switch on disabled":
                self.enter("switch on disabled")
        elif not word & 4:
            self.enter("quick stop" if self.state == "enabled" else "switch on disabled")
        elif self.state == "switch on disabled" and low & 7 == 6:
            self.enter("ready")
        elif self.state == "ready" and low & 7 == 7:
            self.enter("switched on")
        elif self.state == "switched on" and low == 15:
            assert self.value(0x6060) == 8
            self.enter("enabled")
            self.start = self.goal = self.value(0x607A)
        elif self.state in ("switched on", "enabled") and low & 7 == 6:
            self.enter("ready")
        elif self.state == "enabled" and low == 7:
            self.enter("switched on")

    def fail(self, code: int, register: int = 1) -> None:
        """Enter the state fault, and send an emergency message."""
        self.emcy.send(code, register)
        self.enter("fault")

    def pass_ms(self) -> None:
        if self.deaf:
            return
        if self.state == "enabled":
            consumer = self.value(0x1016, 1)
            if consumer and self.network.now - self.heard > consumer & 0xFFFF:
                self.emcy.send(0x8130, 0x11)
                self.enter({2: "switch on disabled", 3: "quick stop"}[self.value(0x6007)])
        if self.state == "enabled" and not self.jammed:
            period = self.value(0x60C2, 1) * 10.0 ** (self.value(0x60C2, 2) + 3)
            self.into = min(self.into + 1, period)
            expected = self.start + (self.goal - self.start) * self.into / period
            miss = expected - self.slip - self.position
            self.position += miss * -math.expm1(-1 / self.lag_ms)


@dataclass
class CanBench:
    """The firmware as a process, with drives on its bus. Its tick is one millisecond of the
    drives."""

    program: Path
    channel: str
    network: Any = None
    sent: list[tuple[int, int, bytes]] = field(default_factory=list)  # [ms], id, data
    both: list[tuple[int, int, bytes]] = field(default_factory=list)  # in both directions
    written: bytes = b""
    state: int = 0
    faults: int = 0
    stop: int = 0
    cut: bool = False  # the firmware's wire is cut
    plate: Plate | None = None  # plate that all drives move
    home_ms: int = 600  # maximum duration of the motion to home

    def __post_init__(self) -> None:
        self.network = self.network or SteppedNetwork(Wire(self.channel))
        self.own = Wire(self.channel)
        self.process = subprocess.Popen(
            [self.program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.drives: list[Drive] = []

    def order(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")

    def run(self, ms: int) -> None:
        """Advance the time of drives and bus, then of the firmware."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        for _ in range(ms):
            self.network.pass_ms()
            for drive in self.drives:
                drive.pass_ms()
            if self.plate:
                self.plate.hold(self.drives)
            while (message := self.own.recv(0)) is not None:
                now = round(self.network.now)
                self.both.append((now, message.arbitration_id, bytes(message.data)))
                if not self.cut:
                    self.order(f"can {message.arbitration_id:x} {message.data.hex()}")
            self.order("run 1000")
            self.process.stdin.flush()
            for line in iter(self.process.stdout.readline, ""):
                kind, *words = line.split()
                if kind == "can":
                    identifier, data = int(words[0], 16), bytes.fromhex("".join(words[1:]))
                    self.sent.append((round(self.network.now), identifier, data))
                    self.both.append(self.sent[-1])
                    if not self.cut:
                        self.own.send(can.Message(
                            arbitration_id=identifier & 0x7FF, is_extended_id=False,
                            is_remote_frame=identifier > 0x7FF, data=data,
                            dlc=8 if identifier > 0x7FF else len(data),
                        ))  # fmt: skip
                elif kind == "tx":
                    self.written += bytes.fromhex(words[0])
                elif kind == "state":
                    self.state, self.faults = int(words[0]), int(words[1])
                    self.stop = int(words[3])
                    break
            else:
                raise AssertionError("the firmware has ended")
            self.network.take()

    def disturb(self, count: int, known: np.ndarray) -> None:
        """Also send the firmware random frames, most of them with a known identifier."""
        rng = np.random.default_rng(5)
        chosen, others = rng.choice(known, count), rng.integers(0x800, size=count)
        identifiers = np.where(rng.random(count) < 0.8, chosen, others).tolist()
        noise, sizes = rng.bytes(8 * count).hex(), (2 * rng.integers(9, size=count)).tolist()
        for k, (identifier, size) in enumerate(zip(identifiers, sizes, strict=True)):
            self.order(f"can {identifier:x} {noise[16 * k : 16 * k + size]}")
            if k % 600 == 0:
                tell(self, say(1, Heartbeat(1)))
            if k % 15 == 0:  # together with the drives' frames, at most as many as a tick reads
                self.run(1)

    def end(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        assert self.process.wait(10) == 0
        self.network.bus.shutdown()
        self.own.shutdown()
