"""Emulator of device, serial line and plate with their faults, in steps of 1 ms. The emulator
receives bytes from the host. The emulator returns bytes to the host, and the motion of the motors.
The emulator does not read a clock of the computer."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from plate_core.serial_protocol import MOTORS, Fault, State

from .._kernels import Device
from .faults import FaultSchedule
from .limits import DeviceLimits
from .plate import Recorder, Segment, SuspendedPlate
from .serial_line import Line

TICK_US = 1_000

SEARCH_S = 0.3
"""Default duration of the search for home [s]."""

BOOT_S = 0.2
"""Time from a reset of the device until it responds [s]."""

BROWN_OUT_S = 0.3
"""Duration of a brown-out [s]. During this time, the motors have no current, but the logic
continues to run."""


class Emulator:
    """Motor controller with plate and serial line. The motor controller is the firmware on a
    simulated board.

    Parameters
    ----------
    limits : DeviceLimits
    seed : int
        Random seed of the line's faults.
    schedule : FaultSchedule
    commanded : callable, optional
        Function that is called for each tick with the time [s] and the setpoint (3, 4). The
        setpoint is None while the motors have no current.
    plate : SuspendedPlate, optional
        Plate on flexures. Default: a plate that follows its setpoints exactly.
    homing_s : float
        Duration of the search for home [s].
    """

    def __init__(
        self,
        limits: DeviceLimits,
        seed: int = 0,
        schedule: FaultSchedule | None = None,
        commanded: Callable[[float, np.ndarray | None], None] | None = None,
        plate: SuspendedPlate | None = None,
        homing_s: float = SEARCH_S,
    ) -> None:
        schedule = schedule or FaultSchedule()
        generators = np.random.default_rng(seed).spawn(3)
        self.device = Device(limits, int(generators[2].integers(1, 2**31)))
        self._limits = limits
        self.schedule = schedule
        self.to_device = Line(schedule.line, generators[0])
        self.to_host = Line(schedule.line, generators[1])
        self.connected = True
        self._commanded = commanded
        self._suspended = plate
        self._measured = np.zeros((2, MOTORS), np.float32)
        self._recorder = Recorder()
        self._disconnected_until = self._booting_until = self._brown_out_until = 0.0
        self._search_us = round(homing_s * 1e6)
        self._jammed = False
        self.triggered = False
        """Whether the device has triggered the camera in the last tick."""

    @property
    def now(self) -> float:
        """Time of the device's clock [s]."""
        return self.device.now_us * 1e-6

    @property
    def now_us(self) -> int:
        """Time of the device's clock [us]."""
        return self.device.now_us

    @property
    def faults(self) -> Fault:
        """Faults of the device."""
        return Fault(self.device.faults)

    @property
    def state(self) -> State:
        """State of the device."""
        return State(self.device.state)

    def values(self) -> Mapping[str, object]:
        """Return values for the diagnostics, by name."""
        return {
            "state": self.state.name.lower(),
            "damaged frames": self.device.refused,
            "hottest motor": f"{self.device.hottest:.3f}",
        }

    @property
    def plate(self) -> np.ndarray:
        """Commanded position, speed and acceleration of the motors (3, 4). While the motors have no
        current, the values are those of the motion by which the flexures return the plate to
        home."""
        return self._recorder.plate

    def configure(self, schedule: FaultSchedule) -> None:
        """Replace the schedule of faults."""
        self.schedule = schedule
        self.to_device.faults = self.to_host.faults = schedule.line

    def disconnect(self) -> None:
        """Interrupt the connection to the host for the time `disconnect_s` of the fault
        schedule."""
        self._disconnected_until = self.now + self.schedule.disconnect_s
        self.connected = False
        self._cut_line()

    def reset(self) -> None:
        """Restart the device. After a reset, the device has lost its state. The motors have no
        current."""
        self.device = Device(self._limits, (self.device.boot + 1) % 2**32, self.now_us)
        self._booting_until = self.now + BOOT_S
        self._cut_line()

    def brown_out(self) -> None:
        """Interrupt the motors' supply for `BROWN_OUT_S`."""
        self._brown_out_until = self.now + BROWN_OUT_S

    def jam(self, jammed: bool = True) -> None:
        """If `jammed` is True, the measured motion of the plate stays constant, as if the plate
        were jammed. Otherwise release it."""
        self._jammed = jammed

    def tick(self) -> list[Segment]:
        """Simulate one tick, and return the segments of the motors' motion that were completed in
        this tick."""
        self._trigger_faults()
        device, was_high = self.device, self.device.triggered
        now_us = device.now_us + TICK_US
        now = now_us * 1e-6
        received = self.to_device.arrived(now)
        if now < self._booting_until:
            device.sleep(now_us)
            sent, setpoint = b"", None
        else:
            faults = Fault.SUPPLY if now < self._brown_out_until else Fault.NONE
            found = device.searches and now_us - device.enabled_us >= self._search_us
            idle = self.to_host.idle(now)
            sent, setpoint = device.tick(
                now_us, self._measured, received[: device.room], faults, found, idle
            )
        self.triggered = device.triggered and not was_high
        if self.connected:
            self.to_host.sent(sent, now)
        if self._commanded is not None:
            self._commanded(now, setpoint)
        segments = self._recorder.followed(now, device, setpoint, self.triggered)
        moved = self.plate[::2] if self._suspended is None else self._suspended.moved(self.plate)
        if not self._jammed:
            self._measured = moved.astype(np.float32)
        return segments

    def _trigger_faults(self) -> None:
        schedule, tick = self.schedule, self.device.now_us // TICK_US + 1
        for every, happen in (
            (schedule.disconnect_every, self.disconnect),
            (schedule.reset_every, self.reset),
            (schedule.brown_out_every, self.brown_out),
        ):
            if every and tick % max(1, round(every * 1e6 / TICK_US)) == 0:
                happen()
        self.connected = self.now >= self._disconnected_until

    def _cut_line(self) -> None:
        self.to_device.cut()
        self.to_host.cut()
