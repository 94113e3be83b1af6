"""ODrives for the firmware in simulated time. Frames are decoded and encoded by the DBC of
CANSimple (firmware 0.6.10) in the package `odrive_can`. States and motion follow the manual."""

from importlib.util import find_spec
from pathlib import Path

import can
import cantools
from can_drives import Wire

REMOTE = 0x800
IDLE, CLOSED_LOOP = 1, 8
ERRORS = {
    "low voltage": 0x200,
    "watchdog": 0x1000000,
    "estop": 0x2000000,
    "spinout": 0x4000000,
    "initializing": 0x1,
}


def messages() -> dict[int, "cantools.db.Message"]:
    """Messages of a drive, by the five lower bits of their identifier."""
    folder = find_spec("odrive_can").submodule_search_locations[0]
    database = cantools.database.load_file(Path(folder) / "dbc" / "odrive-cansimple-0.6.10.dbc")
    own = [message for message in database.messages if message.name.startswith("Axis0_")]
    return {message.frame_id & 31: message for message in own}


class Bus:
    """The drives' end of a bus. `take` delivers the frames that have arrived."""

    def __init__(self, channel: str) -> None:
        self.bus = Wire(channel)
        self.now = 0.0
        self.drives: list[ODrive] = []

    def send_message(self, identifier: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def pass_ms(self) -> None:
        self.now += 1

    def take(self) -> None:
        while (message := self.bus.recv(0)) is not None:
            for drive in self.drives:
                if message.arbitration_id >> 5 == drive.node and not drive.off:
                    drive.receive(message)


class ODrive:
    """A drive with cascaded loops and feed-forward of the speed, without the load's inertia."""

    def __init__(self, bus: Bus, node: int, dbc, **change) -> None:
        self.network, self.node, self.dbc = bus, node, dbc
        self.off = True
        self.jammed = False
        self.mute = False
        self.silent = False
        self.stuck = False
        self.keeps = False  # keeps its current
        self.wrong_once = 0.0  # error of the next reported position [turns]
        self.watchdog_ms, self.protocol = 100, 2
        vars(self).update(change)
        self.position, self.goal, self.speed, self.torque = 0.0, 0.0, 0.0, 0.0  # turns
        self.state = IDLE
        self.errors = 0
        self.reason = 0
        self.fed = 0.0
        self.mode = (0, 0)
        self.history: list[str] = []
        bus.drives.append(self)

    @property
    def enabled(self) -> bool:
        return self.state == CLOSED_LOOP

    @property
    def enables(self) -> int:
        return self.history.count("CLOSED_LOOP_CONTROL")

    def boot(self) -> None:
        """Restart as after power-up or a reset. The position is not changed."""
        self.off = False
        self.state = IDLE
        self.errors = 0
        self.reason = 0
        self.fed = 0.0

    def disarm(self, error: str = "", clears: bool = False) -> None:
        self.reason = self.errors = ERRORS.get(error, 0)
        self.state = IDLE
        if clears:
            self.errors = 0

    def say(self, number: int, **values) -> None:
        message = self.dbc[number]
        data = message.encode(values)
        self.network.send_message(self.node << 5 | number, data)

    def receive(self, frame: can.Message) -> None:
        self.fed = self.network.now
        message = self.dbc[frame.arbitration_id & 31]
        name = message.name.removeprefix("Axis0_")
        if frame.is_remote_frame:
            assert frame.dlc == message.length
            self.asked(name)
            return
        assert len(frame.data) == message.length or name == "Clear_Errors"
        reported = message.decode(bytes(frame.data), decode_choices=True)
        if name == "Set_Axis_State":
            expected = str(reported["Axis_Requested_State"])
            if expected == "CLOSED_LOOP_CONTROL" and (self.errors or self.stuck):
                return
            if self.keeps and expected == "IDLE":
                return
            state = {"IDLE": IDLE, "CLOSED_LOOP_CONTROL": CLOSED_LOOP}[expected]
            if state != self.state:
                self.history.append(expected)
                assert state == IDLE or self.mode == ("POSITION_CONTROL", "PASSTHROUGH")
            self.state = state
        elif name == "Set_Controller_Mode":
            self.mode = (str(reported["Control_Mode"]), str(reported["Input_Mode"]))
        elif name == "Set_Input_Pos":
            self.goal, self.speed = reported["Input_Pos"], reported["Vel_FF"]
            self.torque = reported["Torque_FF"]
        elif name == "Clear_Errors":
            self.errors = self.errors if self.stuck else 0
        elif name == "Estop":
            self.disarm("estop")
            self.history.append("ESTOP")
        else:
            raise AssertionError(f"{name} from the master")

    def asked(self, name: str) -> None:
        if name == "Get_Encoder_Estimates":
            if not self.mute:
                place, self.wrong_once = self.position + self.wrong_once, 0.0
                self.say(0x09, Pos_Estimate=place, Vel_Estimate=0.0)
        elif name == "Get_Error":
            self.say(0x03, Active_Errors=self.errors, Disarm_Reason=self.reason)
        elif name == "Get_Version":
            zero = {s.name: 0 for s in self.dbc[0].signals}
            self.say(0x00, **(zero | {"Protocol_Version": self.protocol, "Fw_Version_Minor": 6}))
        else:
            raise AssertionError(f"{name} is asked for")

    def pass_ms(self) -> None:
        if self.off:
            return
        now = self.network.now
        if self.state == CLOSED_LOOP and self.watchdog_ms < now - self.fed:
            self.disarm("watchdog")
        if now % 20 == 4 * self.node % 20 and not self.silent:
            self.say(
                0x01,
                Axis_Error=self.errors,
                Axis_State=self.state,
                Procedure_Result=0,
                Trajectory_Done_Flag=0,
            )
        if self.state == CLOSED_LOOP and not self.jammed:
            self.position += 1e-3 * (self.speed + 200 * (self.goal - self.position))
