"""Commission the drives of a rig in a dialogue: `ros2 run plate_drives commission`.

Without ROS, use `python -m plate_drives.commission RIG`.
"""

from __future__ import annotations

import argparse
import select
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from plate_core import PlateError, Rig, load_rig, piped
from plate_core.rig import Drive, Limits, rig_path

from .axis import CYCLE_MS, Axis, ignore_signals, switch_off
from .master import Master, open_bus
from .rig_file import differences, write
from .survey import BusNode, bus_warnings, drives_of, has_current, read_bus

__all__ = ["AskUser", "ask", "commission", "main"]

SIZE_M = 5e-4
"""Amplitude of the test motions [m]. The amplitude is at most a quarter of the motor's stroke."""
FRACTION = 0.1
"""Maximum fraction of the rig's speed and acceleration limits that the test motions use."""
STAGES = (0.01, 0.1, 1.0)
"""Distances of successive moves, as fractions of the amplitude. The program asks the user before
each larger move, because counts_per_m may be far too large."""
MOVE_S = 0.5
"""Minimum time of a move [s]."""

SWING_S = 4.0
"""Duration of the test that measures the following error [s]."""

SWING_HZ = 2.0
"""Maximum frequency of the motion in the test that measures the following error [Hz]."""
ANSWER_S = 60.0
"""Maximum time to wait for a person's answer while a motor has current [s]."""
ROUGH = 0.1
"""Maximum relative error when a person reads the travel of a motor. If the value differs from the
commanded travel by at most this fraction, the program keeps the scale of the rig file."""


AskUser = Callable[[str, Callable[[], object]], str]
"""Function that asks the user a question and returns the answer. Until the user answers, the
function calls its second argument repeatedly."""


def ask(question: str, meanwhile: Callable[[], object]) -> str:
    """Print a question and read the answer from the standard input. Raise a PlateError if the input
    has ended."""
    print(question, end=" ", flush=True)
    # Read the standard input without a buffer, because select does not report lines that are
    # already in a buffer.
    with open(0, "rb", buffering=0, closefd=False) as lines:
        while not select.select([lines], [], [], 0)[0]:
            meanwhile()
        answer = lines.readline()
    if not answer:
        raise PlateError("no answer: the input has ended")
    return answer.decode(errors="replace").strip()


