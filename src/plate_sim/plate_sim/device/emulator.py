"""Device, line and plate together, with their accidents; time is an argument, in steps of 1 ms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PlateError
from plate_core.serial_protocol import Fault

from .controller import Device
from .hung import HungPlate
from .limits import DeviceLimits
from .line import Line, Trouble
from .motion import REST
from .played import Recorder, Stretch

TICK_US = 1_000

HOMING_S = 0.3
"""Duration of the search for home [s], unless another one is given."""

BUFFER_BYTES = 2048
"""What the board holds of bytes that the device has not read (firmware/hal.h); more are lost."""

BOOT_S = 0.2
"""From a reset until the device answers [s]."""

BROWN_OUT_S = 0.3
"""Length of a brown-out [s]: motor current fails, the logic goes on."""


@dataclass(frozen=True)
class Accidents:
    """What happens again and again.

    Attributes
    ----------
    trouble : Trouble
        Of the line, both ways.
    disconnect_every, reset_every, brown_out_every : float
        Time from one to the next [s]; 0: never.
    disconnect_s : float
        How long the line is away [s].
    """

    trouble: Trouble = field(default_factory=Trouble)
    disconnect_every: float = 0.0
    reset_every: float = 0.0
    brown_out_every: float = 0.0
    disconnect_s: float = 2.0

    def __post_init__(self) -> None:
        for name in ("disconnect_every", "reset_every", "brown_out_every", "disconnect_s"):
            value = getattr(self, name)
            if not 0 <= value < 1e6:
                raise PlateError(f"{name} is {value!r}, allowed: 0 to 1e6 s")


class Emulator:
    """A motor controller with plate and line.

    Parameters
    ----------
    limits : DeviceLimits
    seed : int
        Of the line's chance.
    accidents : Accidents
    commanded : callable, optional
        Called with time [s] and setpoint (3, 4), or None, of every tick.
    hung : HungPlate, optional
        The plate on its flexures, if it does not do as commanded.
    homing_s : float
        What the search for home takes [s].
    """

    def __init__(
        self,
        limits: DeviceLimits,
        seed: int = 0,
        accidents: Accidents | None = None,
        commanded: Callable[[float, np.ndarray | None], None] | None = None,
        hung: HungPlate | None = None,
        homing_s: float = HOMING_S,
    ) -> None:
        accidents = accidents or Accidents()
        chance = np.random.default_rng(seed).spawn(3)
        self.device = Device.started(limits, int(chance[2].integers(1, 2**31)))
        self.accidents = accidents
        self.to_device = Line(accidents.trouble, chance[0])
        self.to_host = Line(accidents.trouble, chance[1])
        self.connected = True
        self._commanded = commanded
        self._hung = hung
        self._measured = REST[:2]
        self._recorder = Recorder()
        self._away_until = self._silent_until = self._dark_until = 0.0
        self._homing_us = round(homing_s * 1e6)
        self._jammed = False

    @property
    def now(self) -> float:
        """The device's clock [s]."""
        return self.device.now_us * 1e-6

    @property
    def plate(self) -> np.ndarray:
        """Position, speed and acceleration (3, 4) that the motors are led to, also by flexures."""
        return self._recorder.plate

    def configure(self, accidents: Accidents) -> None:
        """Change what goes wrong from now on."""
        self.accidents = accidents
        self.to_device.trouble = self.to_host.trouble = accidents.trouble

    def disconnect(self) -> None:
        """Pull the plug for a while."""
        self._away_until = self.now + self.accidents.disconnect_s
        self.connected = False
        self._cut()

    def reset(self) -> None:
        """Restart the device: it forgets everything, and current fails at once."""
        old = self.device
        self.device = Device.started(old.limits, (old.boot + 1) % 2**32, old.now_us)
        self._silent_until = self.now + BOOT_S
        self._cut()

    def brown_out(self) -> None:
        """Take the motors' supply away for a moment."""
        self._dark_until = self.now + BROWN_OUT_S

    def jam(self, jammed: bool = True) -> None:
        """Hold the plate where it is, whatever is commanded; or let it go again."""
        self._jammed = jammed

    def tick(self) -> list[Stretch]:
        """Let a tick pass; returns what the motors have done up to an image."""
        self._befall()
        device = self.device
        now_us = device.now_us + TICK_US
        now = now_us * 1e-6
        came = self.to_device.arrived(now)
        if now < self._silent_until:
            self.device, at, said = replace(device, now_us=now_us, heard_us=now_us), None, b""
        else:
            faults = Fault.SUPPLY if now < self._dark_until else Fault.NONE
            came = came[: BUFFER_BYTES - len(device.backlog)]
            motion = device.motion
            found = motion.searches and now_us - motion.enabled_us >= self._homing_us
            idle = self.to_host.idle(now)
            self.device, said, at = device.ticked(now_us, self._measured, came, faults, found, idle)
        if self.connected:
            self.to_host.sent(said, now)
        if self._commanded is not None:
            self._commanded(now, at)
        stretches = self._recorder.followed(now, self.device.motion, at)
        moved = self.plate[::2] if self._hung is None else self._hung.moved(self.plate)
        if not self._jammed:
            self._measured = moved.astype(np.float32)
        return stretches

    def _befall(self) -> None:
        accidents, tick = self.accidents, self.device.now_us // TICK_US + 1
        for every, happen in (
            (accidents.disconnect_every, self.disconnect),
            (accidents.reset_every, self.reset),
            (accidents.brown_out_every, self.brown_out),
        ):
            if every and tick % max(1, round(every * 1e6 / TICK_US)) == 0:
                happen()
        self.connected = self.now >= self._away_until

    def _cut(self) -> None:
        self.to_device.cut()
        self.to_host.cut()
