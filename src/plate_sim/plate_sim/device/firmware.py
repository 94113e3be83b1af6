"""Runs the real firmware in a process on this computer. The serial line, the CAN bus and the drives
are simulated."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from plate_core import PlateError, Rig
from plate_core.serial_protocol import Fault, State

from .drives import Frame, SetpointCheck, SimulatedDrives, SimulatedODrives
from .emulator import TICK_US
from .faults import FaultSchedule
from .plate import Recorder, Segment
from .serial_line import Line


class FirmwareOnDesk:
    """Firmware that commands simulated drives on a CAN bus, in steps of one tick. For a rig with
    drives, this class is used in place of `Emulator`.

    The drives determine the motion of the motors. The simulated drives follow the setpoints with a
    small error.

    Parameters
    ----------
    program : path
        Program from the folder firmware/host, built with can.c and with the drives and limits of
        the rig.
    rig : Rig
        Rig with drives.
    seed : int
        Random seed of the line's faults.
    schedule : FaultSchedule
        Schedule of faults. Only the faults of the line are used.

    Raises
    ------
    PlateError
        If the motors of the rig have no drives, or the program does not start.
    """

    connected = True

    def __init__(
        self, program: str | Path, rig: Rig, seed: int = 0, schedule: FaultSchedule | None = None
    ) -> None:
        drives = [motor.drive for motor in rig.motors if motor.drive is not None]
        if not drives:
            raise PlateError(
                "the rig's motors have no drives, allowed: `drive: cia402` or `drive: odrive`"
            )
        try:
            self._process = subprocess.Popen(
                [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        except OSError as error:
            raise PlateError(f"firmware is {str(program)!r}: {error}") from None
        generators = np.random.default_rng(seed).spawn(2)
        line = (schedule or FaultSchedule()).line
        self.to_device, self.to_host = Line(line, generators[0]), Line(line, generators[1])
        odrive = drives[0].kind == "odrive"
        self.drives = SimulatedODrives(drives) if odrive else SimulatedDrives(drives)
        self.check = SetpointCheck(drives, self.drives.zeros, rig.limits)
        self.now_us = 0
        self.state, self.faults, self._refused = State.OFF, Fault.NONE, 0
        self.triggered = False
        """Whether the camera was triggered in the last tick."""
        self._recorder = Recorder()
        self._coming: list[Frame] = []

    @property
    def now(self) -> float:
        """Time of the device's clock [s]."""
        return self.now_us * 1e-6

    def configure(self, schedule: FaultSchedule) -> None:
        """Change the faults of the serial line. Other faults in the schedule are not simulated."""
        self.to_device.faults = self.to_host.faults = schedule.line

    def reset(self) -> None:
        """Restart the firmware. The simulated drives continue to run."""
        self._send_order("reset")
        self.to_device.cut()
        self.to_host.cut()

    def close(self) -> None:
        """End the process of the firmware."""
        self._process.kill()
        self._process.communicate()

    def values(self) -> Mapping[str, object]:
        """Return values for the diagnostics, by name."""
        stroke, speed, accel = self.check.fractions
        return {
            "state": self.state.name.lower(),
            "damaged frames": self._refused,
            "commanded stroke of the drives": f"{stroke:.4f}",
            "commanded speed of the drives": f"{speed:.4f}",
            "commanded acceleration of the drives": f"{accel:.4f}",
        }

    def tick(self) -> list[Segment]:
        """Simulate one tick, and return the segments of the motors' motion that were completed in
        this tick."""
        self.now_us += TICK_US
        if received := self.to_device.arrived(self.now):
            self._send_order(f"rx {received.hex()}")
        for identifier, data in self._coming + self.drives.passed():
            self._send_order(f"can {identifier:x} {data.hex()}")
        self._send_order(f"run {TICK_US}")
        frames = self._read_output()
        self._coming = self.drives.receive(frames)
        self.check.receive(frames, bool(self.drives.enabled.all()))
        return self._recorder.followed(self.now, None, self.drives.motors, self.triggered)

    def _send_order(self, order: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(order + "\n")

    def _read_output(self) -> list[Frame]:
        """Process the output of the firmware in one tick, and return the CAN frames in this
        output."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        frames: list[Frame] = []
        self.triggered = False
        try:
            self._process.stdin.flush()
        except OSError as error:
            raise PlateError(f"the firmware has ended: {error}") from None
        for line in iter(self._process.stdout.readline, ""):
            kind, *arguments = line.split()
            if kind == "can":
                frames.append((int(arguments[0], 16), bytes.fromhex("".join(arguments[1:]))))
            elif kind == "tx":
                self.to_host.sent(bytes.fromhex(arguments[0]), self.now)
            elif kind == "trigger":
                self.triggered = arguments[1] == "1"
            elif kind == "state":
                self.state, self.faults = State(int(arguments[0])), Fault(int(arguments[1]))
                self._refused = int(arguments[2])
                return frames
        raise PlateError("the firmware has ended")