class Dialogue:
    """Dialogue with the user about each motor. Before the dialogue, check that all drives on the
    bus match the rig file."""

    def __init__(self, rig: Rig, master: Master, found: dict[int, BusNode], ask: AskUser) -> None:
        self._rig = rig
        self._master = master
        self._nodes = found
        self._ask = ask
        self._size = min(SIZE_M, rig.limits.stroke_m / 4)

    def ask(self, question: str, axis: Axis | None = None) -> str:
        """Ask the user a question. If `axis` is given, keep its motor at rest until the user
        answers, and limit the time for the answer to `ANSWER_S`."""
        end = self._master.now + ANSWER_S

        def keep_bus_alive() -> None:
            if axis is None:
                self._master.wait(0.02)
            elif self._master.now > end:
                raise PlateError(f"no answer was typed within {ANSWER_S:g} s")
            else:
                axis.hold()

        return self._ask(question, keep_bus_alive)

    def measured(self) -> tuple[dict[str, Drive], bool]:
        """Return the measured drives by the names of their motors, and whether no measurement has
        failed."""
        new: dict[str, Drive] = {}
        well = True
        for number, drive in enumerate(drives_of(self._rig), 1):
            direction = "({:g}, {:g})".format(*self._rig.motors[number - 1].direction)
            print(f"\nmotor_{number}, {self._nodes[drive.node]}")
            question = (
                f"The motor will get current, move {1e3 * self._size:g} mm along {direction}, and "
                "oscillate with this amplitude. Check that nobody is near it, and that the "
                "emergency stop is within reach. Type yes to move it, or Enter to skip it:"
            )
            if self.ask(question) != "yes":
                print(f"motor_{number} is skipped")
                continue
            try:
                name, changed = self._commission_axis(number, drive)
                if name in new:
                    raise PlateError(f"{name} was named twice, allowed: each motor once")
                new[name] = changed
            except PlateError as error:
                well = False
                print(f"error: {error}\nmotor_{number}: this result is not used", flush=True)
        return new, well

    def _commission_axis(self, number: int, drive: Drive) -> tuple[str, Drive]:
        """Identify, measure and test one drive. Return the name of the drive's motor and the new
        values of the drive."""
        limits, size, values = self._rig.limits, self._size, self._nodes[drive.node].values
        ends = values.get("lowest", 0), values.get("highest", 0)
        scale = drive.sign * drive.counts_per_m
        by_speed = 1.9 * size / limits.speed
        by_accel = np.sqrt(5.8 * size / limits.accel / FRACTION)
        seconds = max(MOVE_S, by_speed / FRACTION, by_accel)
        self._check_off()
        with Axis(self._master, number, drive.node, scale, limits) as axis:
            axis.enable(size, ends if ends[0] < ends[1] else (-(2**31), 2**31 - 1))
            before = 0.0
            for part in STAGES:
                commanded = f"A move of {1e3 * size * before:g} mm was commanded."
                question = f"{commanded} Did the motor move about 1 mm? Type no or yes:"
                if before and self.ask(question, axis) != "no":
                    raise PlateError(
                        f"counts_per_m is {drive.counts_per_m:g} and probably too large, because "
                        f"you saw about 1 mm when {1e3 * size * before:g} mm was commanded"
                    )
                axis.follow(_smooth_motion(size * before, size * part, seconds), seconds)
                before = part
            if axis.travel < size / 2:
                raise PlateError(
                    f"motor_{number}: travel measured by the drive is {1e3 * axis.travel:+.3f} mm, "
                    f"allowed: at least {500 * size:g} mm (commanded: {1e3 * size:g} mm). The "
                    "motor does not follow, or counts_per_m is too small"
                )
            answer = self.ask(f"Which motor moved, 1 to 4? Enter for {number}:", axis)
            if answer not in ("", "1", "2", "3", "4"):
                raise PlateError(f"motor is {answer!r}, allowed: 1 to 4")
            motor = self._rig.motors[int(answer or number) - 1]
            direction = "({:g}, {:g})".format(*motor.direction)
            travel_mm = 1e3 * axis.travel
            answer = self.ask(
                f"The drive has measured {travel_mm:+.3f} mm of travel. Which distance did you see "
                f"[mm], positive along {direction}? Enter for the same:", axis,
            )  # fmt: skip
            axis.follow(_smooth_motion(size, 0.0, seconds), seconds)
            axis.scale = _corrected_scale(scale, travel_mm, answer)
            self._swing_motor(axis, size * min(1, abs(scale / axis.scale)), limits)
        place = self._master.read(drive.node, 0x6064, signed=True) / axis.scale
        home = "absolute" if drive.absolute else "here"
        home = self.ask(
            f"The motor is {1e3 * place:+.3f} mm from its drive's zero. Where is home: here (its "
            f"position at the first enable) or absolute (the drive's zero)? Enter for {home}:"
        ) or home  # fmt: skip
        if home not in ("here", "absolute"):
            raise PlateError(f"home is {home!r}, allowed: here, absolute")
        if home == "absolute" and abs(place) > limits.stroke_m:
            raise PlateError(
                f"home is absolute, and the motor is {1e3 * abs(place):.3g} mm from its drive's "
                f"zero, allowed: at most stroke_m ({1e3 * limits.stroke_m:g} mm); answer `here`, "
                "or set the drive's zero"
            )
        return motor.name, replace(
            drive, counts_per_m=abs(axis.scale), sign=1 if axis.scale > 0 else -1,
            absolute=home == "absolute", serial=self._read_serial_number(drive),
        )  # fmt: skip

    def _check_off(self) -> None:
        """Raise a PlateError if any drive is enabled."""
        for number, drive in enumerate(drives_of(self._rig), 1):
            if has_current(self._master.read(drive.node, 0x6041)):
                raise PlateError(f"motor_{number}: the drive has current, allowed: no current")

    def _read_serial_number(self, drive: Drive) -> int:
        """Return a drive's serial number. If several drives report the same number, return the
        number in the rig file."""
        serials = [drive_on_bus.values.get("serial", 0) for drive_on_bus in self._nodes.values()]
        serial = self._nodes[drive.node].values.get("serial", 0)
        return serial if serials.count(serial) == 1 else drive.serial

    def _swing_motor(self, axis: Axis, size: float, limits: Limits) -> None:
        """Move the motor along a sine within the limits, and print the following error."""
        by_speed, by_accel = FRACTION * limits.speed / size, np.sqrt(FRACTION * limits.accel / size)
        rate = min(2 * np.pi * SWING_HZ, by_speed, by_accel)
        targets, actual = axis.follow(
            lambda t: size * np.sin(rate * t) * _smooth_step(t) * _smooth_step(SWING_S - t), SWING_S
        )
        error = 1e3 * (actual - targets)
        rms, speed = np.sqrt(np.mean(error**2)), np.gradient(targets, 1e-3 * CYCLE_MS)
        lag = -(error @ speed) / (speed @ speed)  # lag behind the setpoints [ms]
        needed, allowed = lag * limits.speed, 1e3 * limits.following_error_m
        print(
            f"The following error with an amplitude of {1e3 * size:.3g} mm at "
            f"{rate / 2 / np.pi:.3g} Hz is {rms:.4f} mm RMS, maximum {np.max(np.abs(error)):.4f} "
            f"mm. The lag is {lag:.2f} ms. At speed_mps it causes an error of {needed:.2g} "
            f"mm{' (TOO MUCH)' if 0 < allowed < needed else ''}; following_error_m is {allowed:g} "
            f"mm. Setpoints were up to {1e3 * axis.late_s:.1f} ms late."
        )


def _smooth_step(u: float) -> float:
    """Return 10 u^3 - 15 u^4 + 6 u^5, with u clipped to 0 to 1. The polynomial rises from 0 to 1
    with zero slope and curvature at both ends."""
    u = min(max(u, 0.0), 1.0)
    return u**3 * (10 - u * (15 - 6 * u))


def _smooth_motion(start: float, end: float, seconds: float) -> Callable[[float], float]:
    """Return a function from time [s] to displacement [m]. The displacement changes smoothly from
    `start` to `end` within `seconds`."""
    return lambda t: start + (end - start) * _smooth_step(t / seconds)


def _corrected_scale(scale: float, commanded_mm: float, answer: str) -> float:
    """Return the corrected counts per metre. The value is negative if the drive counts against the
    motor's direction. `commanded_mm` is the travel according to `scale`, and `answer` is the travel
    that a person observed [mm]."""
    try:
        seen = float(answer or commanded_mm)
    except ValueError:
        seen = 0.0
    if not 0.01 <= abs(seen / commanded_mm) <= 100:
        raise PlateError(f"travel is {answer!r}, allowed: a number of mm, near {commanded_mm:.2g}")
    new = scale * commanded_mm / seen
    if abs(abs(new / scale) - 1) <= ROUGH:
        return float(np.copysign(scale, new))
    return float(f"{new:.3g}")


def commission(path: Path, master: Master, only_check: bool, ask: AskUser = ask) -> int:
    """Check the drives on a bus. If `only_check` is False, also move and measure the motors, and
    write the result to the rig file.

    Return 0 if all drives fit the rig file or the result was written, otherwise 1.
    """
    rig = load_rig(path)
    drives, found = drives_of(rig), read_bus(master)
    print("\n".join(map(str, found.values())) or "no node answers on the bus")
    wrong = list(bus_warnings(rig, found, master.other_master))
    for warning in wrong:
        print(f"{'WRONG' if warning.impossible else 'note'}: {warning.text}")
    hindered = any(warning.impossible and warning.about != "limits" for warning in wrong)
    if only_check or hindered:
        print("nothing was moved")
        return int(any(warning.impossible for warning in wrong))
    dialogue, well = Dialogue(rig, master, found, ask), False
    try:
        new, well = dialogue.measured()
    finally:
        well = _switch_all_off(master, drives) and well
    old = {motor.name: drive for motor, drive in zip(rig.motors, drives, strict=True)}
    changes = {name: differences(old[name], drive) for name, drive in new.items()}
    for name, keys in changes.items():
        print(f"{name}: {', '.join(f'{key}: {v}' for key, v in keys.items()) or 'unchanged'}")
    if not any(changes.values()):
        return int(not well)
    if dialogue.ask(f"Write this to {path}? Type yes:") != "yes":
        print("nothing was written")
        return 1
    write(path, new)
    print(f"written: {path}. Build the firmware again, and flash it to the board")
    return int(not well)


def _switch_all_off(master: Master, drives: Sequence[Drive]) -> bool:
    """Disable all drives. If a drive fails, continue with the next drive. Return whether all drives
    are without current."""
    off = True
    with ignore_signals():
        for number, drive in enumerate(drives, 1):
            try:
                switch_off(master, number, drive.node)
            except PlateError as error:
                off = False
                print(f"error: {error}", flush=True)
    print("\nall drives are switched off" if off else "")
    return off


@piped()
def main() -> None:
    """Run the command line. Exit code 0: success, 1: failure, 2: wrong arguments, files or bus."""
    parser = argparse.ArgumentParser(
        prog="commission", description="Commission the drives of a rig (CiA 402 on CANopen): find "
        "them on the bus and compare them with the rig file. Then, for each motor and only after "
        "you have typed yes: move it slightly, ask for direction and scale, measure how well it "
        "follows. Finally write the changes to the rig file.",
    )  # fmt: skip
    parser.add_argument("rig", help="rig file, or its name in config/rigs")
    parser.add_argument(
        "--bus", default="socketcan", help="python-can's interface (default: socketcan)"
    )
    parser.add_argument(
        "--channel", default="can0", help="channel of the interface (default: can0)"
    )
    parser.add_argument(
        "--bitrate",
        type=int,
        default=1_000_000,
        help="bit rate, for interfaces that set it (default: 1000000)",
    )
    parser.add_argument(
        "--check", action="store_true", help="only read the drives and compare them"
    )
    args = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    try:
        path = rig_path(args.rig)
        drives_of(load_rig(path))  # check the drives before a bus is opened
        master = Master(open_bus(args.bus, args.channel, args.bitrate))
        try:
            code = commission(path, master, args.check)
        finally:
            master.close()
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        print("\ninterrupted; nothing was written", file=sys.stderr)
        code = 130
    sys.exit(code)


if __name__ == "__main__":
    main()
